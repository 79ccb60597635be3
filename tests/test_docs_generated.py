"""What the documentation is generated from, and by: tables of the code, formulas, pages without a network."""

import importlib
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
FENCE = re.compile(r"^```.*?^```$", re.M | re.S)
FORMULA_PAGES = [page for page in sorted(DOCS.rglob("*.md")) if "$$" in page.read_text(encoding="utf-8")]


@pytest.fixture
def extensions(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS / "_ext"))
    yield importlib.import_module
    for name in ("config_keys", "api_modules", "mathml", "offline", "python_names"):
        sys.modules.pop(name, None)


def leaves(tree, prefix=""):
    for key, value in tree.items():
        if isinstance(value, dict) and value:
            yield from leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}"


def test_every_key_of_the_configuration_is_explained(extensions):
    from cli.config import Config

    rows = extensions("config_keys").table(Config).splitlines()[2:]
    cells = {row.split("|")[1].strip(" `"): row.split("|") for row in rows}
    assert set(cells) == set(leaves(Config().model_dump(mode="json")))
    assert not [key for key, row in cells.items() if not re.search("[a-z]{3}", row[3].partition(";")[0])]
    # Defaults and limits as pydantic has them.
    assert cells["scene.image_pixels"][2] == " `512` "
    assert cells["scene.image_pixels"][3].endswith("; >= 2, <= 8192 ")
    assert cells["denoiser.c_init"][2] == " `31` "


def test_every_method_has_its_options_listed():
    from nets.reconstruct.methods import ALL_METHODS

    text = (DOCS / "options.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^## `([\w-]+)`$", text, re.M)) == set(ALL_METHODS) - {"auto"}
    for module, model in re.findall(r"^\{config-keys\} ([\w.]+):(\w+)", text, re.M):
        assert hasattr(importlib.import_module(module), model)


def test_every_package_has_a_page(extensions):
    """A new package of the program needs one; kernels cannot be described."""
    text = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md"))
    named = set(re.findall(r"^\{api-modules\} ([\w.]+)$", text, re.M))
    packages = {
        ".".join(path.parent.relative_to(ROOT).parts)
        for top in ("warp_caustics", "data_gen", "nets", "cli")
        for path in (ROOT / top).rglob("__init__.py")
    }
    assert named == packages - {"warp_caustics.kernels"}
    assert "warp_caustics.scene" in extensions("api_modules").modules_of("warp_caustics")


FORMULA = re.compile(r"\$\$(.+?)\$\$|(?<![\\$])\$([^$\n]+)\$(?!\$)", re.S)


@pytest.mark.parametrize("page", FORMULA_PAGES, ids=lambda p: p.stem)
def test_formulas_become_mathml(page, extensions):
    mathml = extensions("mathml")
    formulas = FORMULA.findall(FENCE.sub("", page.read_text(encoding="utf-8")))
    assert formulas
    for block, inline in formulas:
        assert mathml.unknown_in(mathml.to_mathml(block or inline, "block")) == []


def test_the_font_of_formulas_knows_how_to_set_them(extensions, tmp_path):
    from fontTools.ttLib import TTFont

    extensions("mathml").write_font(tmp_path / "font.woff")
    font = TTFont(tmp_path / "font.woff")
    assert font["MATH"].table.MathConstants.SubscriptShiftDown.Value > 0
    assert {ord("∂"), ord("Σ"), ord("√"), 0x1D465} <= set(font.getBestCmap())


def test_an_unknown_formula_is_noticed(extensions):
    mathml = extensions("mathml")
    assert mathml.unknown_in(mathml.to_mathml(r"\nosuchcommand x", "inline")) == [r"\nosuchcommand"]


def test_exit_codes_are_the_same_wherever_they_are_listed():
    table = re.compile(r"^\| (\d+) \| ([^|;]+?) ?[|;]", re.M)
    readme = dict(table.findall((ROOT / "README.md").read_text(encoding="utf-8").split("### Exit codes")[1]))
    assert readme == dict(table.findall((DOCS / "commands" / "index.md").read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    "page",
    [
        '<script async src="https://cdn.example/mathjax.js"></script>',
        '<link href="//fonts.example/x.css" rel="stylesheet">',
        "<style>@import 'https://fonts.example/x.css';</style>",
        "<style>body { background: url(https://a.example/b.png) }</style>",
    ],
)
def test_pages_that_need_a_network_are_noticed(page, extensions):
    offline = extensions("offline")
    assert len(offline.loaded_from_elsewhere(page)) == 1
    assert offline.loaded_from_elsewhere('<a href="https://a.example">a</a><script src="_static/a.js"></script>') == []


def test_names_of_objects_are_found_as_sphinx_finds_them(extensions):
    """Those that end as an object does by Sphinx itself; others need no search, once all pages are read."""
    from types import SimpleNamespace

    from sphinx.domains.python import ObjectEntry, PythonDomain

    names = extensions("python_names")
    objects = {name: ObjectEntry("page", name, kind, False) for name, kind in OBJECTS.items()}
    environment = SimpleNamespace(domaindata={"py": {"objects": objects, "version": PythonDomain.data_version}})
    environment.domains = SimpleNamespace(python_domain=names.PythonNames(environment))
    own, quick = PythonDomain(environment), environment.domains.python_domain
    names._collect(None, environment)
    found = 0
    for name in ("Scene", "scene.Scene", "field", "Scene.field", "make()", "float", "cene", "np.ndarray", ""):
        for role in ("class", "func", "obj", None):
            for place in (("", ""), ("optics.scene", ""), ("optics.scene", "Scene")):
                for mode in (0, 1):
                    expected = own.find_obj(environment, *place, name, role, mode)
                    assert quick.find_obj(environment, *place, name, role, mode) == expected
                    found += bool(expected)
    assert found > 20
    assert quick.last_parts == {"scene", "Scene", "field", "make"}


OBJECTS = {
    "optics.scene": "module",
    "optics.scene.Scene": "class",
    "optics.scene.Scene.field": "attribute",
    "optics.scene.make": "function",
    "sets.scene.Scene": "class",
}
