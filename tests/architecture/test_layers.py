"""No circle between files, and no arrow upward where an order is declared.

Every import counts: one inside a function and one for type checkers, too. A file that names a type of another cannot
be read without it, and an import that waits inside a function still makes both one thing to change. How an arrow is
drawn is told with it, because the three are mended differently.
"""

import importlib.util
from functools import cache
from pathlib import Path

import pytest

spec = importlib.util.spec_from_file_location("architecture_imports", Path(__file__).with_name("imports.py"))
graph = importlib.util.module_from_spec(spec)
spec.loader.exec_module(graph)

FILES = graph.modules(*graph.PACKAGES, "benchmarks")

LAYERS = {
    "warp_caustics": (
        "front_door types units strict errors signals child_process landings native_words one_thread determinism",
        "materials height_field metrics pixel_spline resampling cuda_graph banded relief_bounds",
        "scene",
        "io kernels presets",
        "photons chunked camera extremes way_of_light",
        "optics prints",
        "fused gathered_adjoint lattice_adjoint lattice_rows",
        "spline_stage",
        "engine",
        "simulator oracle",
        "thinned extrapolated",
        "many_scenes tape energy fold_fraction data_gradient device far_screen plan",
        "recorded_gradient",
        "setup capture reconstruct",
        "calibration",
        "inspection design found_bench",
    ),
    "warp_caustics.reconstruct": (
        "charbonnier",
        "objective plot",
        "trust",
        "rest hidden",
        "base",
        "colour_filters",
        "exposure folds volume pyramid run_log",
        "seen_camera",
        "result",
        "refine",
        "sfc transport",
        "methods",
    ),
    "data_gen": (
        "intervals variety",
        "making",
        "config",
        "shapes bench_ranges",
        "dataset_config",
        "sampler patterns",
        "reliefs store",
        "benches",
        "samples",
        "testset",
        "suites",
    ),
    "nets": (
        "config residual_config unrolling_config weights_file encoding replayed padding input_shapes symmetries"
        " told told_scene flat_light seen_scene rounded_weights wide_convolutions",
        "unet backbone told_maps",
        "denoiser updater direct_net unrolled_net",
        "architecture",
        "receptive weights",
        "scene_match denoised",
        "family unseen",
        "fitting_network",
        "shipped",
        "training reconstruct",
        "inspection search evaluation",
    ),
    "nets.reconstruct.fibres": (
        "options",
        "fibres_of",
        "image",
        "search bench",
        "shapes",
        "trust",
        "lines_result after_lines",
        "lines_of_image",
        "method",
    ),
}
"""Rooms of a package, lowest first: a room may import from its own line and from those before it."""

APART = {("nets.reconstruct", "nets.training"), ("nets.training", "nets.reconstruct"), ("benchmarks", "cli")}
"""The first must know nothing of the second."""


@cache
def arrows():
    """Read when a test asks: collecting tests needs no source."""
    return list(graph.arrows(FILES))


def is_in(module, package):
    return module == package or module.startswith(f"{package}.")


def level(package, module):
    """On which line of LAYERS a module's room stands; None where that is not declared."""
    room = module.removeprefix(f"{package}.").split(".")[0]
    return next((i for i, line in enumerate(LAYERS[package]) if room in line.split()), None)


def is_wrong(arrow):
    """Whether an arrow points up, or to where it must not."""
    if any(is_in(arrow.source, a) and is_in(arrow.target, b) for a, b in APART):
        return True
    for package in LAYERS:
        # A package's own front door knows everything in it.
        if all(name.startswith(f"{package}.") for name in (arrow.source, arrow.target)):
            source, target = level(package, arrow.source), level(package, arrow.target)
            if source is not None and target is not None and target > source:
                return True
    return False


def test_no_circle_between_files():
    found = graph.circles((arrow.source, arrow.target) for arrow in arrows())
    lines = [str(a) for group in found for a in arrows() if {a.source, a.target} <= group]
    assert not found, "files that need each other:\n" + "\n".join(sorted(lines))


def test_no_arrow_upward():
    wrong = [arrow for arrow in arrows() if is_wrong(arrow)]
    assert not wrong, "imports from above:\n" + "\n".join(map(str, wrong))


@pytest.mark.parametrize("package", ["warp_caustics", "data_gen", "nets", "nets.reconstruct.fibres"])
def test_every_room_has_its_place(package):
    """A new file or folder at the top of a package says in LAYERS between which others it stands."""
    rooms = {name.removeprefix(f"{package}.").split(".")[0] for name in FILES if name.startswith(f"{package}.")}
    assert rooms == {room for line in LAYERS[package] for room in line.split()}


@pytest.mark.parametrize("package", graph.PACKAGES)
def test_no_file_goes_round_by_the_front_door(package):
    """Within a package a name is imported from the file that defines it; the front door is for other programs."""
    wrong = [
        f"{source}: from {module} import {name}"
        for source, path in FILES.items()
        if is_in(source, package)
        for module, name, _ in graph.imports(path.read_text(encoding="utf-8"))
        if module == package and name is not None and f"{module}.{name}" not in FILES
    ]
    assert not wrong, "\n".join(wrong)


def write(folder, files):
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def test_the_check_sees_every_kind_of_import(tmp_path):
    types = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from p.a import A\n"
    write(
        tmp_path,
        {
            "p/__init__.py": "",
            "p/a.py": "from p.q import b\nimport numpy\n",
            "p/q/__init__.py": "",
            "p/q/b.py": "def f():\n    import p.c\n",
            "p/c.py": types,
            "p/d.py": "from p.a import A\n",
        },
    )
    found = list(graph.arrows(graph.modules("p", root=tmp_path)))
    assert {(a.source, a.target, a.how) for a in found} == {
        ("p.a", "p.q.b", "at the top"),
        ("p.q.b", "p.c", "in a function"),
        ("p.c", "p.a", "for types"),
        ("p.d", "p.a", "at the top"),
    }
    assert graph.circles((a.source, a.target) for a in found) == {frozenset({"p.a", "p.q.b", "p.c"})}


def test_the_check_tells_circles_apart():
    assert graph.circles([(1, 2), (2, 3), (3, 2), (3, 4), (4, 5), (5, 4), (1, 5)]) == {
        frozenset({2, 3}),
        frozenset({4, 5}),
    }
    assert graph.circles([(1, 2), (2, 3), (1, 3)]) == set()


@pytest.mark.parametrize(
    ("source", "target", "wrong"),
    [
        ("warp_caustics.scene", "warp_caustics.kernels.general", True),
        ("warp_caustics.engine", "warp_caustics.scene", False),
        ("warp_caustics.reconstruct.base", "warp_caustics.reconstruct.methods", True),
        ("nets.training.fit", "nets.reconstruct.direct", True),
        ("nets.search.study", "nets.training.fit", False),
        ("benchmarks.speed", "cli.main", True),
    ],
)
def test_the_check_knows_up_from_down(source, target, wrong):
    assert is_wrong(graph.Arrow(source, target, "at the top")) == wrong
