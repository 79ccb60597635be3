"""Snippets of C++ for what Warp cannot say: a CPU's vector registers, a GPU's pixels of 16 bytes and sums over threads.

They repeat no physics but the quadratic B-spline of ``profiles.py``, eight edges at a time.
"""

from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.made_once import made_once

PACK = 4
"""Wavelengths in a pixel of a packed image; unused ones stay zero."""

_CPU_ROW = """
#if !defined(__CUDA_ARCH__)
    typedef {real} real;
    typedef real reals __attribute__((ext_vector_type(8), aligned(sizeof(real))));
    const reals zero = {{0, 0, 0, 0, 0, 0, 0, 0}};
    const reals one = {{1, 1, 1, 1, 1, 1, 1, 1}};
    const reals steps = {{0, 1, 2, 3, 4, 5, 6, 7}};
    const int width = image.shape[3];
    auto* row = image.data + ((size_t(b) * image.shape[1] + c) * image.shape[2] + i) * width;
    const real half_inv = real(0.5) * inv_sigma;
    {start}
    for (int j = first; j <= last; j += 7) {{
        reals u = (steps + (real(j) - centre)) * half_inv;
        u = u < real(-1.5) * one ? real(-1.5) * one : u;
        u = u > real(1.5) * one ? real(1.5) * one : u;
        const reals p = u + real(1.5);
        reals q = u + real(0.5);
        q = q > zero ? q : zero;
        reals r = u - real(0.5);
        r = r > zero ? r : zero;
        const reals below = p * p * p - real(3) * (q * q * q - r * r * r);
        const reals shares = __builtin_shufflevector(below, below, 1, 2, 3, 4, 5, 6, 7, 7) - below;
        {each}
    }}
    {end}
#else
    {nothing}
#endif
"""
"""Seven pixels of a row at a time: their eight edges fit a vector register, and the eighth share is zero."""

_CPU_ADD = {
    "start": "",
    "each": """
        const reals light = (amplitude * real(1.0 / 6.0)) * shares;
        if (j + 8 <= width) *(reals*)(row + j) += light;
        else for (int k = 0; j + k < width; ++k) row[j + k] += light[k];
    """,
    "end": "",
    "nothing": "",
}

_CPU_GATHER = {
    "start": "reals sum = zero, slope = zero, breadth = zero;",
    "each": """
        reals g = zero;
        if (j + 8 <= width) g = *(const reals*)(row + j);
        else for (int k = 0; j + k < width; ++k) g[k] = row[j + k];
        const reals density = p * p - real(3) * (q * q - r * r);
        const reals moment = u * density;
        sum += g * shares;
        slope += g * (__builtin_shufflevector(density, density, 1, 2, 3, 4, 5, 6, 7, 7) - density);
        breadth += g * (__builtin_shufflevector(moment, moment, 1, 2, 3, 4, 5, 6, 7, 7) - moment);
    """,
    "end": """
        const auto s4 = sum.lo + sum.hi, d4 = slope.lo + slope.hi, m4 = breadth.lo + breadth.hi;
        const auto s2 = s4.lo + s4.hi, d2 = d4.lo + d4.hi, m2 = m4.lo + m4.hi;
        return wp::vec_t<3, real>(
            real(1.0 / 6.0) * (s2[0] + s2[1]), real(0.25) * (d2[0] + d2[1]), real(0.5) * (m2[0] + m2[1])
        );
    """,
    "nothing": "return wp::vec_t<3, {real}>();",
}


@made_once
def cpu_row_functions(dtype: Any) -> tuple[Any, Any]:
    """A row of a ``spline`` footprint in a CPU's vector registers: ``add_row`` and ``gather_row``.

    LLVM leaves the loops over pixels scalar, since their windows are short and of any length.
    """
    vec3 = wp.types.vector(length=3, dtype=dtype)
    real = _REAL[dtype]

    def snippet(parts: dict[str, str]) -> str:
        return _CPU_ROW.format(real=real, **(parts | {"nothing": parts["nothing"].format(real=real)}))

    @no_type_check
    @wp.func_native(snippet(_CPU_ADD))
    def add_row(
        image: wp.array4d[dtype],
        b: wp.int32,
        c: wp.int32,
        i: wp.int32,
        first: wp.int32,
        last: wp.int32,
        centre: dtype,
        inv_sigma: dtype,
        amplitude: dtype,
    ): ...

    @wp.func_native(snippet(_CPU_GATHER))  # with no_type_check it would return nothing
    def gather_row(
        image: wp.array4d[dtype],
        b: wp.int32,
        c: wp.int32,
        i: wp.int32,
        first: wp.int32,
        last: wp.int32,
        centre: dtype,
        inv_sigma: dtype,
    ) -> vec3: ...

    return add_row, gather_row


_ADD = """
    {real}* pixel = packed.data + ((size_t(b) * packed.shape[1] + i) * packed.shape[2] + j) * 4;
#if {is_vector} && defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
    asm volatile("red.global.add.v4.f32 [%0], {{%1, %2, %3, %4}};"
                 :: "l"(pixel), "f"({light[0]}), "f"({light[1]}), "f"({light[2]}), "f"({light[3]}) : "memory");
#elif defined(__CUDA_ARCH__)
    for (int c = 0; c < {width}; ++c) atomicAdd(pixel + c, light[c]);
#else
    for (int c = 0; c < {width}; ++c) pixel[c] += light[c];
#endif
"""

