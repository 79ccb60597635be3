"""Reconstruction by transporting light: back and forth, and HCCCD.

Problem: f the light of the flat plate on the screen, g the measured caustic, both densities of equal mass. Find the map

    min_T  integral f(x) |x - T(x)|^2 dx    with    T#f = g,

which is the gradient of a convex function and unique (Brenier 1991); then the heights h whose refraction R sends light
to where the map says,

    R(x, h(x), grad h(x)) = T(x)    for all x.

Three parts: ``transport_map`` finds T by the back-and-forth method (Jacobs and Leger 2020); ``ray_inversion`` solves
Snell's law for the slopes; ``integrate_normals`` finds the heights with the nearest slopes (Frankot and Chellappa
1988). ``transport`` repeats the last two, for R depends on h; ``hcccd`` moves a mesh (Schwartzburg et al. 2014).

Limit: where light paths cross, the true map folds and T does not.
"""
