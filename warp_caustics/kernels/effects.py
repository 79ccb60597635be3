"""Which effects kernels are built with: what is off is not compiled, and costs nothing."""

from typing import NamedTuple


class Effects(NamedTuple):
    """Key of kernel factories.

    Attributes:
        fresnel: paths lose what both faces reflect (``fresnel.py``).
        lamp: the lamp has a size (``lamp.py``, and ``trace.py`` for light from elsewhere than straight above).
        tilt: collimated light comes from the side; the general form alone knows that.
        second_hits: paths that meet the relief again are lost (``second_hits.py``).
    """

    fresnel: bool = False
    lamp: bool = False
    tilt: bool = False
    second_hits: bool = False


PLAIN = Effects()
"""Refraction alone."""
