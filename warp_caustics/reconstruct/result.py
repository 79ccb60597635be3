"""The result of a reconstruction: its caustic simulated again, what that leaves of the image, and where light went."""

import copy
import dataclasses
import functools
import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from warp_caustics.data_gradient import possible_heights
from warp_caustics.energy import energy_budget
from warp_caustics.extrapolated import ExtrapolatedCaustic, with_photons
from warp_caustics.fold_fraction import fold_fraction
from warp_caustics.reconstruct.base import CausticImage, Reconstruction, StopReason
from warp_caustics.reconstruct.colour_filters import pattern_of
from warp_caustics.reconstruct.exposure import LEAST_EXPOSURE_ERROR, agreed_ratio, at_nominal, is_exposure, light_ratio
from warp_caustics.reconstruct.image_noise import estimated_noise, with_grain
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.pyramid import judged_pixels, measurement_at, simulator_at
from warp_caustics.reconstruct.rest import Rest
from warp_caustics.reconstruct.seen_camera.aligned_channels import channels_together
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.channel_registration import registered
from warp_caustics.reconstruct.seen_camera.mosaic_registration import registered_through_filters
from warp_caustics.reconstruct.seen_camera.point_spread import FineLight
from warp_caustics.reconstruct.seen_camera.spread_estimate import equal_blur_px, found_spread
from warp_caustics.reconstruct.trust import Seen, Trust, image_trust, seen_by_camera
from warp_caustics.resampling import blur_matrices, blurred, resampled, spline_reach
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

NO_SPREAD = "this method finds one relief, and nothing that tells how far from it others may lie"
"""Why most methods have no uncertainty."""


EXTRAPOLATED = 8
"""Times as many photons as a usual lattice tell its error."""
FINER, MOST_PHOTONS = 16, 30_000_000
"""Times as many photons show heights that are right to that lattice's own error, but no more than so many."""


class Resimulated(NamedTuple):
    """A relief's caustic."""

    image: torch.Tensor
    """[W/m^2], shape [n_w, m, m]."""
    residual: float
    """Relative, over the pixels that count; of the caustic as the camera sees it, where there is one."""


