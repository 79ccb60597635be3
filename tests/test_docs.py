"""The documentation says what is true: its commands, its code, its links, its tables."""

import importlib
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
import pytest

from tests.quick_figures import quick_figures

__all__ = ["quick_figures"]

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted(p for p in DOCS.rglob("*.md") if "gallery" not in p.relative_to(DOCS).parts),
]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.M | re.S)

SMALL = ("--set", "scene.height_samples=32", "--set", "scene.image_pixels=64")

RUN = [
    # Command, what is changed to make it quick, what is added.
    (r"nsfc (env|config) ", {}, ()),
    (r"nsfc weights ", {}, ()),
    (r"nsfc plan ", {}, ()),
    (
        r"nsfc calibrate print.tif .*scene",
        {},
        ("--free", "gap_m", "--iterations", "1", "--no-advice", "--border", "4", "--finest", "32", *SMALL),
    ),
    (r"nsfc calibrate ", None, "photos of the reader's own; tests/cli/test_calibrate.py runs small ones"),
    (r"nsfc setup .*lines", None, "a list of lines of the reader's own; tests/cli/test_setup.py has one"),
    (r"nsfc setup ", {}, ("--border", "4", "--unknown-heights", "1", *SMALL)),
    (r"nsfc simulate .*--camera \./", None, "a file of the page; tests/cli/test_simulate_camera.py reads it"),
    (r"nsfc simulate examples/", None, "files of the checkout; tests/cli/test_simulate.py runs it"),
    (r"nsfc simulate ", {}, SMALL),
    (r"nsfc data build .*--scheduler", None, "needs a Dask scheduler; tests/data_gen/store/test_cluster.py has one"),
    (r"nsfc data build updater sets/", {r"--n \d+": "--n 2"}, SMALL),
    (r"nsfc data build ", {r"--n \d+": "--n 2"}, (*SMALL, "--workers", "0")),
    (r"nsfc data testset ", None, "16 million photons per field; tests/cli/test_data.py runs a small one"),
    (r"nsfc data ", {}, ()),
    (
        r"nsfc reconstruct .*--(corners|distortion|mixing|capture)",
        None,
        "needs a photo of a screen; tests/warp_caustics/capture makes some",
    ),
    (r"nsfc (reconstruct|capture) examples/", None, "files of the checkout; tests/test_lab.py runs them"),
    (
        r"nsfc reconstruct .*--set reconstruction.options.max_iterations",
        {r"max_iterations=\d+": "max_iterations=2"},
        SMALL,
    ),
    (r"nsfc reconstruct ", {}, ("--max-iterations", "2", *SMALL)),
    (r"nsfc .*[$*]", None, "files of the reader's own"),
    (r"nsfc design ", {}, ("--max-iterations", "2", *SMALL)),
    (
        r"nsfc capture .*--(corners|distortion|mixing|capture|exposure-times)",
        None,
        "needs a photo of a screen; tests/warp_caustics/capture makes some",
    ),
    (r"nsfc capture ", {}, SMALL),
    (r"nsfc inspect ", None, "needs a network or minutes; tests/cli/inspection runs small ones"),
    (r"nsfc bench list", {}, ()),
    (r"nsfc bench ", None, "millions of photons per case; tests/cli/test_bench.py runs small ones"),
    (r"nsfc compare ", None, "minutes; tests/cli/test_compare.py runs small ones"),
    (r"nsfc train ", None, "minutes to hours; tests/cli/test_train.py runs small ones"),
    (r"nsfc search ", None, "minutes to hours; tests/cli/test_search.py runs small ones"),
]
"""Which documented commands are run (changes: dict; added options), and why others are only parsed (None; reason)."""


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


def row_of(words):
    """The row of RUN that decides about a command."""
    line = " ".join(words) + " "
    return next((row for row in RUN if re.match(row[0], line)), (line, None, None))


