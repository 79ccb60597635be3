"""The camera operator: nothing off changes nothing, adjoints by the dot product, derivatives by differences, energy."""

import pytest
import torch

from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.geometry import gathered, upright_matrices
from warp_caustics.camera.mosaic import demosaicked, mosaicked
from warp_caustics.camera.operator import Camera, channels, even, placed
from warp_caustics.camera.parameters import CameraParameters, camera_parameters
from warp_caustics.camera.placement import Frame
from warp_caustics.camera.psf import psf_matrix
from warp_caustics.camera.radiometry import uneven_light
from warp_caustics.errors import InputError

from .conftest import EVERYTHING, UPRIGHT, WINDOW, camera, drawn

ALL = CameraParameters._fields
CAMERAS = {
    "everything": EVERYTHING,
    "upright": UPRIGHT,
    "window": WINDOW,
    "mosaic": UPRIGHT.model_copy(update={"mosaic": "grbg"}),
    "two camera channels": UPRIGHT.model_copy(update={"mixing": ((1.0, 0.2, 0.0), (0.0, 0.2, 1.0)), "gain": 1.0}),
    "corners": CameraConfig(frame_px=(48, 44), corners_px=((8, 7), (38, 9), (36, 37), (6, 35)), psf_px=0.5),
    "behind the screen": CameraConfig(frame_px=(48, 44), corners_px=((38, 9), (8, 7), (6, 35), (36, 37))),
}


# --------------------------------------------------------------------- nothing is off


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_perfect_camera_gives_the_image_itself(scene, image, dtype):
    assert torch.equal(Camera(CameraConfig(), scene, dtype=dtype)(image.to(dtype)), image.to(dtype))


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 2e-6), (torch.float64, 1e-14)])
def test_so_does_one_that_leaves_no_step_out(scene, image, dtype, tolerance):
    """Every operator at its neutral place is the identity, not only left out."""
    seen = Camera(CameraConfig(), scene, dtype=dtype, free=ALL)(image.to(dtype))
    assert (seen - image.to(dtype)).abs().max() < tolerance * image.max()


def test_a_free_camera_is_the_same_camera(scene, image):
    """Matrices along both axes and gathering are two ways to one result."""
    for config in (UPRIGHT, WINDOW):
        fast, slow = camera(config, scene), camera(config, scene, free=ALL)
        assert not fast.form.turns and slow.form.turns
        assert (fast(image) - slow(image)).abs().max() < 1e-13


def test_single_precision_is_near_double(scene, image):
    for name, config in CAMERAS.items():
        single = Camera(config, scene)(image.float())
        assert (single - camera(config, scene)(image)).abs().max() < 2e-5 * image.max(), name


@pytest.mark.parametrize("field", ALL)
def test_a_parameter_that_is_free_has_its_derivative(scene, image, field):
    """And takes no step that it does not need: placing upright is cheap, gathering is not."""
    model = camera(CameraConfig(), scene, free=(field,))
    full = camera(CameraConfig(), scene, free=ALL)
    y = drawn(*image.shape, seed=6)
    found = []
    for one in (model, full):
        at = getattr(one.parameters, field).clone().requires_grad_()
        (one(image, one.parameters._replace(**{field: at})) * y).sum().backward()
        found.append(at.grad)
    torch.testing.assert_close(found[0], found[1], atol=1e-9, rtol=1e-9)
    assert model.form.turns == (field in ("turn_rad", "homography"))
    assert model.form.blurs == (field in ("psf_px", "box_px"))


def test_a_parameter_that_is_none_is_refused(scene):
    with pytest.raises(InputError, match="did you mean 'psf_px'"):
        camera(CameraConfig(), scene, free=("psf",))


# --------------------------------------------------------------------- adjoints


def dot_product_error(forward, backward, x, y):
    """|<A x, y> - <x, A^T y>| relative to the norms, as SCICO's adjoint test has it."""
    ax, aty = forward(x), backward(y)
    assert ax.shape == y.shape and aty.shape == x.shape
    return float(((ax * y).sum() - (x * aty).sum()).abs() / (ax.norm() * y.norm()).clamp(min=1e-30))


@pytest.mark.parametrize("name", CAMERAS)
def test_adjoint_of_each_camera(scene, name):
    model = camera(CAMERAS[name], scene)
    for batch in ((), (2,)):
        x = drawn(*batch, 3, 24, 24)
        y = drawn(*model.linear(x).shape, seed=1)
        assert dot_product_error(model.linear, model.adjoint, x, y) < 1e-14


