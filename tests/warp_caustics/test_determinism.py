"""Sums that do not depend on the order of their terms: what GPUs do with --deterministic, run on the CPU."""

import warnings

import pytest
import torch

import warp_caustics.optics as optics
from nets.reconstruct.methods import create
from warp_caustics import CausticSimulator, Line, Scene, line_relief
from warp_caustics.determinism import VARIABLE, is_deterministic, make_deterministic, settle_gpu
from warp_caustics.errors import InputError
from warp_caustics.gathered_adjoint import gathered_in_order
from warp_caustics.kernels.fixed_point import MOST_STEPS
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.photons import PhotonPlan
from warp_caustics.reconstruct.base import CausticImage

# Not square: what is along x must not pass for what is along y.
SCENE = Scene(height_samples=10, image_pixels=20, plate_size_m=(0.05, 0.035), screen_position_m=(1e-3, -2e-3, -0.02))
EFFECTS = {"fresnel": True, "lamp_half_angle_rad": 0.02, "second_hits": "lost"}
TILTED = SCENE.model_copy(update=EFFECTS | {"light_tilt_rad": (0.05, -0.03)})
POINT = SCENE.model_copy(update={"light_position_m": (4e-3, 2e-3, 0.1), "emission_half_angle_rad": 0.9})

LATTICE, SCATTERED = ("lattice", "spline"), ("random", "gaussian")

FORMS = {
    "one thread each": {},
    "wide ones deferred": {"wide_pixels": 6.0},
    "several threads, wide ones deferred": {"lanes": 4, "wide_pixels": 6.0},
}


def as_on_a_gpu(scene, photons, dtype, is_fixed=True, lanes=1, wide_pixels=1e9):
    """A simulator that takes a GPU's kernels, in a form of which all promise the same."""
    placement, profile = photons
    simulator = CausticSimulator(scene, n_photons=900, smoothing=2.5, placement=placement, profile=profile, dtype=dtype)
    engine, fused = simulator.engine, simulator.engine.fused
    engine.rows, fused.defers, fused.is_fixed = None, True, is_fixed
    fused.width, fused.lanes, fused.adjoint_lanes = 1, lanes, lanes
    engine.optics.shared.wide_pixels = wide_pixels
    return simulator


def drawn(dtype=torch.float32):
    """Two reliefs [m], and weights for their images."""
    generator = torch.Generator().manual_seed(0)
    heights = 2e-4 * torch.randn(2, 10, 10, generator=generator, dtype=torch.float64).abs()
    return heights.to(dtype), torch.randn(2, 3, 20, 20, generator=generator, dtype=torch.float64).to(dtype)


def image_and_gradient(simulator):
    heights, weights = drawn(simulator.dtype)
    leaf = heights.requires_grad_()
    image = simulator(leaf)
    (image * weights).sum().backward()
    return image.detach(), leaf.grad


def shuffled(simulator, seed):
    """The same photons in another order."""
    for _, positions in simulator.engine.chunks(2):
        order = torch.randperm(len(positions), generator=torch.Generator().manual_seed(seed))
        positions.copy_(positions[order])
    return simulator


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
@pytest.mark.parametrize(
    ("scene", "photons"),
    [(SCENE, LATTICE), (TILTED, SCATTERED)],
    ids=["lattice", "scattered, all effects"],
)
def test_fixed_sums_are_the_floating_ones(scene, photons, form):
    """Image and gradient of float32 to 1e-6 of the largest value."""
    expected = image_and_gradient(as_on_a_gpu(scene, photons, torch.float32, is_fixed=False))
    found = image_and_gradient(as_on_a_gpu(scene, photons, torch.float32, **form))
    for a, b in zip(found, expected, strict=True):
        assert float((a - b).abs().max()) <= 1e-6 * float(b.abs().max())


@pytest.mark.parametrize("scene", [SCENE, POINT], ids=["collimated", "point"])
def test_float64_loses_little(scene):
    """Steps are 2e-12 of what a path brings; rounded to them, 900 paths err by less than that."""
    expected = image_and_gradient(as_on_a_gpu(scene, SCATTERED, torch.float64, is_fixed=False))
    found = image_and_gradient(as_on_a_gpu(scene, SCATTERED, torch.float64))
    for a, b in zip(found, expected, strict=True):
        assert 0 < float((a - b).abs().max()) <= 1e-12 * float(b.abs().max())


