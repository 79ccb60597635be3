"""What a camera shows of reliefs: without the error of a lattice of photons, by its point spread, on its own pixels."""

import torch

from warp_caustics.extrapolated import ExtrapolatedCaustic
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.pixel_means import Lay
from warp_caustics.reconstruct.seen_camera.point_spread import FineLight
from warp_caustics.resampling import blur_matrices, blurred
from warp_caustics.simulator import CausticSimulator


class ExactPicture:
    """Pictures of reliefs; not differentiable.

    Args:
        simulator: a lattice of the scene, in whose units pictures are.
        camera: that took pictures, whose channels are brought together as those of what was measured.
        times: as of :class:`~warp_caustics.extrapolated.ExtrapolatedCaustic`, where the pixels' picture itself will do.
        finer: times as many fine pixels along the image, and photons for them: of 512 pixels twice as many are 0.02 to
            0.2 % of flat light nearer, where pictures are 0.2 to 0.5 % off.
    """

    def __init__(self, simulator: CausticSimulator, camera: ChannelCamera, times: int = 2, finer: int = 1):
        pixels = simulator.scene.image_pixels
        # On fewer pixels neither is known.
        is_whole = camera.pixels == pixels
        self._lays: list[Lay] | None = camera.lays if is_whole else None
        is_fine = self._lays is not None or (is_whole and camera.spread is not None)
        self._spread = camera.shown_by if is_fine else None
        self._light: FineLight | ExtrapolatedCaustic
        self._blur: torch.Tensor | None = None
        if self._spread is not None:
            self._light = light = FineLight(simulator, 1.0 if self._lays is None else camera.size, finer)
            self._lays = light.lays_of_light(self._lays)
        else:
            self._light = ExtrapolatedCaustic(simulator, times * finer**2)
            blur = camera.blur_at(pixels)
            self._blur = blur_matrices(pixels, blur, simulator.device) if blur.any() else None
        self._pixels = pixels

    @torch.no_grad()
    def __call__(self, heights_m: torch.Tensor) -> torch.Tensor:
        """Of a relief [m], shape [n, n]: irradiance [W/m^2], shape [n_w, m, m]."""
        return self._shown(self._light(heights_m))

    @torch.no_grad()
    def change(self, first_m: torch.Tensor, second_m: torch.Tensor) -> torch.Tensor:
        """Pictures of reliefs that differ in places from others, less those of these: of light that this touches.

        Shapes are those of :meth:`~warp_caustics.simulator.CausticSimulator.change`.
        """
        change = self._light.change(first_m, second_m)
        return self._shown(change) if change.ndim == 3 else torch.stack([self._shown(each) for each in change])

    def _shown(self, light: torch.Tensor) -> torch.Tensor:
        """Light as the camera's pixels see it, which is linear."""
        if self._spread is not None:
            return self._spread(light, self._pixels, self._lays)
        return light if self._blur is None else blurred(light, self._blur)