def test_the_operator_is_affine(scene, image):
    model = camera(EVERYTHING, scene)
    offset = model(torch.zeros_like(image))
    assert offset.min() > 0, "ambient light"
    torch.testing.assert_close(model(image) - offset, model.linear(image), atol=1e-13, rtol=0)
    both = model.linear(2 * image + image.flip(-1))
    torch.testing.assert_close(both, 2 * model.linear(image) + model.linear(image.flip(-1)), atol=1e-12, rtol=0)


def test_transposed_matrices_are_the_adjoint(scene):
    """By formula beside autograd: upright geometry and blur are products with matrices, and blur is symmetric."""
    model = camera(UPRIGHT, scene)
    p, form = model.parameters, model.form
    x, y = drawn(3, 24, 24), drawn(3, 36, 40, seed=1)
    along_x, along_y = upright_matrices(p, form.frame, 24, True)
    blur_x, blur_y = (psf_matrix(size, p.psf_px, p.box_px, form.reach) for size in form.frame)
    torch.testing.assert_close(blur_x, blur_x.transpose(-1, -2), atol=1e-15, rtol=0)
    light = uneven_light(p.light, 36, 40)
    weights = (p.mixing * p.gain[:, None]).T

    def backward(seen):
        inner = blur_y @ (light * torch.einsum("ij,jyx->iyx", weights, seen)) @ blur_x
        return along_y.transpose(-1, -2) @ inner @ along_x

    assert dot_product_error(model.linear, backward, x, y) < 1e-14
    torch.testing.assert_close(backward(y), model.adjoint(y), atol=1e-13, rtol=0)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "grbg", "gbrg"])
def test_adjoints_of_mosaic_and_demosaicing(pattern):
    """By autograd, of odd and even sizes."""
    for height, width in ((8, 10), (7, 9)):
        for forward, x in (
            (lambda signal: mosaicked(signal, pattern), drawn(2, 3, height, width)),
            (lambda raw: demosaicked(raw, pattern), drawn(2, height, width)),
        ):
            y = drawn(*forward(x).shape, seed=1)
            free = torch.zeros_like(x).requires_grad_()
            (back,) = torch.autograd.grad(forward(free), free, y)
            assert dot_product_error(forward, lambda _, back=back: back, x, y) < 1e-14


# --------------------------------------------------------------------- derivatives


def differences(function, value, step):
    """Central differences by each entry of a tensor, fourth order."""
    result = torch.zeros_like(value)
    for i in range(value.numel()):
        at = [value.clone() for _ in range(4)]
        for moved, factor in zip(at, (1, -1, 2, -2), strict=True):
            moved.view(-1)[i] += factor * step
        near, far = function(at[0]) - function(at[1]), function(at[2]) - function(at[3])
        result.view(-1)[i] = (8 * near - far) / (12 * step)
    return result


@pytest.mark.parametrize("field", CameraParameters._fields)
@pytest.mark.parametrize("kind", ["everything", "nothing"])
def test_derivative_by_each_parameter(scene, image, field, kind):
    """Against float64 differences, also where nothing is off, from where a fit begins."""
    model = camera(EVERYTHING if kind == "everything" else CameraConfig(), scene, free=ALL)
    y = drawn(*model(image).shape, seed=2)

    def value(changed):
        return (model(image, model.parameters._replace(**{field: changed})) * y).sum()

    at = getattr(model.parameters, field)
    free = at.clone().requires_grad_()
    value(free).backward()
    # So short that no pixel edge crosses the border of the window, where light begins with a kink.
    expected = differences(value, at, 1e-5)
    assert (free.grad - expected).abs().max() < 1e-7 * expected.abs().max() + 1e-9
    flat = kind == "nothing" and field in ("psf_px", "box_px")
    assert (expected.abs().max() > 1e-3) != flat, "a blur of 0 is a minimum, all else counts"