def parsed(words):
    """Context of a command line, as click sees it; files need not exist."""
    from cli.main import nsfc

    command, context, rest = nsfc, nsfc.make_context("nsfc", [], resilient_parsing=True), list(words[1:])
    while isinstance(command, click.Group):
        name = rest.pop(0)
        found = command.get_command(context, name)
        assert found is not None, f"{command.name} has no command {name!r}"
        command = found
        if isinstance(command, click.Group):
            context = command.make_context(name, [], parent=context, resilient_parsing=True)
    for parameter in command.params:
        if isinstance(parameter.type, click.Path):
            parameter.type.exists = False
    return command.make_context(command.name, rest, parent=context)


# --------------------------------------------------------------------------- commands


@pytest.mark.parametrize(("block", "words"), NSFC, ids=ids(NSFC))
def test_it_is_decided_whether_a_command_is_run(block, words):
    _, changes, rest = row_of(words)
    assert changes is not None or rest, "give it a row in RUN"
    if changes is None:
        assert all((ROOT / name).exists() for name in re.findall(r"tests/[\w/.]*\w", rest)), rest


def test_every_command_is_documented():
    """Each has a page with an example of it, and no page is of a command that is gone."""
    known = importlib.import_module("cli.main").COMMANDS

    pages = {page.stem: page.read_text(encoding="utf-8") for page in (DOCS / "commands").glob("*.md")}
    assert set(pages) - {"index"} == set(known)
    for name in known:
        assert f"nsfc {name}" in pages[name].split("{eval-rst}")[0]
        assert f"   :prog: nsfc {name}\n" in pages[name]
        assert f"[`nsfc {name}`]({name}.md)" in pages["index"]
        assert f".. click:: {known[name]}\n" in pages[name]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_in_the_text_exist(page):
    known = importlib.import_module("cli.main").COMMANDS

    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    assert set(re.findall(r"`nsfc ([a-z]+)", text)) <= set(known)
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M))
    assert set(re.findall(r"`make ([a-z-]+)", text)) <= targets
    for module in re.findall(r"`python -m ([\w.]+)", text):
        assert importlib.util.find_spec(module) is not None, module


@pytest.mark.parametrize(("block", "words"), NSFC, ids=ids(NSFC))
def test_command_lines_parse(block, words):
    """Options exist, required ones are there, values have the right type."""
    context = parsed(words)
    method = context.params.get("method")
    if isinstance(method, str):
        from nets.reconstruct.methods import ALL_METHODS

        assert method in ALL_METHODS
    if isinstance(context.params.get("methods"), str):
        from nets.evaluation.method_spec import parse_methods

        assert parse_methods(context.params["methods"])


@pytest.mark.parametrize(("block", "words"), NSFC, ids=ids(NSFC))
def test_settings_exist(block, words):
    """Every --set names a key of its command's configuration, with a value in range."""
    context = parsed(words)
    settings = context.params.get("settings") or ()
    kind = context.params.get("kind")
    if words[1] in ("train", "search") and not context.params.get("resume"):
        from cli.train_config import new_run

        new_run(kind, context.params.get("preset"), None, settings, {})
    elif settings:
        from cli.config import load_config

        load_config(None, settings)


OTHERS = [(block, words) for block, words in COMMANDS if words[0] != "nsfc" and not re.match(r"\w+=", words[0])]


@pytest.mark.parametrize(("block", "words"), OTHERS, ids=ids(OTHERS))
def test_other_commands_are_right(block, words):
    if words[0] == "source":
        assert words[1] == ".venv/bin/activate"  # where `make venv` puts it
    elif words[0] == "eval":
        assert words[1] == "$(_NSFC_COMPLETE=bash_source nsfc)"  # tests/cli/test_main.py runs it
    elif words[0] == "make":
        targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
        assert words[1] in targets
    elif words[0] == "python":
        assert words[1] == "-m" and importlib.util.find_spec(words[2]) is not None
    elif words[0] == "sbatch":
        assert (ROOT / words[1]).is_file()
        parsed(["nsfc", "data", "build", words[2], words[3], "--n", words[4], *words[5:]])
    elif words[0] == "pip":
        import tomllib

        project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        wanted = re.findall(r"\.\[([\w,]+)\]", " ".join(words))
        assert all(set(extras.split(",")) <= set(project["optional-dependencies"]) for extras in wanted)
    else:
        assert words[0] == "dask" and importlib.util.find_spec("distributed") is not None, words


