"""The public names: each imports, says what it is, stands in the interface's documentation and has one path there."""

import ast
import importlib
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
DOORS = ("warp_caustics", "nets", "data_gen")
PUBLIC = [(door, name) for door in DOORS for name in importlib.import_module(door).__all__]
FENCE = re.compile(r"^```python\n(.*?)^```$", re.M | re.S)


@pytest.fixture(scope="module")
def api():
    """The extension that documents front doors."""
    sys.path.insert(0, str(DOCS / "_ext"))
    yield importlib.import_module("api_modules")
    sys.path.remove(str(DOCS / "_ext"))
    sys.modules.pop("api_modules")


@pytest.mark.parametrize(("door", "name"), PUBLIC)
def test_public_names_import_and_say_what_they_are(door, name, api):
    found = getattr(importlib.import_module(door), name)
    assert found is getattr(importlib.import_module(api.home_of(door, name)), name)
    assert getattr(found, "__module__", api.home_of(door, name)) == api.home_of(door, name), "defined elsewhere"
    assert len(api.first_sentence(door, name)) > 5, "say in a docstring what it is"


@pytest.mark.parametrize("door", DOORS)
def test_public_names_stand_in_the_interface(door, api):
    """In the table of the front door, and in full on the page of the package that defines them."""
    pages = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md"))
    assert f"{{front-door}} {door}\n" in (DOCS / "api" / "index.md").read_text(encoding="utf-8")
    described = {module for package in api.LINE.findall(pages) for module in api.modules_of(package)}
    table = api.table_of(door)
    for name in importlib.import_module(door).__all__:
        assert api.home_of(door, name) in described
        assert f"`{name} <" in table


@pytest.mark.parametrize("door", DOORS)
def test_type_checkers_see_what_is_there(door):
    """The names imported for them are those of ``__all__``, from the same modules."""
    package = importlib.import_module(door)
    (block,) = [node for node in ast.parse(Path(package.__file__).read_text()).body if isinstance(node, ast.If)]
    seen = {alias.asname: node.module for node in block.body for alias in node.names}
    assert seen == package._HOMES
    assert sorted(set(package.__all__)) == package.__all__
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        package.nothing  # noqa: B018


def test_no_name_has_two_front_doors():
    names = [name for _, name in PUBLIC]
    assert len(names) == len(set(names))


def examples():
    """Python that readers see: README, pages, gallery."""
    for page in (ROOT / "README.md", *sorted(DOCS.rglob("*.md"))):
        for block in FENCE.findall(page.read_text(encoding="utf-8")):
            yield page.relative_to(ROOT), block
    for script in sorted((ROOT / "examples" / "gallery").glob("plot_*.py")):
        yield script.relative_to(ROOT), script.read_text(encoding="utf-8")


def test_examples_come_in_by_the_front_door():
    doors = {name: door for door, name in PUBLIC}
    for where, text in examples():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in DOORS:
                for alias in node.names:
                    home = doors.get(alias.name)
                    # build, of nets and of data_gen.store, are two things.
                    is_same = home and getattr(importlib.import_module(node.module), alias.name) is getattr(
                        importlib.import_module(home), alias.name
                    )
                    assert not is_same or node.module == home, f"{where}: {alias.name} is public in {home}"


@pytest.mark.parametrize("package", ["warp_caustics", "data_gen", "nets", "cli"])
def test_packages_are_typed(package):
    """PEP 561: type checkers of other projects believe the annotations of what is installed."""
    assert (ROOT / package / "py.typed").is_file()
