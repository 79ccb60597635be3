"""A set-up as a vector of named numbers, and back: what calibration moves and a Fisher information is about."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch

from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.operator import Camera
from warp_caustics.camera.parameters import CameraParameters, camera_parameters
from warp_caustics.camera.psf import psf_reach
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene
from warp_caustics.setup.optical import optical_parameters, optical_values, with_optical_values
from warp_caustics.setup.parameter import Parameter, chosen
from warp_caustics.setup.seen import BLURRING, PLACING, TURNING, Place, camera_places, camera_values, with_camera_values

USUAL_CAMERA = (
    "shift_x_px", "shift_y_px", "turn_rad", "magnification", "colour_shift_x_px", "colour_shift_y_px", "colour_scale",
    "psf_px", "ambient", "gain",
)  # fmt: skip
"""Groups that are free where nobody says which: what every laboratory has to find out."""

SHIFTED_BY_CAMERA = ("screen_x_m", "screen_y_m")
"""The window and the camera's picture of it shift everything alike. Images with structure as fine as a pixel could tell
them apart in the model, which resamples pixels, but no laboratory could."""

APART = ("colour_shift_x_px", "colour_shift_y_px", "colour_scale")
"""Where colours lie is told against the middle wavelength: moved all alike they are a shift of the picture."""


@dataclass(frozen=True, eq=False)
class SetUp:
    """A nominal set-up and the parameters of it that are free; vectors theta have their order.

    Attributes:
        nominal_scene: where optical parameters that are not free stay.
        camera_config: the nominal camera; None is none: the image is the irradiance on the screen.
        parameters: the free ones, P of them.
    """

    nominal_scene: Scene
    camera_config: CameraConfig | None
    parameters: tuple[Parameter, ...]
    _nominal_camera: CameraParameters | None
    _places: Mapping[str, Place]

    @classmethod
    def of(
        cls,
        scene: Scene,
        camera: CameraConfig | None = None,
        free: Iterable[str] | None = None,
        *,
        ranges: Mapping[str, tuple[float, float]] | None = None,
        priors: Mapping[str, float] | None = None,
    ) -> "SetUp":
        """Describe a set-up.

        Args:
            scene: nominal.
            camera: nominal; None is none.
            free: names of parameters or groups; a group ``psf_px`` stands for ``psf_px.0``, ``psf_px.1`` and so on.
                None takes all of plate, light and screen, and of a camera :data:`USUAL_CAMERA` but for the middle
                wavelength's :data:`APART`; with a camera its shift stands for that of the screen.
            ranges: by name or group, in place of the usual ones.
            priors: standard deviations by name or group, in place of the usual ones.

        Raises:
            InputError: an unknown name, a range turned round or without the nominal value, a prior that is not above
                0, or a camera that does not fit the scene.
        """
        places: dict[str, tuple[Parameter, Place]] = {}
        nominal_camera = None
        if camera is not None:
            Camera(camera, scene)
            nominal_camera = camera_parameters(camera, scene.n_wavelengths, scene.image_pixels, dtype=torch.float64)
            places = camera_places(nominal_camera)
        known = {p.name: p for p in optical_parameters(scene)} | {name: p for name, (p, _) in places.items()}
        if free is None:
            middle = scene.n_wavelengths // 2
            free = [
                name
                for name, p in known.items()
                if (p.part != "camera" and not (camera is not None and name in SHIFTED_BY_CAMERA))
                or (p.group in USUAL_CAMERA and name not in {f"{group}.{middle}" for group in APART})
            ]
        names = chosen(free, list(known.values()))
        for key, (low, high) in (ranges or {}).items():
            for name in chosen([key], list(known.values())):
                known[name] = replace(known[name], low=float(low), high=float(high))
        for key, width in (priors or {}).items():
            for name in chosen([key], list(known.values())):
                known[name] = replace(known[name], prior=float(width))
        setup = cls(
            scene,
            camera,
            tuple(known[name] for name in names),
            nominal_camera,
            {name: place for name, (_, place) in places.items()},
        )
        setup.checked(setup.nominal)
        return setup

    @property
    def names(self) -> tuple[str, ...]:
        """Of the free parameters, shape [P]."""
        return tuple(p.name for p in self.parameters)

    @property
    def priors(self) -> torch.Tensor:
        """Standard deviations of what is not known, shape [P], float64, each in its parameter's unit."""
        return torch.tensor([p.prior for p in self.parameters], dtype=torch.float64)

    @property
    def nominal(self) -> torch.Tensor:
        """theta of the nominal set-up, shape [P], float64."""
        return self.theta(self.nominal_scene, self._nominal_camera)

    def theta(self, scene: Scene, camera: CameraParameters | None = None) -> torch.Tensor:
        """The free parameters of a scene and a camera, shape [P], float64: the inverse of the two below.

        Args:
            scene: of the nominal one's kind; where that is collimated it may have a point source.
            camera: None takes the nominal one.

        Raises:
            InputError: collimated light where the nominal scene has a point source.
        """
        values: dict[str, float] = optical_values(scene, self.nominal_scene)
        camera = self._nominal_camera if camera is None else camera
        if camera is not None:
            values |= camera_values(camera, self._places)
        return torch.tensor([values[name] for name in self.names], dtype=torch.float64)

    def checked(self, theta: torch.Tensor | Sequence[float]) -> torch.Tensor:
        """theta as float64 on the CPU, if its length and its values are in order.

        Raises:
            InputError: they are not.
        """
        values = torch.as_tensor(theta, dtype=torch.float64).detach().cpu()
        if values.shape != (len(self.parameters),):
            raise InputError(
                f"theta has shape {list(values.shape)} for {len(self.parameters)} free parameters; give one value each"
            )
        for parameter, value in zip(self.parameters, values.tolist(), strict=True):
            parameter.checked(value)
        return values

    def scene(self, theta: torch.Tensor | Sequence[float] | None = None) -> Scene:
        """The scene of a vector theta [P]; None is the nominal one. Not differentiable: see ``SetUpModel``.

        Raises:
            InputError: values out of range, or that make no scene.
        """
        if theta is None:
            return self.nominal_scene
        values = dict(zip(self.names, self.checked(theta).tolist(), strict=True))
        moved = {name: value for name, value in values.items() if name not in self._places}
        return with_optical_values(self.nominal_scene, moved)

    def camera(
        self,
        theta: torch.Tensor | Sequence[float] | None = None,
        *,
        dtype: torch.dtype = torch.float64,
        device: torch.device | str = "cpu",
    ) -> CameraParameters:
        """The camera's parameters of a vector theta [P], differentiable by it; None is the nominal one.

        Values are not checked, so that a descent or a transform of torch may go through: see :meth:`checked`.

        Raises:
            InputError: a set-up without camera.
        """
        if self._nominal_camera is None:
            raise InputError("this set-up has no camera; give SetUp.of(scene, CameraConfig())")
        fixed = CameraParameters(*(value.to(device, dtype) for value in self._nominal_camera))
        if theta is None:
            return fixed
        values = torch.as_tensor(theta, dtype=dtype, device=device)
        numbers = [k for k, name in enumerate(self.names) if name in self._places]
        return with_camera_values(fixed, [self._places[self.names[k]] for k in numbers], values[numbers])

    def operator(
        self,
        theta: torch.Tensor | None = None,
        groups: Iterable[str] | None = None,
        *,
        dtype: torch.dtype = torch.float64,
        device: torch.device | str = "cpu",
    ) -> Camera | None:
        """The camera as an operator in which nothing is left out that theta, or moving a parameter, needs.

        Resampling, turning and blur cost time, turning most. What is left out would change nothing but the last digits.
        The PSF is cut where the nominal camera cuts it, or further out where theta needs that.

        Args:
            theta: shape [P]; None is nominal.
            groups: of parameters that are moved, or differentiated by; None is all free ones.
            dtype: of numbers and images.
            device: where to compute.

        Returns:
            None for a set-up without camera.
        """
        if self.camera_config is None:
            return None
        camera = Camera(self.camera_config, self.nominal_scene, dtype=dtype, device=device)
        free = {p.group for p in self.parameters}
        moved = free if groups is None else set(groups)
        exact = self.camera(theta)
        turns = not moved.isdisjoint(TURNING) or bool(exact.turn_rad != 0)
        turns = turns or not torch.equal(exact.homography, torch.eye(3, dtype=torch.float64))
        placed = (exact.shift_px, exact.colour_shift_px, exact.colour_scale, exact.magnification - 1)
        places = turns or camera.form.places or not moved.isdisjoint(PLACING) or any(bool(v.any()) for v in placed)
        widths = [float(getattr(exact, field).max()) for field in BLURRING]
        camera.form = replace(
            camera.form,
            places=places,
            turns=turns,
            blurs=not moved.isdisjoint(BLURRING) or max(widths) > 0,
            reach=max(camera.form.reach, psf_reach(*widths)),
        )
        return camera
