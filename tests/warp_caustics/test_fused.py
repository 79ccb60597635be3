"""Variants of the fused kernels that only GPUs use, run on the CPU: same image, same gradient."""

import pytest
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics import fused as fused_module
from warp_caustics.fused import FusedPhotons
from warp_caustics.oracle import oracle_image

SCENE = Scene(height_samples=10, image_pixels=20, screen_position_m=(1e-3, -2e-3, -0.02))

ALL_EFFECTS = SCENE.model_copy(update={"fresnel": True, "lamp_half_angle_rad": 0.02, "second_hits": "lost"})


TILTED = ALL_EFFECTS.model_copy(update={"light_tilt_rad": (0.05, -0.03)})
"""By the general form of refraction."""


# A CPU takes a lattice of splines row by row (``rows``) where it is not told otherwise.


def add_together(fused):
    """All wavelengths of a photon at once, as on GPUs: these always leave wide footprints to a second launch."""
    fused.width, fused.defers = fused.channels, True


def image_and_gradient(
    lanes=1,
    defers=False,
    wide_pixels=None,
    profile="spline",
    placement="lattice",
    together=False,
    scene=SCENE,
    slots=None,
):
    """Simulate a batch of two with the fused kernels in the given variant."""
    simulator = CausticSimulator(
        scene, n_photons=900, smoothing=2.5, dtype=torch.float64, profile=profile, placement=placement
    )
    simulator.engine.rows = None
    fused = simulator.engine.fused
    if together:
        add_together(fused)
    if slots is not None:
        fused.max_blocks = slots
    fused.lanes = fused.adjoint_lanes = lanes
    fused.defers = fused.defers or defers
    if wide_pixels is not None:
        simulator.engine.optics.shared.wide_pixels = wide_pixels
    generator = torch.Generator().manual_seed(0)
    heights = 2e-4 * torch.randn(2, 10, 10, generator=generator, dtype=torch.float64).abs()
    weights = torch.randn(2, scene.n_wavelengths, 20, 20, generator=generator, dtype=torch.float64)
    leaf = heights.requires_grad_()
    image = simulator(leaf)
    (image * weights).sum().backward()
    return image.detach(), leaf.grad


# GPUs always defer; kernels of one lane and of four are compiled once for both of their variants.
VARIANTS = {
    "several lanes": {"lanes": 4, "defers": True, "wide_pixels": 1e9},
    "all deferred": {"defers": True, "wide_pixels": 0.0},
    "some deferred": {"defers": True, "wide_pixels": 6.0},
    "lanes and deferred": {"lanes": 4, "defers": True, "wide_pixels": 6.0},
}


@pytest.mark.parametrize("variant", VARIANTS.values(), ids=VARIANTS)
@pytest.mark.parametrize(
    ("placement", "profile", "scene"),
    # Kernels with all effects hold the code of those without.
    [("random", "gaussian", SCENE), ("lattice", "spline", ALL_EFFECTS)],
    ids=["random, gaussian", "lattice, all effects"],
)
def test_variant_changes_nothing(placement, variant, profile, scene):
    """Sharing a footprint between threads, or leaving it to another kernel, only changes the order of sums."""
    expected = image_and_gradient(profile=profile, placement=placement, scene=scene)
    found = image_and_gradient(profile=profile, placement=placement, scene=scene, **variant)
    for a, b in zip(found, expected, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12 * float(b.abs().max()))


@pytest.mark.parametrize("variant", [VARIANTS["lanes and deferred"], {"together": True, "wide_pixels": 6.0}])
def test_variants_of_the_general_form_change_nothing(variant):
    for a, b in zip(image_and_gradient(scene=TILTED, **variant), image_and_gradient(scene=TILTED), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12 * float(b.abs().max()))


@pytest.mark.parametrize(("profile", "placement"), [("spline", "lattice"), ("gaussian", "random")])
def test_a_thread_for_each_wavelength_changes_nothing(monkeypatch, profile, placement):
    """Few photons have one, many have one for all wavelengths; some are deferred either way."""
    arguments = {"profile": profile, "placement": placement, **VARIANTS["some deferred"]}
    launched = []
    launch = FusedPhotons._launch
    monkeypatch.setattr(FusedPhotons, "_launch", lambda self, *a: (launched.append(a[1]), launch(self, *a)))
    each = image_and_gradient(**arguments)
    monkeypatch.setattr(fused_module, "BY_WAVELENGTH", (0, 0))
    together = image_and_gradient(**arguments)
    for a, b in zip(each, together, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12 * float(b.abs().max()))
    assert (2, 3, 900) in launched and launched.count((2, 900, 1)) >= 3


def test_nothing_is_deferred_unless_asked_for():
    """The list of deferred footprints stays unread on the CPU; leaving them out would lose light."""
    lost, _ = image_and_gradient(wide_pixels=0.0)
    kept, _ = image_and_gradient()
    assert torch.equal(lost, kept)


