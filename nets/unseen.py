"""What of a user's images and plates the training of a network did not show, by the record of its file."""

from collections.abc import Iterator, Mapping
from typing import Any

from data_gen.config import ReliefConfig
from nets.seen_scene import SeenScene
from nets.weights import WeightsInfo

COARSE = 0.75
"""Pixels a side over the network's own, below which a picture shows less than those that the network knows."""
NOTICED = 1.1
"""How much larger than it is a plate may look before the prints that a network knows are told."""


def unseen(seen: SeenScene, info: WeightsInfo) -> tuple[str, ...]:
    """Warnings of using a network on another grid, plate or number of wavelengths.

    Args:
        seen: the user's scene, as the network sees it.
        info: what the network's file says of itself.
    """
    return (*_pictures(seen, info), *_prints(seen, info))


def _pictures(seen: SeenScene, info: WeightsInfo) -> Iterator[str]:
    pictures = _config(info).get("pictures")
    own, pixels = info.scene.image_pixels, seen.user.image_pixels
    if pixels < COARSE * own and not (isinstance(pictures, dict) and pictures.get("coarse_share")):
        yield (
            f"the network was trained with {own} pixels a side, never with as few as {pixels}: edges of lines are "
            "softer than any it knows; take a larger picture, or weights trained with --set "
            "training.pictures.coarse_share=0.1"
        )
    if seen.shown == info.scene.n_wavelengths:
        return
    key = "one_wavelength_share" if seen.shown == 1 else "two_wavelengths_share"
    if not (isinstance(pictures, dict) and pictures.get(key)):
        yield (
            f"the network was trained with {info.scene.n_wavelengths} wavelengths, never with {seen.shown}: a valley "
            "may be taken for a ridge; give more wavelengths, or weights trained with --set "
            f"training.pictures.{key}=0.1"
        )


def _prints(seen: SeenScene, info: WeightsInfo) -> Iterator[str]:
    """Scaled plates have scaled prints: on small plates those of usual size are wider and higher than any known."""
    usual = ReliefConfig()
    known = [_largest(info, key) for key in ("line_width_m", "line_height_m")]
    wide, high = (None if value is None else value / seen.scale for value in known)
    if seen.scale <= NOTICED or wide is None or high is None:
        return
    if wide < usual.line_width_m[1] or high < usual.line_height_m[1]:
        yield (
            f"lengths of this plate look {seen.scale:.3g} times as large to the network: of lines it knows up to "
            f"{1e3 * wide:.2g} mm of width and {1e3 * high:.2g} mm of height here, larger ones are a guess"
        )


def _largest(info: WeightsInfo, key: str) -> float | None:
    """Largest value of a range in what was printed for a training; None where its file does not tell."""
    bench = _config(info).get("bench")
    kinds = bench.get("prints") if isinstance(bench, dict) else None
    reliefs = [kind.get("reliefs") for kind in kinds] if kinds else [info.training.get("reliefs")]
    found = [each[key][1] for each in reliefs if isinstance(each, dict) and isinstance(each.get(key), list)]
    return max(found, default=None)


def _config(info: WeightsInfo) -> Mapping[str, Any]:
    config = info.training.get("config")
    return config if isinstance(config, dict) else {}