def test_the_order_of_photons_does_not_matter():
    """Floating sums differ between two orders; whole numbers do not, in image and gradient."""
    results = {
        is_fixed: [
            image_and_gradient(shuffled(as_on_a_gpu(SCENE, SCATTERED, torch.float32, is_fixed, wide_pixels=6.0), seed))
            for seed in (1, 2)
        ]
        for is_fixed in (False, True)
    }
    for k in (0, 1):
        assert not torch.equal(results[False][0][k], results[False][1][k])
        assert torch.equal(results[True][0][k], results[True][1][k])


def told(scenes, plan):
    """What kernels are told of scenes."""
    start_warp()
    return optics.Optics(scenes, plan, 2.5, "spline", torch.device("cpu"), torch.float32)


@pytest.mark.parametrize("pixels", [2, 64, 512, 8192])
@pytest.mark.parametrize("radiosity", [2e-12, 1.0, 1e12])
@pytest.mark.parametrize("n_photons", [1, 10**6, 10**10])
def test_no_pixel_can_overflow(pixels, radiosity, n_photons):
    """All paths as bright as they may be, in one pixel; and steps that float32 can hold."""
    scene = Scene(image_pixels=pixels, radiosity_W_m2=(radiosity, 0.0, radiosity / 2))
    plan = PhotonPlan(scene, "random", n_photons)
    found = told([scene], plan)
    assert n_photons * found.shared.most_steps <= MOST_STEPS * (1 + 1e-6)
    assert 0 < found.steps < torch.finfo(torch.float32).max
    # A step is at most 3e-8 of a flat plate's light, on the largest image; float32's own is 6e-8.
    assert found.steps * radiosity >= 2**25


def test_many_benches_share_their_steps():
    """Those of the brightest, whichever comes first."""
    scenes = [SCENE, SCENE.model_copy(update={"radiosity_W_m2": (40.0, 1.0, 1.0)})]
    plan = PhotonPlan(SCENE, "lattice", 900)
    steps = {told(some, plan).shared.steps for some in (scenes, scenes[::-1], scenes[1:])}
    assert len(steps) == 1
    assert steps.pop() < told(scenes[:1], plan).steps


def test_a_path_that_is_too_bright_is_cut_off():
    """Half the light of a flat plate's paths is taken for the most: every pixel has half of it."""
    simulator = as_on_a_gpu(SCENE, LATTICE, torch.float32)
    flat = torch.zeros(10, 10)
    whole = simulator(flat)
    shared = simulator.engine.optics.shared
    shared.most_steps = shared.most_steps / optics.BRIGHTEST / 2
    simulator.engine._lattices.clear()  # they hold a copy
    torch.testing.assert_close(simulator(flat), whole / 2, rtol=1e-6, atol=0)


