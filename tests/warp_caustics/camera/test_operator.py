"""The camera operator: nothing off changes nothing, adjoints by the dot product, derivatives by differences, energy."""

import numpy as np
import pytest
import torch

from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.geometry import gathered, upright_matrices
from warp_caustics.camera.mosaic import demosaicked, mosaicked
from warp_caustics.camera.operator import Camera, channels, even, placed
from warp_caustics.camera.parameters import CameraParameters, camera_parameters
from warp_caustics.camera.placement import Frame
from warp_caustics.camera.psf import psf_matrix, psf_reach
from warp_caustics.camera.radiometry import uneven_light
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene

from .conftest import waves

EVERYTHING = CameraConfig(
    psf_px=(0.4, 0.5, 0.7),
    box_px=0.3,
    frame_px=(40, 36),
    shift_px=(0.31, -0.43),
    turn_rad=0.03,
    magnification=1.3,
    homography=((1.01, 0.02, 0.01), (-0.03, 0.99, 0.02), (0.02, -0.03, 1.0)),
    colour_shift_px=((0.3, 0.1), (0.0, 0.05), (-0.2, 0.17)),
    colour_scale=(0.001, 0.0, -0.002),
    light=((0.05, 0.02, 0.03, -0.01, 0.02), (0.04, 0.0, 0.0, 0.0, 0.01), (0.0, 0.0, 0.02, 0.0, 0.0)),
    ambient=(0.03, 0.02, 0.01),
    mixing=((0.9, 0.1, 0.0), (0.05, 0.9, 0.05), (0.0, 0.1, 0.9)),
    gain=(1.0, 1.1, 0.8),
)
UPRIGHT = EVERYTHING.model_copy(update={"turn_rad": 0.0, "homography": None})
WINDOW = UPRIGHT.model_copy(update={"frame_px": None, "magnification": 1.0})
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


def drawn(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def camera(config, scene, **more):
    return Camera(config, scene, dtype=torch.float64, **more)


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


def test_a_camera_conserves_light_in_its_frame(scene, image):
    """PSF, shift, another pixel size: the sum over the photo is that of the window by the size of pixels."""
    for magnification in (0.7, 1.0, 1.7):
        config = CameraConfig(frame_px=(64, 60), psf_px=1.2, shift_px=(0.31, 0.77), magnification=magnification)
        seen = camera(config, scene)(image)
        assert float(seen.sum()) == pytest.approx(float(image.sum()) * magnification**2, rel=1e-12)


def test_a_psf_conserves_light_also_at_the_border(scene, image):
    seen = camera(CameraConfig(psf_px=(0.4, 1.0, 2.0), box_px=1.5), scene)(image)
    torch.testing.assert_close(seen.sum((1, 2)), image.sum((1, 2)), rtol=1e-12, atol=0)


def test_an_even_field_stays_even(scene):
    seen = camera(WINDOW.model_copy(update={"light": (0.0,) * 5, "ambient": 0.0, "mixing": None, "gain": 1.0}), scene)
    one = torch.ones(3, 24, 24, dtype=torch.float64)
    assert (seen(one) - 1).abs().max() < 1e-13


@pytest.mark.parametrize("free", [(), ALL])
def test_whole_pixels_of_shift_are_exact(scene, image, free):
    seen = camera(CameraConfig(frame_px=(30, 32), shift_px=(2.0, -3.0)), scene, free=free)(image)
    expected = torch.zeros(3, 32, 30, dtype=torch.float64)
    expected[:, 1:25, 5:29] = image
    assert (seen - expected).abs().max() < 1e-12


@pytest.mark.parametrize(("period", "tolerance"), [(4.0, 2e-3), (6.0, 1.1e-4), (8.0, 2e-5)])
def test_a_shift_of_half_a_pixel_does_not_soften(period, tolerance):
    """The sinc of the training's cameras changes a wave of 6 px by 5e-3, linear interpolation by 0.13."""
    scene = Scene(image_pixels=96, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,))
    seen = camera(CameraConfig(shift_px=(0.5, 0.3)), scene)(waves(96, 96, period)[None])
    error = (seen[0] - waves(96, 96, period, 0.5, 0.3))[24:-24, 24:-24]
    assert error.abs().max() < tolerance


