"""What a reconstruction tells a network of the user's bench, and the picture that the network sees."""

import torch

from nets.flat_light import FlatLight, rectified
from nets.reconstruct.network_io import TRAINED_EXPOSURE_ERROR
from nets.told import ToldTable, bench_values, dropped, told_of, turned
from warp_caustics.scene import Scene


class ToldBench:
    """The user's bench for a network that is told of it.

    Args:
        scene: the user's, as the network sees it: on its grid, its plate and its wavelengths.
        trained: that the network is made for.
        device: of the network.

    Attributes:
        height_scale: of the network's answers, 1 on its own scene.
        trained: turns and flips of plate and picture are those of this scene, as what is told turns with them.
        is_near: whether light comes from a lamp nearby, which does not light a flat plate evenly.
    """

    def __init__(self, scene: Scene, trained: Scene, device: torch.device):
        self.scene, self.trained, self.device = scene, trained, device
        self.table = ToldTable(trained, device)
        self.is_near = not scene.is_collimated
        self.light = FlatLight(self.table)
        self.values = torch.tensor([[*bench_values(scene), 0.0, 0.0]], dtype=torch.float32, device=device)
        self.height_scale = float(self.light.height_scale(self.values))

    def picture(self, image: torch.Tensor) -> torch.Tensor:
        """Without what a flat plate would show: its falloff, and where its light lands.

        Args:
            image: shape [n_w, m, m], in the brightness that the network knows.
        """
        if self.is_near:
            image = image / self.light.level(self.values)[0]
            # Of an evenly lit picture the exposure is told by all its light; here only now.
            light = image[:, 1:-1, 1:-1].mean(dim=(1, 2))
            ratio = light / torch.tensor(self.trained.radiosity_W_m2, device=self.device).clamp(min=1e-30)
            is_off = (ratio > 0) & ((ratio - 1).abs() > TRAINED_EXPOSURE_ERROR)
            image = image / torch.where(is_off, ratio, 1.0)[:, None, None]
        return rectified(image, self.scene)

    def told(self, noise: float | None, symmetries: torch.Tensor) -> torch.Tensor:
        """What goes into the network with the picture in these symmetries, shape [B, 2 P].

        The scene is told as it is; noise where it is known, blur never.

        Args:
            noise: of the picture, relative, where it is as bright as behind a flat plate; None where it is not known.
            symmetries: shape [3, B].
        """
        values, known = told_of(self.scene, self.table, noise=noise)
        count = symmetries.shape[1]
        values = turned(values.expand(count, -1), symmetries.to(self.device), self.table)
        return dropped(values, known.expand(count, -1), self.table)
