"""How a colour camera saw a caustic: where each channel lies, how blurred it is, and what its numbers mean."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from warp_caustics.reconstruct.seen_camera.pixel_means import Lay
from warp_caustics.reconstruct.seen_camera.point_spread import PointSpread
from warp_caustics.types import FloatArray

WARNED_SHIFT_PX = 0.1
"""Channels further apart than this are worth a warning where a method has not seen such; perfect images show up to 0.01
px. One that has is as good with channels 0.5 px apart as without: nothing that a user must know (docs/bench.md)."""
TRAINED_BLUR_PX = 2.0
"""Networks have seen blur up to this."""


@dataclass(frozen=True)
class ChannelCamera:
    """Camera of one image; all zeros (and gains of 1) is one that shows each pixel as it is.

    Attributes:
        shift: of a channel's picture against the middle one's, towards larger x and y [px], shape [n_w, 2].
        scale: its magnification about the middle of the image, less 1, shape [n_w].
        blur: standard deviation of the PSF [px], shape [n_w].
        gain: signal of the simulated light, shape [n_w]. Told, not undone: the exposure is found elsewhere.
        ambient: light that is not the lamp's, in units of the radiosity, shape [n_w]. Told, not undone.
        pixels: m, size of the image in which these pixels are counted.
        spread: of points of light, where it is known better than by a Gaussian; ``blur`` is the one that is nearest.
        size: of the whole picture as it was taken; it has been brought back to 1.
    """

    shift: FloatArray
    scale: FloatArray
    blur: FloatArray
    gain: FloatArray
    ambient: FloatArray
    pixels: int
    spread: PointSpread | None = None
    size: float = 1.0

    @classmethod
    def perfect(cls, channels: int, pixels: int) -> Self:
        """The camera that changes nothing."""
        zero, one = np.zeros(channels), np.ones(channels)
        return cls(np.zeros((channels, 2)), zero, zero.copy(), one, zero.copy(), pixels)

    @classmethod
    def of_record(cls, record: dict[str, Any], pixels: int) -> Self:
        """The camera that :attr:`record` was made of."""
        keys = ("shift_px", "scale", "blur_px", "gain", "ambient")
        shift, scale, blur, gain, ambient = (np.asarray(record[key], dtype=np.float64) for key in keys)
        spread = PointSpread.of_record(record["spread"]) if "spread" in record else None
        return cls(shift, scale, blur, gain, ambient, pixels, spread)

    @property
    def displaces(self) -> bool:
        """Whether channels are to be moved onto the middle one."""
        return bool(np.any(self.shift) or np.any(self.scale))

    @property
    def lays(self) -> list[Lay] | None:
        """Where each channel's picture lay on the pixels; None where all lie where they belong."""
        if not self.displaces and self.size == 1:
            return None
        return [
            Lay((float(x), float(y)), float(scale), float(self.size))
            for (x, y), scale in zip(self.shift, self.scale, strict=True)
        ]

    @property
    def shown_by(self) -> PointSpread:
        """The point spread, or the Gaussian after the pixels that stands for it."""
        return PointSpread.of_band(self.blur) if self.spread is None else self.spread

    @property
    def blurs(self) -> bool:
        """Whether simulated images are to be blurred."""
        return bool(np.any(self.blur)) or self.spread is not None

    @property
    def is_perfect(self) -> bool:
        """Whether there is nothing to do."""
        return not (self.displaces or self.blurs)

    def sharp(self) -> Self:
        """The same without its blur, for models that know none."""
        return replace(self, blur=np.zeros_like(self.blur), spread=None)

    def of_channel(self, channel: int) -> Self:
        """That of one channel."""
        kept = [channel]
        return type(self)(
            *(self.shift[kept], self.scale[kept], self.blur[kept], self.gain[kept], self.ambient[kept]),
            pixels=self.pixels,
            spread=None if self.spread is None else self.spread.of_channel(channel),
            size=self.size,
        )

    @property
    def apart_px(self) -> FloatArray:
        """Largest displacement of each channel [px], shape [n_w]: in the middle, or at a corner of the image."""
        return displacement_px(self.shift, self.scale, self.pixels)

    def blur_at(self, pixels: int) -> FloatArray:
        """Blur in pixels of an image binned to pixels x pixels, shape [n_w]."""
        return self.blur * (pixels / self.pixels)

    @property
    def record(self) -> dict[str, Any]:
        """For a result's counters."""
        return {
            "shift_px": self.shift.tolist(),
            "scale": self.scale.tolist(),
            "blur_px": self.blur.tolist(),
            "gain": self.gain.tolist(),
            "ambient": self.ambient.tolist(),
        } | ({} if self.spread is None else {"spread": self.spread.record})

    def warnings(
        self,
        wavelengths_m: Sequence[float],
        trained_px: float | None = None,
        trained_blur_px: float = TRAINED_BLUR_PX,
    ) -> list[str]:
        """What the user should know, a line each.

        Args:
            wavelengths_m: of the channels [m], by which they are named.
            trained_px: displacement that the network has seen [px of this image]; None if that is not known.
            trained_blur_px: blur that it has seen [px of this image].
        """
        names = [f"{1e9 * wavelength:g} nm" for wavelength in wavelengths_m]
        told, apart = [], self.apart_px
        worst, blurred = int(apart.argmax()), int(self.blur.argmax())
        if apart[worst] > max(WARNED_SHIFT_PX, trained_px or 0.0):
            told.append(
                f"the image of {names[worst]} lies up to {apart[worst]:.2f} px beside that of "
                f"{names[len(names) // 2]} (lateral colour of the lens, mosaic of the sensor); undone to refine"
            )
            if trained_px is not None:
                told[-1] += f", direct was trained for no more than {trained_px:g} px; correct it in the raw converter"
        if self.blur[blurred] > trained_blur_px:
            told.append(
                f"the image of {names[blurred]} is blurred by {self.blur[blurred]:.1f} px (standard deviation), "
                f"networks know up to {trained_blur_px:g} px; focus, or bin the image"
            )
        return told


def displacement_px(shift: FloatArray, scale: FloatArray, pixels: int) -> FloatArray:
    """Largest displacement that shift [px] (shape [n_w, 2]) and scale make, shape [n_w]: middle or a corner."""
    corner = np.abs(shift) + np.abs(scale)[:, None] * (pixels / 2)
    return np.asarray(np.maximum(np.hypot(*shift.T), np.hypot(*corner.T)))