def test_colours_keep_their_place_to_a_thousandth_of_a_pixel():
    """Lines some pixels wide lie where shift and scale say, for 0.05 px between channels are harmful."""
    scene = Scene(image_pixels=96)
    shifts, scales = ((0.25, -0.1), (0.0, 0.0), (-0.05, 0.3)), (0.002, 0.0, -0.001)
    x = torch.arange(96, dtype=torch.float64)
    middle, place = 47.5, 61.0
    line = torch.exp(-0.5 * ((x - place) / 1.5) ** 2).expand(3, 96, 96)
    seen = camera(CameraConfig(colour_shift_px=shifts, colour_scale=scales), scene)(line)
    centre = (seen * x).sum(-1) / seen.sum(-1)
    for channel in range(3):
        expected = middle + (1 + scales[channel]) * (place - middle) + shifts[channel][0]
        assert (centre[channel, 10:-10] - expected).abs().max() < 1e-5


def test_the_psf_has_the_width_it_says():
    """Its transfer is that of the Gaussian times that of the square, at all frequencies within the band."""
    psf, box = torch.tensor([0.15, 0.5, 1.2], dtype=torch.float64), torch.tensor([0.0, 1.0, 0.7], dtype=torch.float64)
    matrix = psf_matrix(129, psf, box, psf_reach(1.2, 1.0))
    offset = torch.arange(129, dtype=torch.float64) - 64
    for omega in (0.3, 1.0, 2.0):
        found = (matrix[:, 64] * torch.cos(omega * offset)).sum(-1)
        expected = torch.exp(-0.5 * (psf * omega) ** 2) * torch.sinc(box * omega / (2 * np.pi))
        assert (found - expected).abs().max() < 3e-3


def test_a_quarter_turn_is_a_turned_array(scene, image):
    seen = camera(CameraConfig(turn_rad=np.pi / 2), scene)(image)
    # From x towards y: what lay on the right lies below, and below is the end of the rows.
    assert (seen - torch.rot90(image, -1, (-2, -1))).abs().max() < 1e-10


def test_corners_lie_where_they_were_put(scene):
    wanted = ((8.0, 7.0), (38.0, 9.0), (36.0, 37.0), (6.0, 35.0))
    model = camera(CameraConfig(frame_px=(48, 44), corners_px=wanted), scene)
    np.testing.assert_allclose(model.corners_px(), wanted, atol=1e-10)
    turned = camera(CameraConfig(frame_px=(48, 44), turn_rad=0.02, magnification=1.2, shift_px=(1.0, 2.0)), scene)
    middle = turned.corners_px().mean(axis=0)
    np.testing.assert_allclose(middle, (23.5 + 1, 21.5 + 2), atol=1e-10)
    sides = np.linalg.norm(np.diff(turned.corners_px(), axis=0), axis=1)
    np.testing.assert_allclose(sides, 1.2 * 24, rtol=1e-12)


def test_a_photo_from_the_side_shows_light_where_the_window_is():
    """Its middle lies where the map of an independent projective transform has it."""
    from skimage.transform import ProjectiveTransform

    scene = Scene(image_pixels=64, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,))
    corners = np.array(((20, 15), (95, 22), (90, 101), (12, 92)), dtype=float)
    model = camera(CameraConfig(frame_px=(112, 110), corners_px=tuple(map(tuple, corners))), scene)
    window = np.array(((-0.5, -0.5), (63.5, -0.5), (63.5, 63.5), (-0.5, 63.5)))
    there = ProjectiveTransform.from_estimate(window, corners)
    x = torch.arange(64, dtype=torch.float64)
    for place in ((20.0, 40.0), (50.5, 12.25)):
        spot = torch.exp(-0.5 * (((x - place[0]) / 2.5)[None, :] ** 2 + ((x - place[1]) / 2.5)[:, None] ** 2))[None]
        seen = model(spot)[0]
        rows, columns = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in seen.shape), indexing="ij")
        found = [float((seen * of).sum() / seen.sum()) for of in (columns, rows)]
        # Perspective moves the centre of a spot 2.5 px wide by a little.
        np.testing.assert_allclose(found, there(np.array([place]))[0], atol=0.05)


