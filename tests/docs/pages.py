"""The pages, their fenced blocks, and the command lines in these."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted(p for p in DOCS.rglob("*.md") if "gallery" not in p.relative_to(DOCS).parts),
]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.M | re.S)


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: Path
    line: int
    language: str
    text: str

    @property
    def name(self):
        return f"{self.page.relative_to(ROOT)}:{self.line}"

    def commands(self):
        """Its lines without comments and continuations."""
        for line in self.text.replace("\\\n", " ").splitlines():
            if words := shlex.split(line.removeprefix("$ "), comments=True):
                yield words


def blocks(*languages):
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for match in FENCE.finditer(text):
            if match[1] in languages:
                yield Block(page, text[: match.start()].count("\n") + 2, match[1], match[2])


SHELL = list(blocks("sh", "bash", "console"))
COMMANDS = [(block, words) for block in SHELL for words in block.commands()]
NSFC = [(block, words) for block, words in COMMANDS if words[0] == "nsfc"]


def ids(pairs):
    return [f"{block.name} {' '.join(words)[:60]}" for block, words in pairs]
