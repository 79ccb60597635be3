"""The same on a GPU: image and gradient against the float64 oracle, float32, batches, refine."""

from functools import partial

import pytest
import torch

from nets.reconstruct.methods import create
from warp_caustics import CausticSimulator, Scene
from warp_caustics.cuda_graph import CudaGraph
from warp_caustics.device import start_device
from warp_caustics.energy import energy_budget
from warp_caustics.errors import InputError
from warp_caustics.oracle import oracle_image
from warp_caustics.reconstruct.base import CausticImage

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device"),
]

FAR = Scene(height_samples=10, image_pixels=20, screen_position_m=(1e-3, -2e-3, -0.02))
POINT = FAR.model_copy(update={"light_position_m": (4e-3, 2e-3, 0.1), "emission_half_angle_rad": 0.9})
EFFECTS = {"fresnel": True, "lamp_half_angle_rad": 0.02, "second_hits": "lost"}
TILTED = FAR.model_copy(update=EFFECTS | {"light_tilt_rad": (0.1, -0.05)})
POINT_EFFECTS = POINT.model_copy(update={"fresnel": True, "lamp_radius_m": 0.01, "second_hits": "lost"})


def bumpy(batch=None):
    generator = torch.Generator().manual_seed(0)
    shape = (10, 10) if batch is None else (batch, 10, 10)
    return 2e-4 * torch.randn(shape, generator=generator, dtype=torch.float64).abs()


