"""Rows of lattice photons on a CPU against the kernels that take photon by photon, and changes of some of them."""

import pytest
import torch

from warp_caustics import CausticSimulator, Scene, lattice_rows
from warp_caustics.errors import InputError

SCENE = Scene(height_samples=20, image_pixels=48, exit_medium="glass")
FAR = {"screen_position_m": (1e-3, -2e-3, -0.02), "exit_medium": "air"}

ALL_EFFECTS = {"fresnel": True, "lamp_half_angle_rad": 0.02, "second_hits": "lost", "plate_size_m": (0.01, 0.01)}
"""On a plate so small that light meets narrow hills again."""

POINT = {"light_position_m": (4e-3, 2e-3, 0.1), "emission_half_angle_rad": 0.9}
POINT_EFFECTS = {**ALL_EFFECTS, "lamp_half_angle_rad": 0.0, "lamp_radius_m": 0.015}

CASES = {
    "contact": ({}, 96**2),
    "far and off centre": (FAR, 96**2),
    "all effects": (ALL_EFFECTS, 80**2),
    "all effects, far, tilt": ({**FAR, **ALL_EFFECTS, "light_tilt_rad": (0.02, -0.01)}, 80**2),
    "tilt": ({"light_tilt_rad": (0.02, -0.01)}, 80**2),
    "point light": (POINT, 80**2),
    "point light in a narrow cone": ({**POINT, "emission_half_angle_rad": 0.15}, 80**2),
    "all effects, far, point light": ({**FAR, **POINT_EFFECTS, **POINT}, 80**2),
    "out of sight": ({"screen_position_m": (1.0, 0.0, -1e-6)}, 80**2),
    "half out of sight": ({"screen_position_m": (0.009, -0.007, -1e-6)}, 80**2),
    "fewer photons than samples": ({}, 11**2),
    "more photons in a cell than a vector holds": ({"height_samples": 6}, 200**2),
    "oblong": ({"plate_size_m": (0.02, 0.013)}, 7001),
    "pixels fewer than a window": ({"image_pixels": 5}, 60**2),
    "footprints over more rows than are done at once": ({"image_pixels": 400}, 40**2),
}


