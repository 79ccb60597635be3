"""Where steps by noise begin, in which ways lines move from there, and where they come to."""

from typing import NamedTuple

import torch

from nets.reconstruct.fibres.bench.bench_and_light import Bench
from warp_caustics.prints.line_shape import Shape
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.types import FloatArray


class Place(NamedTuple):
    """Lines, their section, bench and camera.

    Attributes:
        lines: shape [L, 6] [m].
        shape: of their section.
        bench: with its light.
        camera: with its point spread.
    """

    lines: torch.Tensor
    shape: Shape
    bench: Bench
    camera: ChannelCamera


class Ways(NamedTuple):
    """In which lines and their section move.

    Attributes:
        at: where they are, shape [P].
        own: by which each may move in a step at the price of one squared deviation, same shape.
        lowest: to which each may move from where it is, same shape.
        highest: the same upwards.
    """

    at: FloatArray
    own: FloatArray
    lowest: FloatArray
    highest: FloatArray


class Nearer(NamedTuple):
    """A place that leaves less.

    Attributes:
        place: where.
        picture: that it shows, shape [n_w, m, m].
        gain: by how many squared deviations.
    """

    place: Place
    picture: torch.Tensor
    gain: float
