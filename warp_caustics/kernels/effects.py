"""Which effects kernels are built with: what is off is not compiled, and costs nothing."""

from typing import NamedTuple


class Effects(NamedTuple):
    """Key of kernel factories.

    Attributes:
        fresnel: paths lose what both faces reflect (``fresnel.py``).
        lamp: the lamp has a size (``lamp.py``, and ``general.py`` for light from elsewhere than straight above).
        tilt: collimated light comes from the side (``general.py``).
        point: light comes from a point (``general.py``).
        second_hits: paths that meet the relief again are lost (``second_hits.py``).
        many_benches: every relief of a batch stands on a bench of its own, all with the same effects.
    """

    fresnel: bool = False
    lamp: bool = False
    tilt: bool = False
    point: bool = False
    second_hits: bool = False
    many_benches: bool = False

    @property
    def is_straight(self) -> bool:
        """Whether light comes from straight above."""
        return not self.tilt and not self.point


PLAIN = Effects()
"""Refraction alone."""
