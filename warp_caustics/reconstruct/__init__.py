"""Methods that recover a relief from its caustic, behind one interface.

Problem: given a measured caustic I, find heights h with S(h) = I, S the simulator. It is ill-posed: slow modes of h
hardly change S(h), and where light paths cross several reliefs have the same caustic. The wings regularise it by

    sfc        sparsity and the printed volume,  min D(S(h), I) + alpha |h|_1 over a <= h <= b
    transport  the one map that folds nowhere,   T = grad of a convex function with T#(light of the flat plate) = I
    refine     a start, and a metric,            min D(S(h), I) + priors, downhill from h_0

(D a misfit; docs/sources.md lists the papers). ``seen_camera`` is what a camera did to the image on the way.

One run reads: ``pyramid`` (check and bin the image), ``exposure`` and ``folds`` (what kind of image it is), a wing,
``run_log`` (history, progress, limits), ``result`` (the relief simulated again: the record).

Words: to *refine* is the method of that wing, and everything it does; a *descent* is an algorithm that goes downhill
(by heights or by curvature); the *refinement* is the height descent with which a method with networks ends; the
*correction* is the last part of the transport.
"""
