"""Whether a network serves a scene, and which of several serves it best."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from nets.family import check_family
from nets.scene_match import check_scene, differences, train_command
from nets.seen_scene import SeenScene, grid_problems, seen_scene
from nets.unseen import unseen
from nets.weights import WeightsInfo
from warp_caustics.errors import MismatchError
from warp_caustics.scene import Scene


def is_told(info: WeightsInfo) -> bool:
    """Whether a network is told of its bench, so that it serves a family of them."""
    return isinstance(info.training.get("family"), dict)


class Fit(NamedTuple):
    """A network that serves a scene."""

    file: Path
    name: str
    """For messages."""
    seen: SeenScene
    """The scene as it sees it."""
    warnings: tuple[str, ...]


class Fitting:
    """Compares networks with a scene.

    Args:
        kind: of network, for the command that trains one.
        scene: what it shall be used for.
        device: where to simulate, if need be.
        settings: with which such a network is trained, for messages.
        any_grid: images and heights will be brought to the network's grid, and it will be told of the scene where it
            can be.
    """

    def __init__(
        self,
        kind: str,
        scene: Scene,
        device: str = "cpu",
        settings: Mapping[str, str] | None = None,
        *,
        any_grid: bool = False,
    ):
        self.kind, self.scene, self.device, self.settings = kind, scene, device, settings
        self.any_grid = any_grid

    def fit(self, file: Path, info: WeightsInfo, name: str) -> Fit:
        """Compare with one network.

        Raises:
            MismatchError: it does not serve the scene; says why, and the command that trains one that does.
        """
        scene, kind, settings = self.scene, self.kind, self.settings
        if not self.any_grid:
            seen = SeenScene(scene, scene, 1.0, tuple(range(scene.n_wavelengths)))
            return Fit(file, name, seen, check_scene(scene, info.scene, name, kind, self.device, settings))
        problems = grid_problems(scene, info.scene)
        if problems:
            raise MismatchError(
                f"{name} is for other images: {', '.join(problems)}; train one with: "
                f"{train_command(kind, scene, settings)}"
            )
        seen, family = seen_scene(scene, info.scene), info.training.get("family")
        if isinstance(family, dict):
            warnings = check_family(seen, info.scene, family, name, kind, settings)
        else:
            warnings = check_scene(scene, info.scene, name, kind, self.device, settings, seen)
        return Fit(file, name, seen, warnings + unseen(seen, info))

    def best(self, infos: Mapping[Path, WeightsInfo]) -> Fit:
        """Of several networks the one with the fewest warnings: one made for the scene before one that is told of it.

        Args:
            infos: by file, one or more.

        Raises:
            MismatchError: none serves the scene; what the nearest says.
        """
        found, refusals = [], []
        for file in sorted(infos, key=lambda file: self._order(infos[file])):
            try:
                found.append(self.fit(file, infos[file], f"shipped network {file.name!r}"))
            except MismatchError as refusal:
                refusals.append(refusal)
                continue
            if not found[-1].warnings:
                break
        if not found:
            raise refusals[0]
        return min(found, key=lambda fit: len(fit.warnings))

    def _order(self, info: WeightsInfo) -> tuple[int, int, int]:
        """The scene's own network, those that can be told of it, others: to compare with these takes simulating."""
        scene = self.scene
        if self.any_grid and not grid_problems(scene, info.scene):
            scene = seen_scene(scene, info.scene).scene
        count, resampled = len(differences(scene, info.scene)), len(differences(self.scene, info.scene))
        can_be_told = self.any_grid and is_told(info)
        if not count:
            return (1 if can_be_told else 0, 0, resampled)
        return (2 if can_be_told else 3, count, resampled)
