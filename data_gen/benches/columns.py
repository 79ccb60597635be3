"""The numbers that a bench is recorded as: their names, units and meanings, in the order of a data set's columns."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from data_gen.sampler import Column
from warp_caustics.types import FloatArray

SEED_BITS = 52
"""Of a bench's noise: whole numbers of so many bits are exact in a double."""

_SET_UP = (
    ("gap_m", "m", "plate to screen"),
    ("base_thickness_m", "m", "base"),
    ("index_offset", "", "added to the index of the glass at 587.6 nm"),
    ("dispersion_scale", "", "dispersion over that of the named glass"),
    ("is_point_source", "", "1 for a point source, 0 for collimated light"),
    ("lamp_distance_m", "m", "point source to the plate's top; 0 for collimated light"),
    ("lamp_half_angle_rad", "rad", "half the angle under which the lamp is seen from the plate"),
    ("tilt_x_rad", "rad", "direction of the light from aside, along x"),
    ("tilt_y_rad", "rad", "the same along y"),
    ("fresnel", "", "1 where Fresnel's losses are there"),
)
_OF_WAVELENGTH = (
    ("psf_px", "px", "standard deviation of the PSF"),
    ("colour_shift_x_px", "px", "shift of the wavelength's picture along x"),
    ("colour_shift_y_px", "px", "the same along y"),
    ("colour_scale", "", "magnification of the wavelength's picture, less 1"),
    ("gain", "", "of the channel"),
)
_CAMERA = (
    ("box_px", "px", "width of the square that light is averaged over"),
    ("shift_x_px", "px", "displacement of the picture along x"),
    ("shift_y_px", "px", "the same along y"),
    ("turn_rad", "rad", "from x towards y"),
    ("magnification", "", "camera pixels per pixel of the window"),
    ("light_x", "", "uneven light: coefficient of x"),
    ("light_y", "", "of y"),
    ("light_xx", "", "of x^2 less its mean"),
    ("light_xy", "", "of x y"),
    ("light_yy", "", "of y^2 less its mean"),
    ("ambient", "", "light that goes other ways, relative to that of a flat plate"),
    ("mixing", "", "part of each channel's light that is that of other wavelengths"),
    ("has_mosaic", "", "1 for a mosaic of colour filters (rggb)"),
    ("is_calibrated", "", "1 where the photo is divided by its flat frame"),
    ("exposure", "", "part of full scale that a flat plate's light fills"),
    ("noise", "", "standard deviation over mean of flat light in a photo"),
    ("read_share", "", "of the variance of the noise that does not depend on the light"),
    ("calibration_frames", "", "exposures of the dark and of the flat frame"),
    ("black_level", "", "part of full scale that a pixel without light shows"),
    ("bits", "", "of the converter"),
    ("speckle_contrast", "", "standard deviation over mean of speckle"),
    ("speckle_width_px", "px", "width of speckle"),
    ("dust_grains", "", "grains in photo and flat frame"),
    ("fresh_dust_grains", "", "grains in the photo alone"),
    ("hot_pixels", "", "pixels that shine in the dark, on average"),
    ("noise_seed", "", "of speckle, dust, hot pixels and noise"),
)
_PRINT = (
    ("print_kind", "", "number of the kind of prints"),
    ("print_section", "", "number of the cross section (warp_caustics.prints.sections.KINDS)"),
    ("print_exponent", "", "g of the section"),
    ("print_reach", "", "e of a Gaussian section"),
    ("print_contact_angle_rad", "rad", "theta of a cap"),
    ("print_merging", "", "p of lines on top of each other; 1 adds them up, 0 takes the highest"),
    ("print_bow_xx", "1/m", "bow of the base: coefficient of x^2"),
    ("print_bow_xy", "1/m", "of x y"),
    ("print_bow_yy", "1/m", "of y^2"),
    ("print_base_wave_m", "m", "amplitude of a wave of the base"),
    ("print_fibre_diameter_m", "m", "fibre whose glass lines have; 0 where the pattern says their size"),
    ("print_waviness", "", "largest change of width and height along a line, relative"),
    ("print_sideways_m", "m", "largest distance of a line from where it should be"),
    ("print_wavelength_m", "m", "of both"),
    ("print_end_thickness", "", "more width and height at the ends, relative"),
    ("print_end_length_m", "m", "over which that falls to 1/e"),
)
SET_UP_NAMES = tuple(name for name, _, _ in _SET_UP)
PRINT_NAMES = tuple(name for name, _, _ in _PRINT)


def channel_names(name: str, wavelengths: int) -> tuple[str, ...]:
    """Columns of something that each wavelength has: ``psf_px_0``, ``psf_px_1`` ..."""
    return tuple(f"{name}_{channel}" for channel in range(wavelengths))


@cache
def bench_columns(wavelengths: int) -> tuple[Column, ...]:
    """Columns of a bench that shows so many wavelengths."""
    of_channels = [
        Column(column, unit, f"{description}, wavelength {channel}")
        for name, unit, description in _OF_WAVELENGTH
        for channel, column in enumerate(channel_names(name, wavelengths))
    ]
    return (
        *(Column(*words) for words in _SET_UP),
        *of_channels,
        *(Column(*words) for words in _CAMERA),
        *(Column(*words) for words in _PRINT),
    )


@cache
def _places(wavelengths: int) -> dict[str, int]:
    return {column.name: place for place, column in enumerate(bench_columns(wavelengths))}


@dataclass(frozen=True)
class BenchBatch:
    """Benches of some samples.

    Attributes:
        wavelengths: n_w.
        values: one bench a row, shape [B, K], float64; K columns of :func:`bench_columns`.
    """

    wavelengths: int
    values: npt.NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, rows: slice | npt.NDArray[np.intp]) -> "BenchBatch":
        return BenchBatch(self.wavelengths, self.values[rows])

    def of(self, name: str) -> npt.NDArray[np.float64]:
        """A column, shape [B]."""
        column: npt.NDArray[np.float64] = self.values[:, _places(self.wavelengths)[name]]
        return column

    def channels(self, name: str) -> FloatArray:
        """Columns that each wavelength has, shape [B, n_w]."""
        return np.stack([self.of(column) for column in channel_names(name, self.wavelengths)], axis=1)

    def record(self, row: int) -> dict[str, float]:
        """One bench, value by name."""
        return {name: float(self.values[row, place]) for name, place in _places(self.wavelengths).items()}


def bench_batch(wavelengths: int, columns: Mapping[str, FloatArray]) -> BenchBatch:
    """Benches of all their columns, shape [B] each."""
    return BenchBatch(wavelengths, np.stack([columns[name] for name in _places(wavelengths)], axis=1))