def setup_of_the_photo_page():
    """The YAML file that photo.md tells a reader to write, and its name."""
    text = (DOCS / "photo.md").read_text(encoding="utf-8")
    (found,) = re.findall(r"^```yaml\n# (\S+)\n(.*?)^```$", text, re.M | re.S)
    return found


def workspace(folder, block):
    """Files of the names that a block's commands read, for small plates."""
    import torch

    from cli.config import load_config
    from warp_caustics import CausticSimulator
    from warp_caustics.io import write_image
    from warp_caustics.prints.line import Line, line_relief
    from warp_caustics.prints.line_list import write_lines

    name, content = setup_of_the_photo_page()
    (folder / name).write_text(content, encoding="utf-8")
    scene = load_config(str(folder / name) if name in block.text else None, SMALL[1::2]).scene
    heights = line_relief([Line((-0.012, -0.01), (0.012, 0.008), 6e-3, 1e-4)], 32, scene.plate_size_m)
    caustic = CausticSimulator(scene)(torch.from_numpy(heights).float()).numpy()
    outputs = set()
    for words in block.commands():
        if "-o" in words and row_of(words)[1] is not None:
            outputs.add(words[words.index("-o") + 1])
        for word in words:
            path = folder / word
            if outputs & {word, *map(str, Path(word).parents)} or path.exists() or Path(word).is_absolute():
                continue
            if word.endswith(".tif"):
                light = {"dark.tif": 0 * caustic, "flat.tif": 0 * caustic + 1}.get(word, caustic)
                counts = np.round(200 + 15_000 * light).astype(np.uint16)
                write_image(path, counts, wavelengths_m=scene.wavelengths_m)
            elif word.endswith(".png"):
                write_image(path, np.pad(np.full((40, 40), 255, np.uint8), 12, constant_values=60))
            elif word.endswith(".npy"):
                np.save(path, heights)
            elif word.endswith(".csv"):
                write_lines(path, [Line((-0.012, -0.01), (0.012, 0.008), 6e-3, 1e-4)])
            elif word.endswith(".safetensors"):
                tiny_weights(path, scene)


def tiny_weights(path, scene):
    import nets
    from nets.config import DenoiserConfig, NetworkConfig

    path.parent.mkdir(exist_ok=True)
    numbers = NetworkConfig(learning_rate=1e-3, c_init=2, nonlinearity="ReLU", k_down=2, k_up=2, m_s=1, n_s=1)
    module = nets.build(DenoiserConfig(network=numbers), scene)
    nets.save_weights(path, module, scene=scene, data_fingerprint=None, training={})


def runnable():
    """Blocks with the commands to run of each; a line that stands on several pages is run once."""
    done, chosen = set(), []
    for block in SHELL:
        lines = [w for w in block.commands() if w[0] == "nsfc" and row_of(w)[1] is not None and tuple(w) not in done]
        done.update(tuple(words) for words in lines if words[1] == "reconstruct")
        if lines:
            chosen.append((block, lines))
    return chosen


RUNNABLE = runnable()


