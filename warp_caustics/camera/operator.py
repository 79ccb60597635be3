"""A camera as an operator: from irradiance on the screen to what its channels would show without noise.

    A(E)_c = D [ gain_c sum_i mixing_ci (light_i (P_i G_i E_i) + ambient_i L_i) ]

In the order in which light meets them: G_i places the picture, P_i blurs it, light_i is uneven, D is mosaic and
demosaicing. A is affine in E; its linear part has an adjoint, and autograd gives the derivative with respect to E and
to every field of :class:`CameraParameters`.

Not handled: a PSF that changes over the picture, distortion other than a homography, flare, motion.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from warp_caustics.camera.config import LARGEST_MAGNIFICATION, LEAST_MAGNIFICATION, CameraConfig
from warp_caustics.camera.geometry import gathered, upright_matrices
from warp_caustics.camera.mosaic import demosaicked, mosaicked
from warp_caustics.camera.parameters import CameraParameters, camera_parameters
from warp_caustics.camera.placement import Frame, corners_px, seen_of_window, to_photo
from warp_caustics.camera.psf import psf_matrix, psf_reach
from warp_caustics.camera.radiometry import mixed, uneven_light
from warp_caustics.errors import InputError
from warp_caustics.resampling import BLUR_REACH
from warp_caustics.scene import Scene


@dataclass(frozen=True)
class CameraForm:
    """What of a camera is no number to differentiate by.

    Attributes:
        pixels: m of the window.
        frame: size of the photo.
        is_dark: no light beyond the window; else its picture is mirrored there.
        places: pixels are not those of the window: the picture is resampled.
        turns: the camera is turned or looks from the side; upright ones cost less.
        blurs: there is a PSF.
        reach: where the PSF is cut [px].
        mosaic: pattern of the sensor's filters, or None.
    """

    pixels: int
    frame: Frame
    is_dark: bool
    places: bool
    turns: bool
    blurs: bool
    reach: int
    mosaic: str | None


class Camera:
    """One camera in front of one scene's screen.

    Attributes:
        config: what it was made of.
        scene: gives n_w, m and the light of a flat plate.
        parameters: its numbers.
        form: the rest.
        flat: L_i, light of a flat plate [W/m^2], shape [n_w].
    """

    def __init__(
        self,
        config: CameraConfig,
        scene: Scene,
        *,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
        is_free: bool = False,
    ):
        """Make the operator.

        Args:
            config: the camera.
            scene: what its screen shows.
            device: where to compute.
            dtype: of numbers and images.
            is_free: leave nothing out that the configuration does not need, so that every parameter may be changed
                and has its derivative; a PSF may grow by 4 px before its kernel is cut short.

        Raises:
            InputError: a camera that does not fit the scene, or does not see its window.
        """
        self.config, self.scene = config, scene
        exact = camera_parameters(config, scene.n_wavelengths, scene.image_pixels, dtype=torch.float64)
        self.form = camera_form(config, exact, scene.image_pixels, is_free=is_free)
        self.parameters = CameraParameters(*(value.to(device, dtype) for value in exact))
        self.flat = torch.tensor(scene.radiosity_W_m2, dtype=dtype, device=device)
        self._exact = exact

    def __call__(self, image: torch.Tensor, parameters: CameraParameters | None = None) -> torch.Tensor:
        """A: what the channels show without noise [W/m^2 behind a flat plate], shape [..., C, H, W].

        Args:
            image: irradiance [W/m^2], shape [..., n_w, m, m].
            parameters: in place of the camera's own.
        """
        return self._detected(self.signal(image, parameters))

    def signal(self, image: torch.Tensor, parameters: CameraParameters | None = None) -> torch.Tensor:
        """The same before mosaic and demosaicing, which is where noise belongs."""
        p = self.parameters if parameters is None else parameters
        ambient = (p.ambient * self.flat)[..., None, None]
        return channels(even(placed(image, p, self.form), p, self.form) + ambient, p)

    def linear(self, image: torch.Tensor, parameters: CameraParameters | None = None) -> torch.Tensor:
        """The linear part of A: without ambient light."""
        p = self.parameters if parameters is None else parameters
        return self._detected(channels(even(placed(image, p, self.form), p, self.form), p))

    def adjoint(self, seen: torch.Tensor, parameters: CameraParameters | None = None) -> torch.Tensor:
        """Adjoint of :meth:`linear`: an image [..., n_w, m, m] of a photo [..., C, H, W]."""
        m = self.form.pixels
        image = seen.new_zeros(*seen.shape[:-3], len(self.flat), m, m).requires_grad_()
        with torch.enable_grad():
            (gradient,) = torch.autograd.grad(self.linear(image, parameters), image, seen)
        return gradient

    def corners_px(self) -> npt.NDArray[np.float64]:
        """Where the middle wavelength shows the corners -x-y, +x-y, +x+y, -x+y of the window, shape [4, 2] [px]."""
        middle = len(self.flat) // 2
        return np.asarray(corners_px(self._exact, self.form.frame, self.form.pixels, middle).numpy())

    def _detected(self, signal: torch.Tensor) -> torch.Tensor:
        pattern = self.form.mosaic
        return signal if pattern is None else demosaicked(mosaicked(signal, pattern), pattern)


def placed(image: torch.Tensor, parameters: CameraParameters, form: CameraForm) -> torch.Tensor:
    """P G E: the picture in the photo's pixels, blurred, shape [..., n_w, H, W] of [..., n_w, m, m]."""
    frame, along_x, along_y = form.frame, None, None
    if form.turns:
        image = gathered(image, parameters, frame, form.is_dark)
    elif form.places:
        along_x, along_y = upright_matrices(parameters, frame, form.pixels, form.is_dark)
    if form.blurs:
        blur_x = psf_matrix(frame.width, parameters.psf_px, parameters.box_px, form.reach)
        is_square = frame.width == frame.height
        blur_y = blur_x if is_square else psf_matrix(frame.height, parameters.psf_px, parameters.box_px, form.reach)
        along_x = blur_x if along_x is None else blur_x @ along_x
        along_y = blur_y if along_y is None else blur_y @ along_y
    if along_x is None or along_y is None:
        return image
    return along_y @ image @ along_x.transpose(-1, -2)


