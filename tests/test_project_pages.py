"""Architecture page, glossary and the guide for contributors name files that are there; citation and hooks are right."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
NAMES = ("docs/architecture.md", "docs/glossary.md", "CONTRIBUTING.md")
PAGES = {name: (ROOT / name).read_text(encoding="utf-8") for name in NAMES}
PATH = re.compile(r"`((?:\.?[\w-]+/)[\w./-]*|[\w-]+\.(?:py|toml|md|cff|yaml)|Makefile)`")


@pytest.mark.parametrize("page", PAGES)
def test_named_files_exist(page):
    names = set(PATH.findall(PAGES[page]))
    assert len(names) > 10
    missing = [n for n in names if not ((ROOT / n).exists() or (ROOT / "warp_caustics" / n).exists())]
    assert not missing, sorted(missing)


def test_twenty_questions_are_answered_by_paths():
    table = PAGES["docs/architecture.md"].split("| question | answer |\n|---|---|\n")[1].split("\n\n")[0]
    rows = [row.strip("| ").split(" | ") for row in table.splitlines()]
    assert len(rows) >= 20 and len({question for question, _ in rows}) == len(rows)
    for question, answer in rows:
        assert question.endswith("?") and PATH.search(answer), question


def test_citation_and_changelog_name_this_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0" and citation["message"]
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])
    assert [author["name"] for author in citation["authors"]] == [author["name"] for author in project["authors"]]
    assert citation["keywords"] == project["keywords"]
    sources = (ROOT / "docs" / "sources.md").read_text(encoding="utf-8")
    for reference in citation["references"]:
        assert f"*{reference['title']}*, {reference['year']}" in sources
        assert ", ".join(f"{a['given-names']} {a['family-names']}" for a in reference["authors"]) in sources
    assert project["version"] in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_hooks_are_local_and_those_of_make():
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"]
    assert [repo["repo"] for repo in hooks] == ["local"]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for hook in hooks[0]["hooks"]:
        command = hook["entry"].replace(".venv/bin", "$(BIN)").replace(" --force-exclude", "")
        assert f"\t{command}\n" in makefile
