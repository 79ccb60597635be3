"""``refine``: descent on the exact model of the caustic.

Problem, on images binned to ever more pixels, with r = S(h) - I in units of the radiosity:

    min_h  mean rho(r) + beta TV(h) + gamma mean min(h, 0)^2,    rho(r) = sqrt(r^2 + w^2) - w,

with the misfit of Charbonnier et al. (1994) and a smoothed total variation (Rudin, Osher and Fatemi 1992; Acar and
Vogel 1994). Downhill in one of two metrics:

    curvature  h = h_0 + K u, K near the inverse of dS/dh; L-BFGS in u (Liu and Nocedal 1989), a Sobolev gradient
               (Neuberger 1997) for h
    height     Adam (Kingma and Ba 2015) with a step that falls along a cosine (Loshchilov and Hutter 2017)

A level ends at the noise (the discrepancy principle, Morozov 1966).

``relief_objective`` has the objective and its gradient, ``curvature_descent`` and ``height_descent`` the two ways down.
"""
