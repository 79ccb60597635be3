"""What a network is told of a bench: numbers of order one, each of which may be unknown.

A parameter p goes in as (p - centre) / scale, times 1 where it is known and 0 where it is not, with that 1 or 0 beside
it. The centre is the scene that the network was made for, the scale half the width of the family in
``configs/family.yaml``. Collimated light and a lamp nearby are one thing: at a point x of the plate, light travels
along t + x / D, t its direction at the plate's centre and 1 / D its divergence, 0 for collimated light.

Not told: Fresnel's losses, which nobody knows, and where the window lies, which is taken out of the picture beforehand
(:mod:`nets.flat_light`).
"""

import math
from typing import Literal, NamedTuple

import torch

from data_gen.bench_ranges import nominal_lamp_rad
from warp_caustics.scene import Scene

Turns = Literal["scalar", "x", "y"]
"""What becomes of a parameter when the plate is turned: nothing, or what becomes of a vector's component."""


class ToldParameter(NamedTuple):
    """One number that a network is told."""

    name: str
    unit: str
    centre: float
    scale: float
    group: str
    """Parameters of one group are known or unknown together."""
    turns: Turns = "scalar"


CAMERA = ("blur_px", "noise")
"""Parameters that are the camera's, at the end of the table; all others are the scene's."""


def told_count(wavelengths: int) -> int:
    """P, the number of parameters that a network for so many wavelengths is told."""
    return 8 + wavelengths


def told_parameters(scene: Scene) -> tuple[ToldParameter, ...]:
    """The table, in the order of the network's inputs; P rows.

    Args:
        scene: that the network is made for; gives the centres.
    """
    middle = scene.n_wavelengths // 2
    others = [k for k in range(scene.n_wavelengths) if k != middle]
    rows = [
        ("base_thickness_m", "m", 2.25e-3, "base", "scalar"),
        ("gap_m", "m", 1.5e-3, "gap", "scalar"),
        ("index", "", 0.045, "index", "scalar"),
        *((f"dispersion_{k}", "", 5e-3, "index", "scalar") for k in others),
        ("light_x", "", 0.02, "light", "x"),
        ("light_y", "", 0.02, "light", "y"),
        ("divergence_1_m", "1/m", 2.0, "divergence", "scalar"),
        ("lamp_half_angle_rad", "rad", 0.009, "lamp", "scalar"),
    ]
    centres = (*bench_values(scene), 0.0, 0.0)
    rows += [("blur_px", "px", 1.0, "blur", "scalar"), ("noise", "", 0.05, "noise", "scalar")]
    return tuple(
        ToldParameter(name, unit, centre, scale, group, turns)  # type: ignore[arg-type]
        for (name, unit, scale, group, turns), centre in zip(rows, centres, strict=True)
    )


def bench_values(scene: Scene) -> tuple[float, ...]:
    """The scene's parameters, P - 2 numbers in the order of the table, SI units.

    ``index`` is that of the plate at the middle wavelength, ``dispersion_k`` that at wavelength k less it.
    """
    indices, middle = scene.glass_indices, scene.n_wavelengths // 2
    dispersion = [index - indices[middle] for k, index in enumerate(indices) if k != middle]
    light, divergence = light_of(scene)
    return (
        scene.base_thickness_m,
        -scene.screen_position_m[2],
        indices[middle],
        *dispersion,
        *light,
        divergence,
        nominal_lamp_rad(scene),
    )


def light_of(scene: Scene) -> tuple[tuple[float, float], float]:
    """t, tangents of the light's direction at the plate's centre, and its divergence 1 / D [1/m]."""
    if scene.is_collimated:
        return (math.tan(scene.light_tilt_rad[0]), math.tan(scene.light_tilt_rad[1])), 0.0
    distance = scene.light_distance_m
    return (-scene.light_position_m[0] / distance, -scene.light_position_m[1] / distance), 1 / distance


class ToldTable:
    """The table as tensors on a device.

    Args:
        scene: that the network is made for.
        device: where parameters are.

    Attributes:
        rows: of the table.
        centre: shape [P], float32.
        scale: the same.
        group: number of each parameter's group, shape [P].
        groups: their names.
    """

    def __init__(self, scene: Scene, device: torch.device | str = "cpu"):
        self.scene, self.rows = scene, told_parameters(scene)
        self.names = tuple(row.name for row in self.rows)
        self.groups = tuple(dict.fromkeys(row.group for row in self.rows))
        self.centre = torch.tensor([row.centre for row in self.rows], dtype=torch.float32, device=device)
        self.scale = torch.tensor([row.scale for row in self.rows], dtype=torch.float32, device=device)
        self.group = torch.tensor([self.groups.index(row.group) for row in self.rows], device=device)
        self.x, self.y = self.names.index("light_x"), self.names.index("light_y")

    def __len__(self) -> int:
        return len(self.rows)

    def place(self, name: str) -> int:
        """Column of a parameter."""
        return self.names.index(name)


def told_of(
    scene: Scene, table: ToldTable, blur_px: float | None = None, noise: float | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """A scene's parameters and which of them are known, shapes [1, P], on the table's device.

    Args:
        scene: told.
        table: of the network.
        blur_px: expected standard deviation of the camera's blur [px]; None where it is not known.
        noise: relative, where it is as bright as behind a flat plate; None where it is not known.
    """
    camera = (blur_px, noise)
    values = [*bench_values(scene), *(0.0 if value is None else value for value in camera)]
    known = [*(1.0 for _ in bench_values(scene)), *(float(value is not None) for value in camera)]
    device = table.centre.device
    told, is_known = (torch.tensor([each], dtype=torch.float32, device=device) for each in (values, known))
    return told, is_known


def dropped(values: torch.Tensor, known: torch.Tensor, table: ToldTable) -> torch.Tensor:
    """What goes into a network, shape [B, 2 P]: parameters of order one, 0 where unknown, and what is known.

    Args:
        values: parameters, shape [B, P], SI units.
        known: 1 or 0, shape [B, P].
        table: of the network.
    """
    return torch.cat(((values - table.centre) / table.scale * known, known), dim=1)


def filled(values: torch.Tensor, known: torch.Tensor, table: ToldTable) -> torch.Tensor:
    """Parameters, shape [B, P], with those of the network's own scene in place of the unknown."""
    return torch.where(known > 0, values, table.centre)


def turned(values: torch.Tensor, symmetries: torch.Tensor, table: ToldTable) -> torch.Tensor:
    """Parameters of benches whose plates and images are turned alike; also of what is known, which has no sign.

    Args:
        values: shape [B, P].
        symmetries: shape [3, B], bool: (mirror x, mirror y, swap x and y), in this order.
        table: of the network.
    """
    mirror_x, mirror_y, swap = symmetries
    x, y = values[:, table.x], values[:, table.y]
    x, y = torch.where(mirror_x, -x, x), torch.where(mirror_y, -y, y)
    result = values.clone()
    result[:, table.x], result[:, table.y] = torch.where(swap, y, x), torch.where(swap, x, y)
    return result
