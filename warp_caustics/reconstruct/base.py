"""What every reconstruction method takes and returns."""

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from warp_caustics.errors import InputError
from warp_caustics.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from warp_caustics.prints.paths import PrintedPath
    from warp_caustics.reconstruct.trust import Trust

StopReason = Literal["discrepancy", "converged", "max_iterations", "max_time", "interrupted"]


@dataclass(frozen=True, repr=False)
class CausticImage:
    """A measured caustic, ready for reconstruction.

    Attributes:
        irradiance: [W/m^2], shape [n_w, m, m].
        noise_std: standard deviation of the noise where the irradiance is about 1, per
            wavelength [W/m^2], shape [n_w]; None if unknown.
        mask: False where a pixel must be ignored (saturated, dead), shape [n_w, m, m]; what it holds, no number even,
            does not matter (but a network is shown one that is brighter than its neighbours). None if all pixels count.
        own: True where a colour sensor measured a channel behind its own filter, shape [n_w, m, m]; others were made up
            from their neighbours, and are not compared with a simulation of all pixels. True everywhere if all were
            measured. None if nobody knows: methods then look for colour filters
            (:mod:`~warp_caustics.reconstruct.colour_filters`).
        size: of the picture when it met the pixels over what it is here, where it was resampled since.
    """

    irradiance: FloatArray
    noise_std: FloatArray | None = None
    mask: npt.NDArray[np.bool_] | None = None
    own: npt.NDArray[np.bool_] | None = None
    size: float = 1.0

    @functools.cached_property
    def is_mosaic(self) -> bool:
        """Whether pixels were made up between those behind colour filters."""
        return self.own is not None and not self.own.all()

    def __repr__(self) -> str:
        size = " x ".join(map(str, self.irradiance.shape))
        noise = "unknown" if self.noise_std is None else ", ".join(f"{value:.2g}" for value in self.noise_std)
        masked = 0 if self.mask is None else int((~self.mask).sum())
        return f"CausticImage({size}, mean {np.nanmean(self.irradiance):.3g} W/m^2, noise {noise}, {masked} masked)"


def as_caustic(image: Any) -> CausticImage:
    """What a method reconstructs from: a :class:`CausticImage` as it is, or an array made one.

    Args:
        image: irradiance [W/m^2], shape [n_w, m, m], or [m, m] for one wavelength; a tensor of any device, too.
    """
    if isinstance(image, CausticImage):
        return image
    values = np.asarray(image.detach().cpu() if hasattr(image, "detach") else image)
    if values.dtype.kind not in "fiu":
        raise InputError(f"image holds {values.dtype}, not irradiance; give an array of numbers or a CausticImage")
    irradiance = values.astype(np.float32) if values.dtype.kind in "iu" else values
    return CausticImage(irradiance[None] if irradiance.ndim == 2 else irradiance)


@dataclass(frozen=True)
class Progress:
    """State of a running reconstruction, handed to the caller after every iteration.

    Attributes:
        stage: human-readable stage, for example ``"level 2 of 4, 64 x 64"``.
        iteration: iterations done in all stages.
        total: iterations planned in all stages (an upper bound).
        residual: relative image residual ||S(h) - I|| / ||I|| at the present stage.
        elapsed_s: time since the start [s].
    """

    stage: str
    iteration: int
    total: int
    residual: float
    elapsed_s: float


ProgressCallback = Callable[[Progress], None]
"""May raise KeyboardInterrupt (Ctrl-C does): methods then return their best result so far."""