_LOAD = """
    const {real}* pixel = packed.data + ((size_t(b) * packed.shape[1] + i) * packed.shape[2] + j) * 4;
    wp::vec_t<4, {real}> light;
#if {is_vector} && defined(__CUDA_ARCH__)
    float values[4];
    asm("ld.global.nc.v4.f32 {{%0, %1, %2, %3}}, [%4];"
        : "=f"(values[0]), "=f"(values[1]), "=f"(values[2]), "=f"(values[3]) : "l"(pixel));
    for (int c = 0; c < 4; ++c) light[c] = values[c];
#else
    for (int c = 0; c < 4; ++c) light[c] = pixel[c];
#endif
    return light;
"""


_REAL = {wp.float32: "float", wp.float64: "double"}


def _native_type(dtype: Any) -> dict[str, Any]:
    return {"real": _REAL[dtype], "is_vector": int(dtype is wp.float32)}


@made_once
def pixel_adder(dtype: Any, width: int) -> Any:
    """Adds ``width`` wavelengths to a pixel of a packed image [B, H, W, PACK]."""
    vector = wp.types.vector(length=width, dtype=dtype)
    light = [f"light[{c}]" if c < width else "0.0f" for c in range(PACK)]

    @no_type_check
    @wp.func_native(_ADD.format(**_native_type(dtype), width=width, light=light))
    def add(packed: wp.array4d[dtype], b: wp.int32, i: wp.int32, j: wp.int32, light: vector): ...

    return add


@made_once
def pixel_loader(dtype: Any) -> Any:
    """Reads a pixel of a packed image."""
    vector = wp.types.vector(length=PACK, dtype=dtype)

    @wp.func_native(_LOAD.format(**_native_type(dtype)))  # with no_type_check it would return nothing
    def load(packed: wp.array4d[dtype], b: wp.int32, i: wp.int32, j: wp.int32) -> vector: ...

    return load


WARP_LANES = 32
"""Threads of a GPU that run together."""

_ADD_OVER_LANES = """
    {real}* place = sums.data + size_t(b) * sums.shape[1] * sums.shape[2] + p;
    for (int k = 0; k < 6; ++k, place += sums.shape[2]) {{
        {real} term = terms[k];
#if defined(__CUDA_ARCH__)
        for (int apart = 16; apart > 0; apart /= 2) term += __shfl_xor_sync(0xffffffffu, term, apart);
        if (lane == 0) *place += term;
#else
        *place += term;
#endif
    }}
"""


@made_once
def lanes_adder(dtype: Any) -> Any:
    """Adds what the ``WARP_LANES`` threads of a warp found to six sums [B, 6, N] of their own, in a fixed order.

    A CPU, which runs one thread after the other, adds any number of them.
    """
    vec6 = wp.types.vector(length=6, dtype=dtype)

    @no_type_check
    @wp.func_native(_ADD_OVER_LANES.format(real=_REAL[dtype]))
    def add(sums: wp.array3d[dtype], b: wp.int32, p: wp.int32, terms: vec6, lane: wp.int32): ...

    return add


CELLS_AT_ONCE, LEAST_THREADS = 4, 4
"""Cells that the threads of a warp may stand over for their terms to be added up first, one cell after the other; and
how many threads a cell must have for that."""

_ADD_TO_CELL = """
    const int stride = sums.shape[2];
    {real}* place = sums.data + (size_t(b) * sums.shape[1] + row) * stride + column;
#if defined(__CUDA_ARCH__)
    const unsigned all = 0xffffffffu;
    if (__activemask() == all) {{
        const int lane = threadIdx.x & 31;
        const unsigned long long own = (unsigned long long)place;
        unsigned left = all;
        for (int turn = 0; turn < {cells} && left != 0; ++turn) {{
            const unsigned long long cell = __shfl_sync(all, own, __ffs(left) - 1);
            const bool is_mine = own == cell;
            const unsigned here = __ballot_sync(all, is_mine);
            if (__popc(here) < {threads}) break;
            left &= ~here;
            {sums}
            // Each step halves how many sums a thread keeps and doubles over how many threads they are.
            {steps}
            const {real} total = v0 + __shfl_xor_sync(all, v0, 1);
            if (!(lane & 1)) atomicAdd(({real}*)cell + (lane >> 3) * stride + (lane >> 1 & 3), total);
        }}
        if (!(left >> lane & 1)) return;
    }}
    #pragma unroll
    for (int k = 0; k < 16; ++k) atomicAdd(place + (k >> 2) * stride + (k & 3), terms[k]);
#else
    for (int k = 0; k < 16; ++k) place[(k >> 2) * stride + (k & 3)] += terms[k];
#endif
"""


def _sixteen_sums(real: str) -> tuple[str, str]:
    """C++ of a thread's terms, and of four steps after which ``v0`` is one of sixteen sums; an array would not stay in
    registers."""
    sums = " ".join(f"{real} v{k} = is_mine ? terms[{k}] : ({real})0;" for k in range(16))
    steps = []
    for half in (8, 4, 2, 1):
        for k in range(half):
            given, kept = f"(lane & {2 * half} ? v{k} : v{k + half})", f"(lane & {2 * half} ? v{k + half} : v{k})"
            steps.append(f"v{k} = {kept} + __shfl_xor_sync(all, {given}, {2 * half});")
    return sums, " ".join(steps)


@made_once
def cell_adder(dtype: Any) -> Any:
    """Adds sixteen terms to four by four neighbouring sums [B, n, n], from a row and column on."""
    vec16 = wp.types.vector(length=16, dtype=dtype)
    sums, steps = _sixteen_sums(_REAL[dtype])
    told = {"real": _REAL[dtype], "cells": CELLS_AT_ONCE, "threads": LEAST_THREADS, "sums": sums, "steps": steps}

    @no_type_check
    @wp.func_native(_ADD_TO_CELL.format(**told))
    def add(sums: wp.array3d[dtype], b: wp.int32, row: wp.int32, column: wp.int32, terms: vec16): ...

    return add
