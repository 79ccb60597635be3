"""A camera as an operator: from irradiance on the screen to what its channels would show without noise.

    A(E)_c = D [ gain_c sum_i mixing_ci (light_i (P_i G_i E_i) + ambient_i L_i) ]

In the order in which light meets them: G_i places the picture, P_i blurs it, light_i is uneven, D is mosaic and
demosaicing. A is affine in E; its linear part has an adjoint, and autograd gives the derivative with respect to E and
to every field of :class:`CameraParameters`.

Not handled: a PSF that changes over the picture, distortion other than a homography, flare, motion.
"""

from collections.abc import Collection

import numpy as np
import numpy.typing as npt
import torch

from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.form import CameraForm, camera_form
from warp_caustics.camera.geometry import gathered, upright_matrices
from warp_caustics.camera.mosaic import demosaicked, mosaicked
from warp_caustics.camera.parameters import CameraParameters, camera_parameters
from warp_caustics.camera.placement import corners_px
from warp_caustics.camera.psf import psf_matrix
from warp_caustics.camera.radiometry import mixed, uneven_light
from warp_caustics.scene import Scene


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
        free: Collection[str] = (),
    ):
        """Make the operator.

        Args:
            config: the camera.
            scene: what its screen shows.
            device: where to compute.
            dtype: of numbers and images.
            free: fields of :class:`CameraParameters` that may be changed afterwards, or differentiated by: their steps
                are taken even where the configuration does not need them. ``turn_rad`` and ``homography`` cost most.
                ``light``, ``ambient``, ``mixing`` and ``gain`` always may; a PSF may grow by 4 px.

        Raises:
            InputError: a camera that does not fit the scene, or does not see its window.
        """
        self.config, self.scene = config, scene
        exact = camera_parameters(config, scene.n_wavelengths, scene.image_pixels, dtype=torch.float64)
        self.form = camera_form(config, exact, scene.image_pixels, free)
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