class Resimulation:
    """Caustics of reliefs at all pixels of one measured image, and how well they explain it.

    Args:
        simulator: of the measured scene.
        image: what was measured.
        exposure: of the image, shape [n_w]; 1 if None.

    Attributes:
        image: what would have been measured at an exposure of 1, by a camera whose channels lie together.
        camera: that took the image; a perfect one unless :meth:`through` was told another.
        mosaic: name of its sensor's colour filters, such as rggb; None for none.
    """

    REMEMBERED = 3
    """Reliefs whose caustic is kept: candidates are compared, then the best is reported."""

    def __init__(self, simulator: CausticSimulator, image: CausticImage, exposure: FloatArray | None = None):
        self.simulator, self._given = simulator, image
        self.exposure = np.ones(simulator.scene.n_wavelengths) if exposure is None else exposure
        self.image = image if exposure is None else at_nominal(image, exposure)
        about = self.image, simulator.scene, simulator.scene.image_pixels, simulator.device
        self.measurement = measurement_at(*about)
        self._pictured = measurement_at(*about, made_up=True) if image.is_mosaic else self.measurement
        """With pixels that were made up, for what looks at the whole picture."""
        radiosity = torch.tensor(simulator.scene.radiosity_W_m2, device=simulator.device)
        self._radiosity = radiosity[:, None, None].clamp_min(1e-30)
        self._known: list[tuple[FloatArray, torch.Tensor]] = []
        perfect = ChannelCamera.perfect(simulator.scene.n_wavelengths, simulator.scene.image_pixels)
        self.camera = dataclasses.replace(perfect, size=image.size)
        self.mosaic = pattern_of(image.own) if image.is_mosaic and image.own is not None else None
        self._blur: torch.Tensor | None = None
        self._fine, self._is_exact = FineLight(simulator, image.size), image.size != 1
        self._known_spread: list[tuple[FloatArray, bool, torch.Tensor]] = []

    def __call__(self, heights: FloatArray) -> Resimulated:
        """Of a relief [m], shape [n, n]; an array that was asked for lately is not simulated again."""
        return Resimulated(self._simulated(heights), self.measurement.relative_residual(self._seen(heights)))

    def _seen(self, heights: FloatArray, *, by_half: bool = False) -> torch.Tensor:
        """As the camera sees a relief, by all photons or half of them, in units of the radiosity, shape [n_w, m, m]."""
        if self.camera.spread is not None or (self._is_exact and self.camera.lays is not None):
            return self._spread(heights, by_half)
        if by_half:
            half = with_photons(self.simulator, max(1, self.simulator.n_photons // 2))
            with torch.no_grad():
                seen = half(self.relief(heights)) / self._radiosity
        else:
            seen = self._simulated(heights) / self._radiosity
        return seen if self._blur is None else blurred(seen, self._blur)

    def shown(self, heights: FloatArray) -> FloatArray | None:
        """What the camera shows of a relief as it took it [W/m^2], shape [n_w, m, m]: channels apart, of its own size.

        None for a perfect camera.
        """
        camera, pixels = self.camera, self.simulator.scene.image_pixels
        if camera.is_perfect and camera.lays is None:
            return None
        if camera.spread is not None or (self._is_exact and camera.lays is not None):
            lays = None if camera.lays is None else [lay._replace(is_back=False) for lay in camera.lays]
            seen = camera.shown_by(self._fine.plain(self.relief(heights)), pixels, self._fine.lays_of_light(lays))
        else:
            about = self._simulated(heights)
            shift, scale, blur = (
                torch.as_tensor(each, dtype=about.dtype, device=about.device)
                for each in (camera.size * camera.shift, camera.size * (1 + camera.scale) - 1, camera.blur)
            )
            seen = resampled(about, shift, scale, blur, spline_reach(float(camera.blur.max())))
        light: FloatArray = seen.cpu().numpy() * self.exposure.astype(np.float32)[:, None, None]
        return light

    def _spread(self, heights: FloatArray, by_half: bool) -> torch.Tensor:
        """The same by the camera's point spread, on the pixels that there were."""
        for known, halved, seen in self._known_spread:
            if known is heights and halved == by_half:
                return seen
        light = self._fine.plain(self.relief(heights), by_half=by_half)
        pixels = self.simulator.scene.image_pixels
        seen = self.camera.shown_by(light, pixels, self._fine.lays_of_light(self.camera.lays)) / self._radiosity
        self._known_spread[:] = [*self._known_spread[1 - self.REMEMBERED :], (heights, by_half, seen)]
        return seen

    def trust(self, heights: FloatArray, found_at: int | None = None) -> Trust:
        """How far a relief is to be believed; noise that is not known is estimated.

        Where it is not explained, and no camera is in the model, one is looked for: a lens out of focus by 0.7 px
        leaves 15 % of an image whose relief is right.

        Args:
            heights: [m], shape [n, n].
            found_at: pixels per side of the image that they were found with, which divide the image's; None for all.
                They are judged there, but by no fewer than there are heights.
        """
        plain = self._trust(heights, found_at)
        if plain.is_explained is not False or not self.camera.is_perfect:
            return plain
        camera = self.found_camera(heights)
        if camera.is_perfect:
            return plain
        seen = self.through(camera)._trust(heights, found_at)
        return seen_by_camera(seen, float(camera.blur.max()), float(camera.apart_px.max())) or plain

    def _trust(self, heights: FloatArray, found_at: int | None) -> Trust:
        scene = self.simulator.scene
        source = "estimated" if self.measurement.noise is None else "given"
        folded = functools.partial(fold_fraction, heights, scene)
        if judged_pixels(scene, found_at) == scene.image_pixels:
            return image_trust(*self._with_grain(*self._judged(heights, None)), source, folded)
        few = self._with_grain(*self._judged(heights, found_at))
        found = image_trust(*few, source, folded, scene.image_pixels)
        return found.beside(image_trust(*self._with_grain(*self._judged(heights, None)), source))

    def _with_grain(self, measurement: Measurement, seen: Seen) -> tuple[Measurement, Seen]:
        """Noise that holds the grain, too: what is left beside it is asked of causes, of which grain is one."""
        return with_grain(measurement, self._noisy, self.simulator.scene), seen

    @property
    def _noisy(self) -> CausticImage:
        """The image with its noise, estimated where that is not known."""
        if self.measurement.noise is not None:
            return self.image
        return dataclasses.replace(self.image, noise_std=estimated_noise(self.image, self.simulator.scene))

    def rest(self, heights: FloatArray, found_at: int | None = None) -> Rest | None:
        """What a relief leaves of the image; arguments as of :meth:`trust`. None where its noise cannot be told."""
        measurement, seen = self._judged(heights, found_at)
        return None if measurement.noise is None else Rest.of(measurement, seen)

    def predicted2(self, heights: FloatArray, deviation: FloatArray, found_at: int | None = None) -> float:
        """What reliefs leave of this one's image that are off at random, each sample by its deviation: sum of squares.

        Mean of two, of neighbours that go together over about one sample; at the pixels of :meth:`rest`.

        Args:
            heights: [m], shape [n, n].
            deviation: standard [m], same shape.
            found_at: as of :meth:`trust`.
        """
        pixels, generator = judged_pixels(self.simulator.scene, found_at), np.random.default_rng(0)
        weight = measurement_at(self.image, self.simulator.scene, pixels, self.simulator.device).weight
        true, total = self._seen_at(heights, pixels), 0.0
        for _ in range(2):
            white = scipy.ndimage.gaussian_filter(generator.standard_normal(heights.shape), 0.7)
            off = as_glass(heights + deviation * white / white.std(), self.simulator.scene)
            total += float(((self._seen_at(off, pixels) - true).double() * weight).square().sum()) / 2
        return total

    def _judged(self, heights: FloatArray, found_at: int | None) -> tuple[Measurement, Seen]:
        """The image at as many pixels as heights were found with, and what they show there."""
        image, scene = self._noisy, self.simulator.scene
        pixels = judged_pixels(scene, found_at)
        measurement = measurement_at(image, scene, pixels, self.simulator.device)
        seen = self._seen(heights)
        if pixels == scene.image_pixels:
            return measurement, Seen(seen, self._seen(heights, by_half=True))
        means = torch.nn.functional.avg_pool2d(seen, scene.image_pixels // pixels)
        return measurement, Seen(means, self._seen_at(heights, pixels))

    def _seen_at(self, heights: FloatArray, pixels: int) -> torch.Tensor:
        """As the camera sees what a simulation of so many pixels gives, in units of the radiosity."""
        device = self.simulator.device
        with torch.no_grad():
            seen: torch.Tensor = simulator_at(self.simulator.scene, pixels, device)(self.relief(heights))
        if not self.camera.blurs:
            return seen
        return blurred(seen, blur_matrices(pixels, self.camera.blur_at(pixels), device))

    def _simulated(self, heights: FloatArray) -> torch.Tensor:
        for known, simulated in self._known:
            if known is heights:
                return simulated
        with torch.no_grad():
            simulated = self.simulator(self.relief(heights))
        self._known[:] = [*self._known[1 - self.REMEMBERED :], (heights, simulated)]
        return simulated

    def found_camera(self, heights: FloatArray, *, exactly: bool = False) -> ChannelCamera:
        """What the camera did to the image, told by a relief that is nearly right [m], shape [n, n].

        Args:
            heights: relief.
            exactly: without the softness of the simulator's lattice, for descents that have none; else the camera's
                blur makes up for it, as one that is used with this lattice should.
        """
        exact = ExtrapolatedCaustic(self.simulator, EXTRAPOLATED)(self.relief(heights)) if exactly else None
        simulated = (self._simulated(heights) if exact is None else exact) / self._radiosity
        if self.image.is_mosaic and self.image.own is not None:
            return registered_through_filters(self._pictured, simulated, self.image.own)
        return registered(self.measurement, simulated)

    def with_spread(self, heights: FloatArray) -> ChannelCamera:
        """The same camera with the point spread that a relief tells which is right but for micrometres [m].

        Args:
            heights: relief, shape [n, n].
        """
        relief = self.relief(heights)
        fine = self._fine(relief) / self._radiosity
        spread = found_spread(self.measurement, fine, self.camera, self._fine.lays_of_light(self.camera.lays))
        sharp = torch.nn.functional.avg_pool2d(fine, fine.shape[-1] // self.camera.pixels)
        blur = equal_blur_px(sharp, spread(fine, self.camera.pixels))
        return dataclasses.replace(self.camera, spread=spread, blur=blur)

    def through(self, camera: ChannelCamera) -> "Resimulation":
        """The same with a camera: the image with its channels together, residuals of blurred caustics.

        Its ``image`` has the channels together; the caustics that calls return stay those of the scene.
        """
        if camera.is_perfect:
            return self
        device = self.simulator.device
        image = channels_together(self.image, camera, device) if camera.displaces else self.image
        seen = Resimulation(self.simulator, image)
        seen.exposure, seen._known, seen.mosaic = self.exposure, self._known, self.mosaic
        return seen.blurred_by(camera)

    def blurred_by(self, camera: ChannelCamera) -> "Resimulation":
        """The same image, whose channels lie together, with a camera's blur or point spread in place of that so far."""
        seen = copy.copy(self)
        seen.camera, seen._known_spread = dataclasses.replace(camera, size=self.image.size), []
        seen._blur = blur_matrices(camera.pixels, camera.blur, self.simulator.device) if camera.blurs else None
        return seen

    def exposed(self, heights: FloatArray | None = None, least: float = LEAST_EXPOSURE_ERROR) -> "Resimulation":
        """The same with the exposure that a relief's light tells.

        Args:
            heights: relief [m], shape [n, n]; a flat plate if None, but a relief may send more light beside the screen.
            least: smaller deviations are left alone.
        """
        ratio = light_ratio(self._pictured)
        if heights is not None:
            ratio = agreed_ratio(light_ratio(self._pictured, self(heights).image / self._radiosity), ratio)
        if not is_exposure(ratio, least):
            return self
        seen = Resimulation(self.simulator, self._given, self.exposure * ratio)
        seen._known = self._known  # light of a relief is the same
        if self.camera.is_perfect and self.camera.lays is None:
            seen._known_spread = self._known_spread
        return seen

    def exactly(self) -> "Resimulation":
        """The same on the pixels that there were where channels lay apart, for heights that were found so."""
        seen = copy.copy(self)
        seen._is_exact, seen._known_spread = True, []
        return seen

    def finer(self) -> "Resimulation":
        """The same by more photons, without most of a usual lattice's error: for heights that were found without."""
        simulator, seen = self.simulator, self.exactly()
        n_photons = min(FINER * simulator.n_photons, MOST_PHOTONS)
        if n_photons <= simulator.n_photons:
            return seen
        seen.simulator = with_photons(simulator, n_photons)
        seen._known = []
        return seen

    def relief(self, heights: FloatArray) -> torch.Tensor:
        """Heights as the simulator takes them."""
        return torch.tensor(heights, dtype=torch.float32, device=self.simulator.device)


def as_glass(heights: FloatArray, scene: Scene) -> FloatArray:
    """Heights that leave some plate, float64: a network may answer anything, the simulator wants glass."""
    possible: FloatArray = possible_heights(torch.tensor(heights, dtype=torch.float64), scene).numpy()
    return possible


def make_result(
    method: str,
    resimulation: Resimulation,
    heights: FloatArray,
    *,
    reason: StopReason,
    history: list[dict[str, Any]],
    timings: dict[str, float],
    counters: dict[str, Any],
    settings: dict[str, Any],
    warnings: Iterable[str],
    advice: Callable[[float], Iterable[str]] | None = None,
    uncertainty: FloatArray | None = None,
    no_uncertainty: str = NO_SPREAD,
    iterates: FloatArray | None = None,
    found_at: int | None = None,
) -> Reconstruction:
    """The record of a result: simulated at all pixels, by the lattice, whatever it was found with.

    Args:
        method: its name.
        resimulation: of the measured image; the result's is at its exposure. Where it has a camera, the residual is
            that of the caustic as the camera sees it; the stored caustic is that of the scene, sharp and together.
        heights: result [m], shape [n, n].
        reason: why it ended.
        history: of iterations.
        timings: wall time of parts [s].
        counters: what happened.
        settings: to repeat the run; "simulation" is the resimulation's unless it is among them.
        warnings: for the user.
        advice: what a relative residual tells the user besides.
        uncertainty: standard uncertainty [m], shape [n, n].
        no_uncertainty: why there is none, where there is none.
        iterates: heights after each iteration [m], shape [K + 1, n, n].
        found_at: pixels per side of the image that heights were found with, where it has more; trust is asked there.
    """
    started = time.perf_counter()
    simulated, residual = resimulation(heights)
    simulator = resimulation.simulator
    image = simulated.cpu().numpy() * resimulation.exposure.astype(np.float32)[:, None, None]
    energy = energy_budget(simulator, resimulation.relief(heights), simulated)
    trust = resimulation.trust(heights, found_at)
    return Reconstruction(
        method=method,
        heights_m=heights,
        image=image,
        shown=resimulation.shown(heights),
        residual=residual,
        stop_reason=reason,
        history=history,
        timings_s=timings | {"resimulation": time.perf_counter() - started},
        counters=counters | {"energy": energy} | ({"mosaic": mosaic} if (mosaic := resimulation.mosaic) else {}),
        settings={"simulation": simulator.settings()} | settings,
        warnings=(*warnings, *(() if advice is None else advice(residual))),
        uncertainty_m=uncertainty,
        iterates_m=iterates,
        no_uncertainty=no_uncertainty if uncertainty is None else "",
        trust=trust,
    )
