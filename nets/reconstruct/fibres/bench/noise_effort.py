"""What a device does for steps by noise."""

from typing import NamedTuple

import numpy as np


class Effort(NamedTuple):
    """What a device can do in seconds, or minutes.

    Attributes:
        finer: times as many fine pixels along the image as usual, of pictures that are compared with it; one time less
            tells by how much these are off.
        rounds: times that derivatives are taken, at most.
        renews_bench: those by the bench's numbers each time, too; else once.
        follows_light: light that meets the relief again is followed in every picture; else in the first one alone, and
            what others show less by it is taken from there.
        most_pixels: along an image, of larger ones none are made.
        changes: numbers of lines by which derivatives are taken at a time; each takes 0.1 GB of a CPU's memory.
    """

    finer: int
    rounds: int
    renews_bench: bool
    follows_light: bool
    most_pixels: float
    changes: int


EFFORTS = {"cuda": Effort(3, 8, True, True, np.inf, 1), "cpu": Effort(2, 2, False, False, 512, 8)}
"""By device. Of 1,024 pixels and more pictures take two cores four times as long as of 512, and derivatives four times
the memory: 1 GB for forty lines of 512. To follow light takes six times as long, and hardly 1 % of it is lost. A third
time derivatives are taken gained 0 to 4 squared deviations on six benches of three lines, and 20 of 7,000 on a plate of
five, no nearer to the truth; with those by the bench's numbers of the first time steps end as near."""
