"""SfC: shape from caustics by thresholded Landweber iterations.

Problem (Kassubeck et al., Shape from Caustics, WACV 2021), over heights h or wavelet coefficients c with h = W c:

    min_h  D(S(h), I) + alpha |h|_1   (or alpha_w |c|_1),    a <= h <= b,   h = 0 outside a mask,   sum h near V

with D half the squared, or the absolute, residual. Iteration (Landweber 1951; with the threshold, for linear S,
Daubechies, Defrise and De Mol 2004):

    h <- mask * clamp(shrink(h - tau grad D(S(h), I), tau alpha), a, b),   then the volume heuristic,

with shrink(v, t) = sign(v) max(|v| - t, 0) and tau < 2 / L, L the largest eigenvalue of the Hessian of D. It stops at
the first h whose residual is no more than tau_dis times the noise (the discrepancy principle, Morozov 1966).

``landweber`` has the steps, ``constraints`` mask and volume, ``shrinkage`` and ``wavelets`` the thresholds.
"""
