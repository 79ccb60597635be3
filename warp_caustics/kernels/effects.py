"""Which effects kernels are built with: what is off is not compiled, and costs nothing."""

from typing import NamedTuple


class Effects(NamedTuple):
    """Key of kernel factories.

    Attributes:
        fresnel: paths lose what both faces reflect (``fresnel.py``).
    """

    fresnel: bool = False


PLAIN = Effects()
"""Refraction alone."""