def even(image: torch.Tensor, parameters: CameraParameters, form: CameraForm) -> torch.Tensor:
    """The same under uneven light."""
    return image * uneven_light(parameters.light, form.frame.height, form.frame.width)


def channels(image: torch.Tensor, parameters: CameraParameters) -> torch.Tensor:
    """Camera channels [..., C, H, W] of wavelengths [..., n_w, H, W]."""
    return mixed(image, parameters.mixing * parameters.gain[..., None])


def camera_form(config: CameraConfig, parameters: CameraParameters, pixels: int, *, is_free: bool) -> CameraForm:
    """The form of a camera.

    Args:
        config: the camera.
        parameters: its numbers, float64 on the CPU.
        pixels: m.
        is_free: nothing is left out.

    Raises:
        InputError: a camera that does not see the window, or not as a camera can.
    """
    frame = Frame(pixels, pixels) if config.frame_px is None else Frame(*config.frame_px)
    psf, box = float(parameters.psf_px.max()), float(parameters.box_px.max())
    _check_psf(psf, box, frame)
    if config.mosaic is not None and len(parameters.gain) != 3:
        raise InputError(
            f"mosaic {config.mosaic} needs 3 camera channels, red, green, blue, got {len(parameters.gain)}; "
            "leave mosaic out, or give mixing three rows"
        )
    _check_light(parameters, frame)
    turns = bool(parameters.turn_rad != 0) or not torch.equal(
        parameters.homography, torch.eye(3, dtype=parameters.homography.dtype)
    )
    _check_view(parameters, frame, pixels)
    moves = any(bool(values.any()) for values in (parameters.shift_px, parameters.colour_shift_px)) or any(
        bool(values.any()) for values in (parameters.colour_scale, parameters.magnification - 1)
    )
    return CameraForm(
        pixels=pixels,
        frame=frame,
        is_dark=config.frame_px is not None,
        places=is_free or turns or moves or frame != (pixels, pixels),
        turns=is_free or turns,
        blurs=is_free or psf > 0 or box > 0,
        reach=psf_reach(psf, box),
        mosaic=config.mosaic,
    )


