"""Between a user's grid and a network's: the picture that the network sees, and heights where the user wants them."""

import torch

from nets.encoding import flat_irradiance
from nets.reconstruct.network_io import network_image
from nets.seen_scene import SeenScene
from nets.shipped import FoundNetwork
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.seen_camera.aligned_channels import repaired
from warp_caustics.resampling import regridded


class NetworkGrid:
    """Change of grid, plate and channels for one scene and network.

    Pictures are means over pixels and heights means over cells, before and after: no light and no glass comes or goes,
    and fewer pixels alias no more than a camera with as many would. Where the grid is the network's own nothing is
    changed, to the bit.

    Args:
        network: with the user's scene as it sees it.
        device: of the network.
    """

    def __init__(self, network: FoundNetwork, device: torch.device):
        self.seen: SeenScene = network.seen
        self.trained, self.device = network.info.scene, device

    def picture(self, image: CausticImage) -> torch.Tensor:
        """What the network sees, shape [n_w, m, m] of its own [W/m^2], float32; see :func:`network_image`."""
        seen = self.seen
        if seen.is_same:
            return network_image(image, seen.user, self.trained, self.device)
        measured = torch.as_tensor(repaired(image), dtype=torch.float32, device=self.device)
        relative = (measured / flat_irradiance(seen.user).to(self.device))[list(seen.channels)]
        return regridded(relative, self.trained.image_pixels) * flat_irradiance(self.trained).to(self.device)

    def noise(self, image: CausticImage) -> float | None:
        """Noise of that picture relative to the light of a flat plate; None where the image does not bring it.

        Of as many pixels as are binned into one; splines leave what they are made of.
        """
        if image.noise_std is None:
            return None
        seen = self.seen
        shown = [k for k in dict.fromkeys(seen.channels) if seen.user.radiosity_W_m2[k] > 0]
        relative = [float(image.noise_std[k]) / seen.user.radiosity_W_m2[k] for k in shown]
        return sum(relative) / len(relative) * min(1.0, self.trained.image_pixels / seen.user.image_pixels)

    def heights(self, answers: torch.Tensor) -> torch.Tensor:
        """Heights on the user's grid [m], shape [B, n, n], of those that the network sees, [B, n', n']."""
        if self.seen.is_same:
            return answers
        return regridded(answers, self.seen.user.height_samples) / self.seen.scale