def relief(scene: Scene, batch: int = 1, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    """Smooth and steep in places: footprints of all widths; narrow hills where light may meet them again."""
    n = scene.height_samples
    rough = torch.rand(batch, 1, n, n, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    smooth = torch.nn.functional.avg_pool2d(rough, 3, 1, 1) if scene.second_hits == "ignored" else rough * (rough > 0.8)
    return (1.5e-3 * smooth * torch.linspace(0, 1, n) ** 2)[:, 0].to(dtype)


def both(
    simulator: CausticSimulator, heights: torch.Tensor, weights: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    engine = simulator.engine
    return engine.image(heights), engine.image_adjoint(heights, weights)


def one_by_one(simulator: CausticSimulator) -> CausticSimulator:
    """The same without rows."""
    other = CausticSimulator(
        simulator.scene, n_photons=simulator.plan.requested, dtype=simulator.dtype, profile=simulator.profile
    )
    other.engine.rows = None
    return other


EFFECTS = ("all effects", "all effects, far, tilt", "tilt", "point light in a narrow cone")
"""Cases with kernels of their own, which are compiled for float64 alone. An effect only adds code to a kernel: those
with all of them hold every part, for light from straight above, slanting light and a point source."""


@pytest.mark.parametrize(
    ("name", "dtype"),
    [(name, torch.float64) for name in CASES] + [(name, torch.float32) for name in CASES if name not in EFFECTS],
)
def test_rows_are_the_photons_one_by_one(name, dtype):
    """Image and gradient, to rounding: borders, windows of every width, all effects."""
    changes, n_photons = CASES[name]
    scene = Scene(**{**SCENE.model_dump(), **changes})
    simulator = CausticSimulator(scene, n_photons=n_photons, dtype=dtype)
    assert simulator.engine.rows is not None
    heights = relief(scene, 2, dtype)
    shape = 2, scene.n_wavelengths, scene.image_pixels, scene.image_pixels
    weights = torch.randn(shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64).to(dtype)
    found, expected = both(simulator, heights, weights), both(one_by_one(simulator), heights, weights)
    tolerance = 1e-10 if dtype == torch.float64 else 2e-4
    for a, b in zip(found, expected, strict=True):
        assert float((a - b).abs().max()) <= tolerance * float(b.abs().max())
    assert (float(expected[0].max()) == 0) == (name == "out of sight")
    if scene.second_hits == "lost":
        engine = simulator.engine
        ((_, positions),) = engine.chunks(1)
        assert (engine.clear_paths(engine.coefficients(heights), engine.photons(positions)) == 0).any()
    if name != "out of sight":
        assert float(found[0].double().sum() / expected[0].double().sum() - 1) == pytest.approx(0, abs=1e-6)


def test_a_relief_does_not_know_its_neighbours(monkeypatch):
    """Bit for bit, however many images are summed at a time."""
    simulator = CausticSimulator(SCENE, n_photons=96**2)
    heights = relief(SCENE, 3, torch.float32)
    together = simulator(heights)
    monkeypatch.setattr(lattice_rows, "BATCH_BYTES", 1)
    assert torch.equal(simulator(heights), together)
    assert torch.equal(torch.stack([simulator(one) for one in heights]), together)


def test_other_photons_go_one_by_one():
    for options in ({"profile": "gaussian"}, {"placement": "stratified"}, {"preset": "paper"}):
        assert CausticSimulator(SCENE, n_photons=900, **options).engine.rows is None


def in_a_place(scene: Scene, heights: torch.Tensor) -> torch.Tensor:
    """The relief with a slanted ridge across a part of it, a bit higher or lower."""
    x = torch.arange(scene.height_samples, dtype=torch.float64)
    along, across = x[:, None] + 0.3 * x, x[:, None] - 0.3 * x - 2
    ridge = torch.exp(-(across**2)) * ((along > 3) & (along < 14))
    return heights + 2e-6 * ridge.to(heights)


@pytest.mark.parametrize("name", [name for name in CASES if name != "out of sight"])
def test_a_change_in_places_is_the_difference_of_both_images(name):
    """But for light that moves less than a thousandth of what moves most; narrow hills on which light is lost, too."""
    changes, n_photons = CASES[name]
    scene = Scene(**{**SCENE.model_dump(), **changes})
    simulator = CausticSimulator(scene, n_photons=n_photons, dtype=torch.float64)
    first = relief(scene)[0]
    second = in_a_place(scene, first)
    expected, found = simulator(second) - simulator(first), simulator.change(first, second)
    assert found.shape == expected.shape and float(expected.norm()) > 0
    assert float((found - expected).norm()) < 2e-3 * float(expected.norm())
    torch.testing.assert_close(simulator.change(second, first), -found)


def test_changes_are_found_together_as_one_by_one(monkeypatch):
    """Bit for bit, however many are a core's work; from one relief, and each from another."""
    simulator = CausticSimulator(SCENE, n_photons=96**2)
    first, *others = relief(SCENE, 4, torch.float32)
    others = torch.stack([*others, in_a_place(SCENE, first), first])
    together = simulator.change(first, others)
    assert together.shape == (5, SCENE.n_wavelengths, SCENE.image_pixels, SCENE.image_pixels)
    assert torch.equal(torch.stack([simulator.change(first, one) for one in others]), together)
    assert not together[-1].any()
    # Those of whole reliefs come to the border, too, where footprints reach over the sides.
    expected = simulator(others) - simulator(first)
    assert float((together - expected).norm()) < 1e-3 * float(expected.norm())
    apart = others.roll(1, 0)
    pairs = simulator.change(apart, others)
    assert torch.equal(torch.stack([simulator.change(*pair) for pair in zip(apart, others, strict=True)]), pairs)
    monkeypatch.setattr(lattice_rows, "STRIPS", 2)
    assert torch.equal(simulator.change(first, others), together)
    assert torch.equal(simulator.change(apart, others), pairs)


def test_cores_share_the_photons_of_changes(monkeypatch):
    """Each that made its own would free those of another, which reads them by their address."""
    simulator = CausticSimulator(SCENE, n_photons=96**2)
    first, asked, photons = relief(SCENE, 1, torch.float32)[0], [], simulator.engine.fused_photons
    monkeypatch.setattr(simulator.engine, "fused_photons", lambda *about: asked.append(about) or photons(*about))
    simulator.change(first, torch.stack(20 * [in_a_place(SCENE, first)]))
    assert len(asked) == 1


def test_of_a_change_only_light_that_it_touches_is_looked_at():
    """Of each row the columns between the first and the last that it touches; of most rows none."""
    scene = SCENE.model_copy(update={"height_samples": 64})
    simulator = CausticSimulator(scene, n_photons=160**2)
    first, engine = relief(scene, dtype=torch.float32)[0], simulator.engine
    change = engine.coefficients((in_a_place(scene, first) - first)[None])
    (touched,) = lattice_rows._touched(change.numpy())
    widths = (touched[:, 1] - touched[:, 0]).clip(0)
    assert 0 < widths.sum() < 0.1 * widths.size**2 and (widths == 0).mean() > 0.5
    for row, (begin, end) in enumerate(touched):
        outside = torch.cat([change[0, row, : max(begin, 0)], change[0, row, max(end, begin) :]])
        assert float(outside.abs().max()) <= lattice_rows.TOUCHED * float(change.abs().max())
    assert not simulator.change(first, first).any()


def test_changes_are_from_one_relief_or_as_many():
    simulator, flat = CausticSimulator(SCENE, n_photons=900), torch.zeros(3, 20, 20)
    assert simulator.change(flat[0], flat).shape == simulator.change(flat, flat).shape
    assert simulator.change(flat[:1], flat[0]).shape[:1] == (1,)
    with pytest.raises(InputError, match="3 reliefs change from 2 others"):
        simulator.change(flat[:2], flat)


def test_a_change_of_what_cannot_be_simulated_is_refused():
    simulator, flat = CausticSimulator(SCENE, n_photons=900), torch.zeros(20, 20)
    for wrong, why in (
        (torch.full((20, 20), torch.nan), "not finite"),
        (flat - 1, "cuts through"),
        (flat[:4], "shape"),
    ):
        for pair in ((flat, wrong), (wrong, flat)):
            with pytest.raises(InputError, match=why):
                simulator.change(*pair)


def test_a_change_of_other_photons_is_the_difference():
    first = relief(SCENE, dtype=torch.float32)[0]
    second = in_a_place(SCENE, first)
    simulator = CausticSimulator(SCENE, "paper", n_photons=3000)
    assert torch.equal(simulator.change(first, second), simulator(second) - simulator(first))