def _check_psf(psf_px: float, box_px: float, frame: Frame) -> None:
    side = min(frame)
    for name, value, most in (("psf_px", psf_px, side / (2 * BLUR_REACH)), ("box_px", box_px, side / 2)):
        if value > most:
            raise InputError(
                f"{name} {value:g} px is too wide for a photo of {frame.width} x {frame.height} px; "
                f"give at most {math.floor(10 * most) / 10:g}, or a larger frame_px"
            )


def _check_light(parameters: CameraParameters, frame: Frame) -> None:
    """Refuse light that is so uneven that somewhere it is none."""
    # Polynomials of second order do not hide between so many points.
    darkest = float(uneven_light(parameters.light, min(frame.height, 256), min(frame.width, 256)).min())
    if darkest <= 0:
        raise InputError(
            f"light is so uneven that it falls to {darkest:.2g} of even light (it must stay above 0); "
            "lower its coefficients, 0.05 is a poor lamp"
        )


def _check_view(parameters: CameraParameters, frame: Frame, pixels: int) -> None:
    """Refuse cameras that do not see the window, see it from behind the horizon or too coarsely."""
    maps = to_photo(parameters, frame, pixels)
    half = torch.tensor([-0.5, pixels - 0.5], dtype=torch.float64)
    corners = torch.stack([torch.stack((x, y, torch.ones_like(x))) for y in half for x in half])
    mapped = torch.einsum("nij,kj->nki", maps, corners)
    depth = mapped[..., 2]
    if not (torch.isfinite(mapped).all() and (depth > 1e-6).all()):
        raise InputError(
            "homography puts a corner of the window at the horizon; lower its last row's first two numbers"
        )
    x, y = mapped[..., 0] / depth, mapped[..., 1] / depth
    misses = (x.max() < 0) | (y.max() < 0) | (x.min() > frame.width - 1) | (y.min() > frame.height - 1)
    if bool(misses):
        raise InputError(
            f"the camera sees nothing of the window: it lies at x {float(x.min()):.0f} to {float(x.max()):.0f}, "
            f"y {float(y.min()):.0f} to {float(y.max()):.0f}, the photo has {frame.width} x {frame.height} px; "
            "lower shift_px, or raise frame_px"
        )
    ends = [torch.linspace(0, size - 1, min(size, 33), dtype=torch.float64) for size in frame]
    seen = seen_of_window(torch.linalg.inv(maps), ends[1], ends[0])
    inside = (seen.x.abs() < 2 * pixels) & (seen.y.abs() < 2 * pixels)
    sizes = torch.cat((seen.width[inside], seen.height[inside]))
    if sizes.numel() and float(sizes.max()) > 1.0001 / LEAST_MAGNIFICATION:
        raise InputError(
            f"a camera pixel is {float(sizes.max()):.3g} px of the window wide (limit {1 / LEAST_MAGNIFICATION:g}); "
            "magnify, give frame_px and corners_px further apart, or lower scene.image_pixels"
        )
    if sizes.numel() and float(sizes.min()) < 0.9999 / (2 * LARGEST_MAGNIFICATION):
        raise InputError(
            f"the window is magnified {1 / float(sizes.min()):.3g} times (limit {2 * LARGEST_MAGNIFICATION:g}); "
            "raise scene.image_pixels, or magnify less"
        )