def weights():
    return torch.randn(3, 20, 20, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


def gradient(simulator, heights):
    leaf = heights.to(simulator.device, simulator.dtype).requires_grad_()
    image = simulator(leaf)
    (image * weights().to(image)).sum().backward()
    return image.detach().cpu().double(), leaf.grad.cpu().double()


@pytest.mark.parametrize(
    "scene",
    [FAR, POINT, FAR.model_copy(update=EFFECTS), POINT_EFFECTS, TILTED],
    ids=["far", "point", "far, all effects", "point, all effects", "tilted, all effects"],
)
@pytest.mark.parametrize("placement", ["lattice", "stratified", "sobol", "random"])
@pytest.mark.parametrize("profile", ["gaussian", "spline"])
def test_image_and_gradient_match_the_oracle(scene, placement, profile):
    """float64 to 1e-8 of the largest value, float32 to 1e-3 in norm."""
    heights = bumpy()
    # The oracle looks for second hits at many points of every path.
    n_photons = 25 if scene.second_hits != "ignored" else 450
    arguments = {"placement": placement, "profile": profile, "n_photons": n_photons, "smoothing": 6.0, "device": "cuda"}
    simulator = CausticSimulator(scene, dtype=torch.float64, **arguments)
    image, grad = gradient(simulator, heights)
    positions = torch.cat([p for _, p in simulator.engine.chunks(1)]).cpu()
    leaf = heights.clone().requires_grad_()
    is_squeezed = placement == "lattice" and len(positions) >= scene.image_pixels**2
    expected = oracle_image(leaf, scene, positions, 6.0, profile, is_squeezed)
    (expected * weights()).sum().backward()
    assert float((image - expected.detach()).abs().max()) <= 1e-8 * float(expected.abs().max())
    assert float((grad - leaf.grad).abs().max()) <= 1e-8 * float(leaf.grad.abs().max())
    image32, grad32 = gradient(CausticSimulator(scene, **arguments), heights)
    if placement == "lattice":
        # Scattered photons are drawn in the simulator's precision: float32 ones are not quite the same photons.
        assert float((image32 - image).norm()) <= 1e-3 * float(image.norm())
        assert float((grad32 - grad).norm()) <= 1e-3 * float(grad.norm())


def test_large_reliefs_match_the_cpu():
    """Spline matrices by blocks, through graphs as well: more samples than go by whole matrices."""
    scene = FAR.model_copy(update={"height_samples": 600})
    heights = 1e-5 * torch.randn(2, 600, 600, generator=torch.Generator().manual_seed(0), dtype=torch.float64).abs()
    expected = gradient(CausticSimulator(scene, n_photons=300**2, dtype=torch.float64), heights.clone())
    simulator = CausticSimulator(scene, n_photons=300**2, dtype=torch.float64, device="cuda")
    assert simulator.engine.spline.by_blocks
    for _ in range(3):
        for found, other in zip(gradient(simulator, heights), expected, strict=True):
            assert float((found - other).abs().max()) <= 1e-10 * float(other.abs().max())


def test_batch_equals_singles():
    simulator = CausticSimulator(FAR, n_photons=900, device="cuda", dtype=torch.float64)
    stack = bumpy(3)
    images, grads = gradient(simulator, stack)
    for k in range(3):
        image, grad = gradient(simulator, stack[k])
        torch.testing.assert_close(images[k], image, rtol=0, atol=1e-12 * float(image.max()))
        torch.testing.assert_close(grads[k], grad, rtol=0, atol=1e-12 * float(grad.abs().max()))


def test_energy_budget_closes():
    simulator = CausticSimulator(FAR, "paper", n_photons=50000, device="cuda")
    budget = energy_budget(simulator, bumpy().float().cuda() * 20)
    fates = ("landed", "off_screen", "reflected", "unlit", "not_finite")
    for channel in range(3):
        assert sum(budget[name][channel] for name in fates) == pytest.approx(1.0, abs=1e-9)


def test_refine_runs_and_reduces_the_residual():
    scene = Scene(height_samples=32, image_pixels=64)
    truth = torch.nn.functional.avg_pool2d(torch.rand(1, 38, 38) * 2e-4, 7, 1)[0].cuda()
    image = CausticSimulator(scene, n_photons=397**2, device="cuda")(truth).cpu().numpy()
    result = create("refine", scene, device="cuda", max_iterations=30).reconstruct(CausticImage(image))
    assert result.residual < 0.3 * result.history[0]["residual"] + 0.01


def test_replayed_graphs_give_what_launches_give(monkeypatch):
    """First call launches, later ones replay; new heights, new gradients, and other simulators in between."""
    import warp_caustics.engine as engine

    def results(scale):
        simulator = CausticSimulator(FAR, n_photons=900, device="cuda", dtype=torch.float64)
        return [gradient(simulator, bumpy() * k * scale) for k in (1.0, 0.5, 0.8)]

    replayed = results(1.0), results(0.7)
    monkeypatch.setattr(engine, "MAX_GRAPH_PHOTONS", 0)
    for found, expected in zip(replayed, (results(1.0), results(0.7)), strict=True):
        for (image, grad), (image_launched, grad_launched) in zip(found, expected, strict=True):
            torch.testing.assert_close(image, image_launched, rtol=0, atol=1e-12 * float(image_launched.max()))
            torch.testing.assert_close(grad, grad_launched, rtol=0, atol=1e-12 * float(grad_launched.abs().max()))


def test_impossible_heights_are_refused_through_graphs():
    """The host learns what the heights are while the GPU simulates, in whatever order good and bad ones come."""
    simulator = CausticSimulator(FAR, n_photons=900, device="cuda")
    good, holed, empty = (bumpy().float().cuda() for _ in range(3))
    holed[3, 4], empty[7, 2] = -1.0, torch.nan
    expected = simulator(good)
    for _ in range(20):
        with pytest.raises(InputError, match="cuts through the plate"):
            simulator(holed)
        torch.testing.assert_close(simulator(good), expected, rtol=1e-5, atol=1e-5 * float(expected.max()))
        with pytest.raises(InputError, match=r"at index \[7, 2\] is not finite"):
            simulator(empty)


def test_heights_may_be_on_another_gpu():
    """And come and go between places in memory, through graphs that read them where they are."""
    simulator, there = CausticSimulator(FAR, n_photons=900, device="cuda:0"), f"cuda:{torch.cuda.device_count() - 1}"
    one, other = bumpy().float(), 0.5 * bumpy().float()
    expected = [CausticSimulator(FAR, n_photons=900)(heights) for heights in (one, other)]
    for device in ("cuda:0", there, "cuda:0", there):
        for heights, image in zip((one, other), expected, strict=True):
            moved = torch.stack([heights, heights]).to(device)[1].T.contiguous().T  # a view that is not contiguous
            found = simulator(moved)
            assert found.device == simulator.device
            torch.testing.assert_close(found.cpu(), image, rtol=1e-3, atol=1e-4 * float(image.max()))
            leaf = moved.clone().requires_grad_()
            simulator(leaf).sum().backward()
            assert leaf.grad.device == leaf.device and bool(leaf.grad.isfinite().all())


def test_deferred_wide_footprints_are_not_lost(monkeypatch):
    """A far screen behind a steep relief has footprints of all sizes; deferring changes nothing but the order."""
    import warp_caustics.optics as optics

    scene = Scene(height_samples=16, image_pixels=256, screen_position_m=(0, 0, -0.05))
    heights = torch.nn.functional.interpolate(bumpy()[None, None] * 5, (16, 16), mode="bicubic")[0, 0].cuda()
    images = []
    for wide in (8, 10**9):
        monkeypatch.setattr(optics, "WIDE_PIXELS", wide)
        simulator = CausticSimulator(scene, n_photons=300**2, device="cuda", dtype=torch.float64)
        leaf = heights.clone().requires_grad_()
        image = simulator(leaf)
        image.square().sum().backward()
        images.append((image.detach(), leaf.grad))
    for few, many in zip(*images, strict=True):
        torch.testing.assert_close(few, many, rtol=0, atol=1e-10 * float(many.abs().max()))


def test_too_large_a_batch_says_what_fits():
    """The message names the need, the free memory and a batch that would do."""
    from warp_caustics.errors import ResourceError

    simulator = CausticSimulator(Scene(height_samples=8, image_pixels=8192), n_photons=64, device="cuda")
    with pytest.raises(ResourceError, match="use batches of at most"):
        simulator(torch.zeros(300, 8, 8, device="cuda"))


@pytest.mark.parametrize("preset", ["lattice", "paper"])
def test_channels_together_change_nothing(monkeypatch, preset):
    """Packed images give what channel by channel gives, to float32's rounding."""
    import warp_caustics.fused as fused

    scene = Scene(height_samples=16, image_pixels=256, screen_position_m=(0, 0, -0.05))
    heights = torch.nn.functional.interpolate(bumpy()[None, None] * 5, (16, 16), mode="bicubic")[0].float().cuda()
    results = []
    for arch in (90, 10_000):
        monkeypatch.setattr(fused, "PACKED_ARCH", arch)
        simulator = CausticSimulator(scene, preset, n_photons=300**2, device="cuda")
        leaf = heights.repeat(3, 1, 1).requires_grad_()
        image = simulator(leaf)
        image.square().sum().backward()
        results.append((image.detach(), leaf.grad))
        is_new = torch.cuda.get_device_capability()[0] >= 9
        assert (simulator.engine.fused.width == 3) == (arch == 90 and is_new)
    for found, expected in zip(*results, strict=True):
        assert float((found - expected).norm()) <= 1e-5 * float(expected.norm())


@pytest.mark.skipif(torch.cuda.device_count() < 2, reason="needs two CUDA devices")
def test_a_second_gpu_simulates_as_the_first_does():
    # Recorded on the first GPU, its graphs were empty: heights had no extremes.
    images = []
    try:
        for device in ("cuda:0", "cuda:1"):
            simulator = CausticSimulator(FAR, device=start_device(device))
            heights = bumpy().to(device, torch.float32)
            images.append([simulator(heights).cpu() for _ in range(3)][-1])
    finally:
        start_device("cuda:0")
    torch.testing.assert_close(*images)


def test_graphs_of_a_thread_share_their_memory():
    """A descent records one for each bench it looks at: each with memory of its own they took 8 GiB for a plate."""
    values, one = 1 << 24, torch.ones(1, device="cuda")

    def call(x, factor):
        return (x.expand(values) * factor).square().sum()

    assert float(call(one, 1)) == values
    torch.cuda.empty_cache()
    before = torch.cuda.memory_reserved()
    graphs = [CudaGraph(partial(call, factor=factor), (one,)) for factor in range(1, 9)]
    needed = 2 * 4 * values
    assert torch.cuda.memory_reserved() - before < 3 * needed
    for _ in range(2):
        found = [graph(one) for graph in graphs]
        assert [float(each) / values for each in found] == [factor**2 for factor in range(1, 9)]
    del graphs[:7]
    again = CudaGraph(partial(call, factor=10), (one,))
    assert float(graphs[0](one)) / values == 64 and float(again(one)) / values == 100
