"""What the native snippets for a CPU's vector registers share: sixteen photons of a lattice row at a time.

Clang's vectors have no fixed machine behind them: sixteen numbers are one register with AVX-512, two with AVX, four on
others, and the same source is compiled for float and double.
"""

from typing import Any

import warp as wp

LANES = 16
"""Photons handled at once."""

REAL = {wp.float32: "float", wp.float64: "double"}
"""Scalar types in C++."""

_PRELUDE = """
#if !defined(__CUDA_ARCH__)
    #pragma clang fp contract(fast)
    typedef {real} real;
    typedef real V __attribute__((ext_vector_type(16), aligned(sizeof(real))));
    typedef real U __attribute__((ext_vector_type(8), aligned(sizeof(real))));
    typedef real Q __attribute__((ext_vector_type(4), aligned(sizeof(real))));
    typedef int I __attribute__((ext_vector_type(16), aligned(sizeof(int))));
    typedef int I8 __attribute__((ext_vector_type(8), aligned(sizeof(int))));
    const V lane_number = {{0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}};
    const U lane_number8 = {{0, 1, 2, 3, 4, 5, 6, 7}};
    auto load = [](const real* p) __attribute__((always_inline)) -> V {{ return *(const V*)p; }};
    auto load8 = [](const real* p) __attribute__((always_inline)) -> U {{ return *(const U*)p; }};
    auto larger = [](V a, V b) __attribute__((always_inline)) -> V {{ return __builtin_elementwise_max(a, b); }};
    auto smaller = [](V a, V b) __attribute__((always_inline)) -> V {{ return __builtin_elementwise_min(a, b); }};
    auto root_of = [](V a) __attribute__((always_inline)) -> V {{ return __builtin_elementwise_sqrt(a); }};
    auto floor_of = [](V a) __attribute__((always_inline)) -> V {{ return __builtin_elementwise_floor(a); }};
    const V zero = real(0), one = real(1);
"""


def vector_snippet(dtype: Any, body: str) -> str:
    """C++ of a native function: ``body`` on a CPU, nothing on a GPU.

    Args:
        dtype: wp.float32 or wp.float64, ``real`` in the body.
        body: C++ without escapes; knows vectors ``V`` (16), ``U`` (8) and ``Q`` (4 numbers).
    """
    return _PRELUDE.format(real=REAL[dtype]) + body + "\n#endif\n"