@pytest.mark.parametrize("size", [0.0, 1e-300, 1.0, 1e200])
def test_gradients_of_any_size_are_shared_out(size):
    """Against floating sums, in float64; what is no number stays none."""
    simulator = as_on_a_gpu(SCENE, SCATTERED, torch.float64)
    engine = simulator.engine
    chunk, positions = next(iter(engine.chunks(2)))
    shape = (2, 14, 14)
    grad = size * torch.randn(2, 6, chunk.count, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    found = gathered_in_order(shape, engine.photons(positions), grad, SCENE.sample_pitch_m)
    engine.fused.is_fixed = False
    expected = engine.maps_adjoint(torch.zeros(shape, dtype=torch.float64), chunk, grad)
    assert bool(found.isfinite().all())
    assert float((found - expected).abs().max()) <= 1e-12 * float(expected.abs().max()) + 1e-210
    grad[1, 3, 5] = torch.nan
    found = gathered_in_order(shape, engine.photons(positions), grad, SCENE.sample_pitch_m)
    assert bool(found[0].isfinite().all()) and bool(found[1].isnan().all())


@pytest.mark.parametrize(("value", "expected"), [("", False), ("0", False), ("1", True)])
def test_it_is_asked_for_by_the_environment(monkeypatch, value, expected):
    monkeypatch.setenv(VARIABLE, value)
    assert is_deterministic() is expected
    make_deterministic()
    assert is_deterministic()


def test_a_value_that_is_neither_is_refused(monkeypatch):
    monkeypatch.setenv(VARIABLE, "yes")
    with pytest.raises(InputError, match="NSFC_DETERMINISTIC is 'yes', neither 0 nor 1; set it to 1"):
        is_deterministic()


@pytest.mark.parametrize("preset", ["lattice", "paper"])
def test_a_cpu_does_what_it_did(monkeypatch, preset):
    """The same bits, asked for or not, by the kernels that are a CPU's."""
    results = []
    for value in ("0", "1"):
        monkeypatch.setenv(VARIABLE, value)
        simulator = CausticSimulator(SCENE, preset, n_photons=5000)
        assert not simulator.engine.fused.is_fixed
        results.append(image_and_gradient(simulator))
    for a, b in zip(*results, strict=True):
        assert torch.equal(a, b)


@pytest.fixture
def torch_as_it_was(monkeypatch):
    """torch's settings, put back."""
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", "")
    monkeypatch.delenv("CUBLAS_WORKSPACE_CONFIG")
    cuda, cudnn = torch.backends.cuda, torch.backends.cudnn
    before = cudnn.benchmark, cudnn.deterministic, torch.utils.deterministic.fill_uninitialized_memory
    with warnings.catch_warnings():
        yield
    torch.use_deterministic_algorithms(False)
    cudnn.benchmark, cudnn.deterministic, torch.utils.deterministic.fill_uninitialized_memory = before
    for enable in (cuda.enable_flash_sdp, cuda.enable_mem_efficient_sdp, cuda.enable_cudnn_sdp):
        enable(True)


@pytest.mark.parametrize("is_asked", [False, True])
def test_torch_is_told(monkeypatch, torch_as_it_was, is_asked):
    monkeypatch.setenv(VARIABLE, str(int(is_asked)))
    torch.backends.cudnn.benchmark = True
    settle_gpu()
    assert torch.are_deterministic_algorithms_enabled() == is_asked
    assert torch.backends.cudnn.deterministic == is_asked
    assert torch.backends.cudnn.benchmark != is_asked
    assert torch.backends.cuda.mem_efficient_sdp_enabled() != is_asked


on_a_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")

FAR = Scene(height_samples=16, image_pixels=256, screen_position_m=(0, 0, -0.05))
"""Footprints of all sizes."""


@pytest.mark.gpu
@on_a_gpu
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=["float32", "float64"])
@pytest.mark.parametrize("preset", ["lattice", "paper"])
@pytest.mark.parametrize("changes", [{}, EFFECTS | {"light_tilt_rad": (0.05, -0.03)}], ids=["plain", "tilted, effects"])
def test_images_and_gradients_repeat_on_a_gpu(monkeypatch, torch_as_it_was, preset, dtype, changes):
    """Two simulators, each launched, recorded and replayed; near what is not asked to repeat."""
    monkeypatch.setattr(optics, "WIDE_PIXELS", 8)
    scene = FAR.model_copy(update=changes)
    heights = torch.nn.functional.interpolate(drawn(dtype)[0][:1, None] * 5, (16, 16), mode="bicubic")[0, 0].cuda()
    results = []
    for value in ("0", "1", "1"):
        monkeypatch.setenv(VARIABLE, value)
        simulator = CausticSimulator(scene, preset, n_photons=300**2, device="cuda", dtype=dtype)
        for _ in range(3):
            leaf = heights.clone().requires_grad_()
            image = simulator(leaf)
            image.square().sum().backward()
            results.append((image.detach(), leaf.grad))
    plain, first, *rest = results[2:]
    for k in (0, 1):
        assert float((first[k] - plain[k]).norm()) <= 1e-5 * float(plain[k].norm())
        assert all(torch.equal(found[k], first[k]) for found in rest)


@pytest.mark.gpu
@on_a_gpu
def test_heights_repeat_on_a_gpu(monkeypatch, torch_as_it_was):
    """A network, its symmetries, and the refinement on the exact model."""
    monkeypatch.setenv(VARIABLE, "1")
    scene = Scene()
    lines = [Line((-0.02, -0.01), (0.02, 0.01), 2e-3, 3e-4), Line((-0.01, 0.02), (0.015, -0.02), 3e-3, 4e-4)]
    relief = torch.tensor(line_relief(lines, 128, scene.plate_size_m), dtype=torch.float32, device="cuda")
    image = CausticImage(CausticSimulator(scene, device="cuda")(relief).cpu().numpy())
    found = [create("direct", scene, device="cuda").reconstruct(image) for _ in range(2)]
    assert (found[0].heights_m == found[1].heights_m).all()
    assert found[0].residual == found[1].residual