def with_wavelengths(count, **changes):
    fields = {"wavelengths_m": (610e-9, 530e-9, 430e-9, 700e-9)[:count], "radiosity_W_m2": (1.0, 0.0, 2.0, 0.5)[:count]}
    return SCENE.model_copy(update=fields | changes)


PACKED_SCENES = {
    "three channels": (SCENE, None),
    "all in blocks": (SCENE, 0.0),
    "some in blocks": (SCENE, 6.0),
    "two channels, one dark": (with_wavelengths(2), 6.0),
    "four channels, one dark": (with_wavelengths(4), 6.0),
}


@pytest.mark.parametrize(
    ("case", "profile"),
    [
        (case, profile)
        for case in ("three channels", "all in blocks", "some in blocks")
        for profile in ("spline", "gaussian")
    ]
    # All effects are compared with the oracle, below. Neither profile knows how many channels there are.
    + [("two channels, one dark", "gaussian"), ("four channels, one dark", "spline")],
)
def test_channels_together_change_nothing(case, profile):
    """Packed images give what channel by channel gives, in value and gradient."""
    scene, wide_pixels = PACKED_SCENES[case]
    placement = "lattice" if profile == "spline" else "random"
    arguments = {"scene": scene, "profile": profile, "placement": placement}
    expected = image_and_gradient(**arguments)
    found = image_and_gradient(**arguments, wide_pixels=wide_pixels, together=True)
    for a, b in zip(found, expected, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12 * float(b.abs().max()))


@pytest.mark.parametrize("wide_pixels", [1e9, 30.0, 0.0])
def test_channels_far_apart_are_done_one_by_one(wide_pixels):
    """Behind a prism and a long way the colours are six pixels apart, footprints are one pixel wide."""
    scene = Scene(height_samples=10, image_pixels=400, screen_position_m=(-0.041, 0.0, -0.3))
    generator = torch.Generator().manual_seed(0)
    wedge = 0.3 * torch.linspace(0, 0.045, 10, dtype=torch.float64)
    heights = wedge + 2e-5 * torch.randn(1, 10, 10, generator=generator, dtype=torch.float64)
    weights = torch.randn(1, 3, 400, 400, generator=generator, dtype=torch.float64)
    results = []
    for together in (False, True):
        simulator = CausticSimulator(scene, n_photons=400, smoothing=0.3, dtype=torch.float64)
        engine = simulator.engine
        engine.rows = None
        if together:
            add_together(engine.fused)
        engine.optics.shared.wide_pixels = wide_pixels
        leaf = heights.clone().requires_grad_()
        image = simulator(leaf)
        (image * weights).sum().backward()
        results.append((image.detach(), leaf.grad))
    chunk, positions = next(iter(engine.chunks(1)))
    records = engine.records(engine.maps(engine.coefficients(heights), chunk, positions), positions)
    columns, sigmas = records[0, :, 0], records[0, :, 2].sqrt()
    assert float((columns.amax(0) - columns.amin(0) > 3 * sigmas.amax(0) + 2).double().mean()) > 0.5
    for expected, found in zip(*results, strict=True):
        assert float(expected.abs().max()) > 0
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-12 * float(expected.abs().max()))


@pytest.mark.parametrize("slots", [0, 7, 1000])
def test_a_full_list_of_blocks_loses_nothing(slots):
    """Wide footprints that find no room on the list are done at once."""
    expected = image_and_gradient()
    found = image_and_gradient(wide_pixels=0.0, together=True, slots=slots)
    for a, b in zip(found, expected, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12 * float(b.abs().max()))


@pytest.mark.parametrize("scene", [SCENE, ALL_EFFECTS], ids=["plain", "all effects"])
def test_packed_image_and_gradient_match_the_oracle(scene):
    """float64 to 1e-10 of the largest value, several blocks of rows per footprint included."""
    scene = scene.model_copy(update={"image_pixels": 80})
    simulator = CausticSimulator(scene, n_photons=400, smoothing=6.0, dtype=torch.float64)
    simulator.engine.rows = None
    add_together(simulator.engine.fused)
    simulator.engine.optics.shared.wide_pixels = 30.0
    generator = torch.Generator().manual_seed(0)
    heights = 2e-4 * torch.randn(10, 10, generator=generator, dtype=torch.float64).abs()
    weights = torch.randn(3, 80, 80, generator=generator, dtype=torch.float64)
    leaves = heights.clone().requires_grad_(), heights.clone().requires_grad_()
    positions = torch.cat([p for _, p in simulator.engine.chunks(1)])
    images = simulator(leaves[0]), oracle_image(leaves[1], scene, positions, 6.0, "spline")
    for image in images:
        (image * weights).sum().backward()
    for found, expected in ([image.detach() for image in images], [leaf.grad for leaf in leaves]):
        assert float((found - expected).abs().max()) <= 1e-10 * float(expected.abs().max())
