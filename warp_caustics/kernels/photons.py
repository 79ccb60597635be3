"""What all photons of a launch share, and where independent random ones start on the plate."""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels import specialised
from warp_caustics.kernels.effects import Effects
from warp_caustics.kernels.made_once import made_once


@made_once
def optics_struct(dtype: Any) -> Any:
    """Struct with everything about the scene that is the same for all paths and wavelengths."""
    vec3 = wp.types.vector(length=3, dtype=dtype)

    class Optics:
        base: dtype  # d [m]
        gap: dtype  # bottom face to screen [m]
        window_x: dtype  # lower edges of the image window [m]
        window_y: dtype
        pixels_per_m_x: dtype
        pixels_per_m_y: dtype
        image_pixels: dtype
        sigma0: dtype  # standard deviation of the footprint on the plate [m]
        half_x: dtype  # half the plate [m]
        half_y: dtype
        squeeze: dtype  # standard deviations between a photon and the nearest edge, at least
        min_var: dtype  # variance added to every footprint [px^2]
        max_var: dtype  # footprints with a larger trace are shrunk to it [px^2]
        wide_pixels: dtype  # footprints that cover more may be left to several threads
        area: dtype  # plate area one path stands for, over the pixel's area
        lamp_var: dtype  # variance of the light's direction [rad^2], or of where it comes from [m^2], per axis
        tilt: vec3  # unit direction of collimated light
        light_x: dtype
        light_y: dtype
        light_z: dtype
        light_distance: dtype  # light to nominal top [m]
        cos_cone: dtype
        steps: dtype  # of fixed-point sums per W/m^2, see fixed_point.py
        most_steps: dtype  # that one path may carry

    return specialised(Optics, dtype)


@made_once
def colour_struct(dtype: Any) -> Any:
    """Struct with what photons of one wavelength have in common."""

    class Colour:
        eta: dtype  # 1 / index of the glass
        ratio: dtype  # index of the glass over that behind the plate
        radiosity: dtype  # [W/m^2]
        flat_share: dtype  # of the flux through a flat plate, over that at normal incidence

    return specialised(Colour, dtype)


@made_once
def photons_struct(dtype: Any) -> Any:
    """Struct with everything a launch needs about a chunk of photons but the relief."""
    Optics = optics_struct(dtype)

    class Photons:
        positions: wp.array2d[dtype]  # where they start [m]: [N, 2], or a lattice's axes [2, columns or rows]
        count: wp.int32  # N
        columns: wp.int32  # of the lattice
        samples_per_m_x: dtype  # of the relief
        samples_per_m_y: dtype
        samples: wp.int32  # n, height samples per axis
        spectra: wp.array3d[dtype]  # of one bench or of each relief's: what Colour holds [1 or B, 4, C]
        clear: wp.array3d[wp.uint8]  # 0 for paths that are lost because they meet the relief again [B, C, N]
        optics: Optics
        benches: wp.array[Optics]  # of each relief, where they differ [B]

    return specialised(Photons, dtype)


@made_once
def bench_functions(dtype: Any, effects: Effects) -> SimpleNamespace:
    """``optics_of`` and ``colour_of``: of the bench that relief b stands on."""
    Photons, Colour = photons_struct(dtype), colour_struct(dtype)
    has_many = effects.many_benches

    @no_type_check
    @wp.func
    def optics_of(photons: Photons, b: wp.int32):
        optics = photons.optics
        if wp.static(has_many):
            optics = photons.benches[b]
        return optics

    @no_type_check
    @wp.func
    def colour_of(photons: Photons, b: wp.int32, c: wp.int32):
        row = wp.int32(0)
        if wp.static(has_many):
            row = b
        spectra = photons.spectra
        return Colour(spectra[row, 0, c], spectra[row, 1, c], spectra[row, 2, c], spectra[row, 3, c])

    return SimpleNamespace(optics_of=optics_of, colour_of=colour_of)


@made_once
def photon_kernels(dtype: Any) -> SimpleNamespace:
    """Kernels for float32 or float64: ``place_random``."""
    scale = wp.constant(dtype(2.0**-32))
    half = wp.constant(dtype(0.5))

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def place_random(
        key0: wp.uint32,
        key1: wp.uint32,
        first: wp.int64,
        jitter_columns: wp.int32,
        jitter_rows: wp.int32,
        length_x: dtype,
        length_y: dtype,
        # outputs
        positions: wp.array2d[dtype],
    ):
        """Independent uniform positions on the plate [m]; with jitter_columns > 0 one per cell of a grid.

        The stream of a photon depends on both keys and on its index alone, so
        chunks of any size, on any device, give the same photons.
        """
        tid = wp.tid()
        index = first + wp.int64(tid)
        low = wp.uint32(index & wp.int64(0xFFFFFFFF))
        high = wp.uint32(index >> wp.int64(32))
        # Two rounds of Warp's hash with a key word each: no seed is another seed plus an offset.
        state = wp.rand_init(wp.int32(key0 ^ high), wp.int32(low))
        state = wp.rand_init(wp.int32(key1 ^ state), wp.int32(low))
        u = (dtype(wp.randu(state)) + half) * scale
        v = (dtype(wp.randu(state)) + half) * scale
        if jitter_columns > 0:
            column = index % wp.int64(jitter_columns)
            row = index // wp.int64(jitter_columns)
            u = (dtype(column) + u) / dtype(jitter_columns)
            v = (dtype(row) + v) / dtype(jitter_rows)
        positions[tid, 0] = (u - half) * length_x
        positions[tid, 1] = (v - half) * length_y

    return SimpleNamespace(place_random=place_random)