# --------------------------------------------------------------------- brightness


def test_uneven_light_is_one_in_the_mean():
    light = uneven_light(0.05 * drawn(4, 3, 5), 64, 48)
    assert light.shape == (4, 3, 64, 48)
    assert (light.mean(dim=(2, 3)) - 1).abs().max() < 1e-12 and light.std() > 0.01


def test_uneven_light_is_its_polynomial():
    coefficients = torch.tensor([[0.01, 0.02, 0.03, 0.04, 0.05]], dtype=torch.float64)
    y, x = np.mgrid[:40, :30].astype(float)
    x, y = (x + 0.5) / 15 - 1, (y + 0.5) / 20 - 1
    squares = (x**2 - (x**2).mean(), y**2 - (y**2).mean())
    expected = 1 + 0.01 * x + 0.02 * y + 0.03 * squares[0] + 0.04 * x * y + 0.05 * squares[1]
    np.testing.assert_allclose(uneven_light(coefficients, 40, 30)[0], expected, atol=1e-14)


def test_filters_gains_and_ambient_light_by_hand(scene):
    scene = scene.model_copy(update={"radiosity_W_m2": (1.0, 2.0, 4.0)})
    mixing = ((0.9, 0.1, 0.0), (0.0, 1.0, 0.0))
    model = camera(CameraConfig(mixing=mixing, gain=(1.0, 0.5), ambient=(0.1, 0.2, 0.3)), scene)
    image = torch.tensor([1.0, 3.0, 5.0], dtype=torch.float64)[:, None, None].expand(3, 24, 24)
    lit = np.array([1.0 + 0.1, 3.0 + 0.4, 5.0 + 1.2])
    expected = np.array([1.0, 0.5]) * (np.array(mixing) @ lit)
    np.testing.assert_allclose(model(image)[:, 3, 7], expected, rtol=1e-12)


# --------------------------------------------------------------------- mosaic


def test_each_pixel_of_a_mosaic_holds_its_colour():
    signal = torch.arange(3.0)[:, None, None].expand(3, 4, 4)
    assert mosaicked(signal, "rggb").tolist() == [[0, 1, 0, 1], [1, 2, 1, 2]] * 2
    assert mosaicked(signal, "gbrg").tolist() == [[1, 2, 1, 2], [0, 1, 0, 1]] * 2


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "grbg", "gbrg"])
def test_demosaicing_keeps_planes_of_light_and_the_mosaic(pattern):
    """Bilinear: exact for colours that change linearly, inside; and where a filter lies its value stays."""
    y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in (9, 12)), indexing="ij")
    signal = torch.stack((1 + 0.1 * x, 2 - 0.05 * y, 3 + 0.02 * x + 0.03 * y))
    raw = mosaicked(signal, pattern)
    full = demosaicked(raw, pattern)
    torch.testing.assert_close(full[:, 1:-1, 1:-1], signal[:, 1:-1, 1:-1], atol=1e-12, rtol=0)
    torch.testing.assert_close(mosaicked(full, pattern), raw, atol=1e-12, rtol=0)
    even_colours = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)[:, None, None].expand(3, 9, 12)
    torch.testing.assert_close(demosaicked(mosaicked(even_colours, pattern), pattern), even_colours)


# --------------------------------------------------------------------- devices


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
