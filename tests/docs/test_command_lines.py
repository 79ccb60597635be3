"""Commands of the pages exist, have the options that they are given, and all are documented."""

import importlib
import re

import click
import pytest

from tests.docs.pages import COMMANDS, DOCS, FENCE, NSFC, PAGES, ROOT, ids


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