@dataclass(frozen=True, repr=False)
class Reconstruction:
    """Result record, the same for all methods.

    Attributes:
        method: name of the method.
        heights_m: recovered relief above the base [m], shape [n, n].
        image: caustic of the recovered relief [W/m^2], shape [n_w, m, m]; at the exposure of the measured one where
            the method found that (``counters["exposure"]``). Never blurred, its channels never apart. Where a network
            refined another number of samples than the scene has (``settings["network"]["sees"]``), it is that of the
            relief of which ``heights_m`` are means or splines; so are residual and trust.
        shown: the same through the camera that took the measured one, where one was found: blurred as that is, its
            channels where they lay. None where it is ``image``; see :attr:`picture`.
        residual: relative image residual ||image - measured|| / ||measured||, each wavelength in units of its light.
            Where the method found a camera (``counters["camera"]``), the image is blurred as the measured one is, and
            the measured channels are moved together.
        stop_reason: why the method stopped.
        history: one entry per iteration: stage, iteration, residual, loss, elapsed_s.
        timings_s: wall time per part [s].
        counters: what happened to the light (energy budget) and how often what ran.
        settings: everything needed to repeat the run.
        warnings: what the user should know.
        uncertainty_m: standard uncertainty of the heights [m], shape [n, n]; None where a method has none.
        no_uncertainty: why there is none; empty where there is one.
        trust: how far the result is to be believed, asked in the same way of every method.
        iterates_m: relief before the first and after every iteration [m], shape [K + 1, n, n]; None where
            they were not kept.
        fibres_m: printed lines that make up the relief, rows (x0, y0, x1, y1, width, height) [m], shape [L, 6]; None
            where a method finds none.
        paths: printed lines with corners and curves that make up the relief; None where a method finds none.
        samples_m: reliefs that explain the image about as well, which differ where it leaves the heights open [m],
            shape [N, n, n]; None where they were not asked for, or a method finds none.
    """

    method: str
    heights_m: FloatArray
    image: FloatArray
    residual: float
    stop_reason: StopReason
    history: list[dict[str, Any]] = field(default_factory=list)
    timings_s: dict[str, float] = field(default_factory=dict)
    counters: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    uncertainty_m: FloatArray | None = None
    iterates_m: FloatArray | None = None
    fibres_m: FloatArray | None = None
    paths: "tuple[PrintedPath, ...] | None" = None
    no_uncertainty: str = ""
    trust: "Trust | None" = None
    samples_m: FloatArray | None = None
    shown: FloatArray | None = None

    @property
    def picture(self) -> FloatArray:
        """What the measured image is to be compared with [W/m^2], shape [n_w, m, m]."""
        return self.image if self.shown is None else self.shown

    def __repr__(self) -> str:
        size = " x ".join(map(str, self.heights_m.shape))
        low, high = 1e3 * float(self.heights_m.min()), 1e3 * float(self.heights_m.max())
        told = f", {len(self.warnings)} warnings" if self.warnings else ""
        return (
            f"Reconstruction({self.method!r}, {size} heights from {low:.4g} to {high:.4g} mm, "
            f"residual {self.residual:.4g}, stopped by {self.stop_reason.replace('_', ' ')}{told})"
        )

    def plot(self, plate_size_m: tuple[float, float] | None = None) -> "Figure":
        """Heights, their caustic and the uncertainty, side by side; row 0 at the top.

        Args:
            plate_size_m: extent along x and y [m], for axes in millimetres; ``scene.plate_size_m``.
        """
        from warp_caustics.reconstruct.plot import result_figure

        title = f"{self.method}, residual {self.residual:.3g}"
        return result_figure(self.heights_m, self.image, self.uncertainty_m, plate_size_m, title)


def _from_arrays(method: Callable[..., Reconstruction]) -> Callable[..., Reconstruction]:
    """A method that takes arrays as well, and leaves out what something hid."""

    @functools.wraps(method)
    def reconstruct(self: "Reconstructor", image: Any, **options: Any) -> Reconstruction:
        from warp_caustics.reconstruct import hidden  # loads scipy

        caustic, scene = as_caustic(image), getattr(self, "scene", None)
        place = None if scene is None else hidden.hidden_place(caustic.irradiance, caustic.mask, scene)
        if scene is None or place is None:
            return method(self, caustic, **options)
        values, mask = hidden.without_place(caustic.irradiance, caustic.mask, place)
        found = method(self, replace(caustic, irradiance=values, mask=mask), **options)
        unsure, share = found.uncertainty_m, float(place.mean())
        return replace(
            found,
            uncertainty_m=None if unsure is None else hidden.uncertain_behind(unsure, found.heights_m, place, scene),
            counters={**found.counters, "hidden": share},
            warnings=(*found.warnings, hidden.hidden_warning(share)),
        )

    return reconstruct


class Reconstructor(ABC):
    """A method that recovers heights from one caustic."""

    name: str

    def __init_subclass__(cls, **keywords: Any) -> None:
        # In one place for all methods: none can forget that callers may bring arrays.
        super().__init_subclass__(**keywords)
        if "reconstruct" in cls.__dict__:
            cls.reconstruct = _from_arrays(cls.__dict__["reconstruct"])  # type: ignore[method-assign]

    @abstractmethod
    def reconstruct(
        self,
        image: Any,
        *,
        initial: FloatArray | None = None,
        progress: ProgressCallback | None = None,
    ) -> Reconstruction:
        """Recover the relief.

        Args:
            image: the measured caustic, a :class:`CausticImage`; or only its irradiance, see :func:`as_caustic`.
            initial: starting relief [m], shape [n, n]; flat if None.
            progress: called after every iteration.

        Raises:
            InputError: image or initial relief do not fit the scene.
        """