@pytest.mark.parametrize(("block", "lines"), RUNNABLE, ids=[block.name for block, _ in RUNNABLE])
def test_commands_run(block, lines, tmp_path, monkeypatch, capfd):
    """One after the other, as a reader would, in a folder that holds small files of the names they read."""
    from cli.main import main

    monkeypatch.chdir(tmp_path)
    workspace(tmp_path, block)
    for words in lines:
        _, changes, added = row_of(words)
        line = shlex.join(words)
        for pattern, replacement in changes.items():
            line = re.sub(pattern, replacement, line, count=1)
        # Folders of the examples lie here.
        arguments = [word.replace("/data/", f"{tmp_path}/") for word in shlex.split(line)[1:]] + list(added)
        for word in words:
            if "/" in word and word == Path(word).as_posix() and not Path(word).is_absolute():
                (tmp_path / word).parent.mkdir(parents=True, exist_ok=True)
        written = [Path(arguments[arguments.index(option) + 1]) for option in ("-o", "--stages") if option in arguments]
        if any(path.exists() for path in written):
            arguments.append("--force")
        code = main(arguments)
        assert code == 0, f"{shlex.join(arguments)}\n{capfd.readouterr().err}"


# --------------------------------------------------------------------------- Python


PYTHON = list(blocks("python"))


@pytest.mark.parametrize("block", PYTHON, ids=lambda block: block.name)
def test_python_compiles_and_names_exist(block):
    """What is imported is there; the rest at least compiles. README's and the interface's examples are run, too."""
    compile(block.text, block.name, "exec")
    for module, names in re.findall(r"^from ([\w.]+) import ([\w, ]+)", block.text, re.M):
        assert all(hasattr(importlib.import_module(module), name.strip()) for name in names.split(","))


def test_interface_example_runs():
    """README's is run by test_readme."""
    (block,) = [block for block in PYTHON if block.page == DOCS / "api" / "index.md"]
    names = {}
    exec(compile(block.text, block.name, "exec"), names)
    gradient = names["heights"].grad.numpy()
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0
    truth = names["heights"].detach().numpy()
    assert np.sqrt(np.mean((names["result"].heights_m - truth) ** 2)) < 0.2 * np.sqrt(np.mean(truth**2))


# --------------------------------------------------------------------------- links


def anchors(page):
    """Anchors of a page's headings, as GitHub and MyST name them."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    headings = re.findall(r"^#+ (.+)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_images_exist(page):
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for link in re.findall(r"\]\((?!https?:)([^)\s]+)\)", text):
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        if target == DOCS / "gallery" / "index.rst":
            target = ROOT / "examples" / "gallery" / "GALLERY_HEADER.rst"
        assert target.is_file(), link
        if anchor:
            assert anchor in anchors(target), link


def test_plain_text_names_no_page():
    """A page is linked, not named: (docs/x.md) leads nowhere on the built pages."""
    for page in PAGES:
        unlinked = re.sub(r"\[[^\]]*\]\([^)]*\)", "", page.read_text(encoding="utf-8"))
        assert not re.findall(r"\(docs/\w+\.md\)", unlinked), page


def test_every_page_is_in_a_table_of_contents():
    reachable, waiting = set(), [DOCS / "index.md"]
    while waiting:
        page = waiting.pop()
        if page in reachable:
            continue
        reachable.add(page)
        for tree in re.findall(r"^```\{toctree\}\n(.*?)^```$", page.read_text(encoding="utf-8"), re.M | re.S):
            for entry in re.findall(r"^(?!:)(?:.* <)?([\w/-]+)>?$", tree, re.M):
                if entry != "gallery/index":
                    waiting.append(page.parent / f"{entry}.md")
    assert {page for page in PAGES if DOCS in page.parents} == reachable


def test_no_page_is_called_like_a_page_of_sphinx():
    """search.md would be overwritten by the page of the search field."""
    assert not {"search", "genindex", "py-modindex"} & {page.stem for page in DOCS.glob("*.md")}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_machine_is_named(page):
    assert not re.findall(r"(?<![\w.])/(?:work|root|home|tmp|mnt|opt)/", page.read_text(encoding="utf-8"))


def test_links_to_the_world_are_known():
    """An address that nobody looked at may not exist."""
    known = ("https://github.com/NVIDIA/warp", "https://plotly.com/javascript/")
    for page in PAGES:
        found = re.findall(r"\]\((https?:[^)\s]+)\)", page.read_text(encoding="utf-8"))
        assert set(found) <= set(known), page
