"""``nsfc``: the paper's method. Denoise the simulated caustic, take the gradient, let the updater step; ten times."""

from typing import Annotated, Any, Literal

import torch
from pydantic import Field

from nets.reconstruct.iteration import Iterated, IterationOptions, relative
from nets.shipped import FoundNetwork, find_network
from nets.weights import WeightsInfo
from warp_caustics.data_gradient import Denoiser, squares_gradient
from warp_caustics.errors import MismatchError
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.types import FloatArray

PAPER_ITERATIONS = 10


class NsfcOptions(IterationOptions):
    """Settings of ``nsfc``; the two ablations take updaters that were trained without, too."""

    refine: bool = False
    """As published: no refinement."""
    denoise: bool = True
    """Whether the updater sees the denoised image, and the gradient that of its difference from the target."""
    use_gradient: bool = True
    """Whether the updater sees the gradient."""
    denoiser_weights: str | None = None
    """Weights file; None takes a shipped one."""
    photons: Literal["paper", "lattice"] = "paper"
    """paper: 10^6 random photons, new ones in every step; lattice: no noise, so nothing to denoise."""
    n_photons: Annotated[int, Field(ge=1, le=10**9)] | None = None
    """n_l: light paths per wavelength; None takes the preset's."""


class Nsfc(Iterated):
    """Denoiser, gradient, updater.

    Args:
        scene: the set-up of the measurement.
        options: see :class:`NsfcOptions`.
        device: where to compute.

    Raises:
        InputError: no such network is shipped, or no such file.
        MismatchError: a network is for another scene, or was trained for another ablation.
    """

    name = "nsfc"
    options: NsfcOptions

    def __init__(self, scene: Scene, options: NsfcOptions | None = None, device: str | torch.device = "cpu"):
        options = options or NsfcOptions()
        device = usable_device(device)
        updater = _find_updater(scene, options, device)
        super().__init__(scene, options, updater, device)
        self.denoiser: FoundNetwork | None = None
        if options.denoise:
            self.denoiser = find_network("denoiser", scene, path=options.denoiser_weights, device=device)
        if device.type == "cpu":
            for network in (updater, self.denoiser):
                if network is not None:
                    # Half the CPU time of the denoiser, to the same rounding.
                    network.module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.inner = CausticSimulator(
            self.inner_scene, options.photons, n_photons=options.n_photons, seed=options.seed, device=self.device
        )

    @property
    def iterations(self) -> int:
        return self.options.max_iterations or PAPER_ITERATIONS

    @property
    def used(self) -> dict[str, Any]:
        denoiser = None if self.denoiser is None else self.denoiser.record
        return {"network": self.network.record, "denoiser": denoiser, "photons": self.inner.settings()}

    def start(self, target: torch.Tensor, initial: FloatArray | None) -> torch.Tensor:
        self.target = target[None]
        n = self.scene.height_samples
        flat = torch.zeros(1, n, n, device=self.device)
        return flat if initial is None else torch.as_tensor(initial, dtype=torch.float32, device=self.device)[None]

    def step(self, number: int, heights: torch.Tensor) -> tuple[torch.Tensor, float]:
        if self.options.photons == "paper":
            self.inner.reseed(self.options.seed + number)
        denoiser: Denoiser | None = None if self.denoiser is None else self.denoised
        shown, gradient = squares_gradient(self.inner, heights, self.target, denoiser)
        with torch.inference_mode():
            updated: torch.Tensor = self.network.module(self.target, shown, heights, gradient)
        return updated.clone(), relative(shown, self.target)

    def denoised(self, images: torch.Tensor) -> torch.Tensor:
        """What the denoiser makes of images [B, n_w, m, m]; wavelength by wavelength on a CPU.

        The network knows no other wavelength's image, and three at once are too large for a CPU's caches.
        """
        assert self.denoiser is not None  # asked for with ``denoise`` only
        parts = images.split(1, dim=1) if images.device.type == "cpu" else (images,)
        with torch.inference_mode():
            return torch.cat([self.denoiser.module(part) for part in parts], dim=1)

    def mean(self, heights: torch.Tensor) -> torch.Tensor:
        return heights[0]


def _find_updater(scene: Scene, options: NsfcOptions, device: torch.device) -> FoundNetwork:
    def suits(info: WeightsInfo) -> bool:
        config = info.training.get("config")
        was_denoised = isinstance(config, dict) and config.get("denoiser_weights") is not None
        return _takes_gradient(info) == options.use_gradient and was_denoised == options.denoise

    what = f"updater trained {_with(options.denoise)} denoiser and {_with(options.use_gradient)} gradient"
    settings = {}
    if options.denoise:
        settings["training.denoiser_weights"] = "DENOISER"
    if not options.use_gradient:
        settings["network.use_gradient"] = "false"
    found = find_network(
        "updater", scene, path=options.weights, device=device, suits=suits, what=what, settings=settings
    )
    if _takes_gradient(found.info) != options.use_gradient:
        raise MismatchError(
            f"updater {found.file!r} was trained {_with(_takes_gradient(found.info))} gradient, asked is one "
            f"{_with(options.use_gradient)}; set use_gradient={not options.use_gradient}, or give other weights"
        )
    return found


def _takes_gradient(info: WeightsInfo) -> bool:
    return bool(getattr(info.architecture, "use_gradient", False))


def _with(is_there: bool) -> str:
    return "with" if is_there else "without"