@pytest.mark.parametrize("config", [CameraConfig(frame_px=(31, 31)), CameraConfig(shift_px=(0.5, -0.5))])
@pytest.mark.parametrize("turns", [False, True])
def test_derivative_by_a_shift_where_pixels_lie_half_a_pixel_off(scene, image, config, turns):
    """There the middle of a spline is an edge; its tail was the minimum of two equal numbers, without a derivative."""
    model = Camera(config, scene, dtype=torch.float64, free=("shift_px", "turn_rad") if turns else ("shift_px",))

    def shown(shift):
        return model(image, model.parameters._replace(shift_px=shift))

    at, step = model.parameters.shift_px, torch.tensor([1e-5, 0.0], dtype=torch.float64)
    _, found = torch.func.jvp(shown, (at,), (torch.tensor([1.0, 0.0], dtype=torch.float64),))
    torch.testing.assert_close(found, (shown(at + step) - shown(at - step)) / 2e-5, atol=1e-7, rtol=1e-7)


@pytest.mark.parametrize("name", CAMERAS)
def test_derivative_by_the_image(scene, image, name):
    model = camera(CAMERAS[name], scene)
    y, direction = drawn(*model(image).shape, seed=2), drawn(*image.shape, seed=3)
    free = image.clone().requires_grad_()
    (model(free) * y).sum().backward()
    along = (model(image + direction) - model(image - direction)) / 2
    assert float((free.grad * direction).sum()) == pytest.approx(float((along * y).sum()), rel=1e-12)


def test_forward_derivatives_agree_with_backward_ones(scene, image):
    """Columns of a Jacobian are cheaper forwards: a camera has few parameters and many pixels."""
    model = camera(EVERYTHING, scene, free=ALL)
    shift = torch.tensor([1.0, 0.0], dtype=torch.float64)
    _, column = torch.func.jvp(
        lambda s: model(image, model.parameters._replace(shift_px=s)), (model.parameters.shift_px,), (shift,)
    )
    y = drawn(*column.shape, seed=4)
    free = model.parameters.shift_px.clone().requires_grad_()
    (model(image, model.parameters._replace(shift_px=free)) * y).sum().backward()
    assert float((column * y).sum()) == pytest.approx(float(free.grad[0]), rel=1e-10)


# --------------------------------------------------------------------- batches


def test_a_batch_of_cameras_is_each_of_them(scene, image):
    configs = [UPRIGHT, UPRIGHT.model_copy(update={"shift_px": (-0.2, 0.6), "psf_px": 0.5, "ambient": 0.1})]
    for free in ((), ALL):
        models = [camera(config, scene, free=free) for config in configs]
        batch = CameraParameters(*(torch.stack(v) for v in zip(*(m.parameters for m in models), strict=True)))
        images = torch.stack((image, image.flip(-1)))
        together = models[0](images, batch)
        for one, model, of in zip(together, models, images, strict=True):
            # Kernels are cut where the widest of the first camera is.
            torch.testing.assert_close(one, model(of), atol=1e-4, rtol=0)
        shared = models[0](image, batch)
        torch.testing.assert_close(shared[0], models[0](image), atol=1e-12, rtol=0)


def test_one_camera_for_many_images(scene, image):
    for config in (EVERYTHING, UPRIGHT):
        model, images = camera(config, scene), torch.stack((image, 2 * image, image.flip(-2)))
        torch.testing.assert_close(model(images), torch.stack([model(one) for one in images]), atol=1e-12, rtol=0)


# --------------------------------------------------------------------- energy and place


@pytest.mark.gpu
@pytest.mark.parametrize("name", CAMERAS)
def test_the_same_on_a_gpu(scene, image, name, device):
    there = Camera(CAMERAS[name], scene, device=device, dtype=torch.float64)
    here = camera(CAMERAS[name], scene)
    torch.testing.assert_close(there(image.to(device)).cpu(), here(image), atol=1e-10, rtol=0)
    y = drawn(*here(image).shape, seed=5)
    torch.testing.assert_close(there.adjoint(y.to(device)).cpu(), here.adjoint(y), atol=1e-10, rtol=0)


def test_parts_of_the_operator_are_public_functions(scene, image):
    """placed, even and channels in turn are what signal does, less the ambient light."""
    model = camera(UPRIGHT.model_copy(update={"ambient": 0.0}), scene)
    by_hand = channels(
        even(placed(image, model.parameters, model.form), model.parameters, model.form), model.parameters
    )
    assert torch.equal(by_hand, model.signal(image))
    p = camera_parameters(UPRIGHT, 3, 24, dtype=torch.float64)
    assert gathered(image, p, Frame(40, 36), True).shape == (3, 36, 40)
