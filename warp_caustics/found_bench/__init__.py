"""Numbers of a bench from one image of an unknown plate: which of them it tells, and how well.

Heights and bench explain an image together. A bench that is told wrongly comes back as heights that make up for it, so
its numbers move here with what heights would do in answer (:mod:`~warp_caustics.found_bench.height_changes`), and what
those can make up for entirely is not told (:mod:`~warp_caustics.found_bench.bench_numbers`). The heights themselves are
found by whoever asks, in turn with :mod:`~warp_caustics.found_bench.bench_step`.
"""
