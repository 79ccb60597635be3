"""The test bench: plates, benches and cameras that methods are judged on, and nothing is trained on.

``conditions`` and ``odd_prints`` are what may differ from the scene that a method expects; ``case`` is one plate on one
bench, ``ideal``, ``one_thing``, ``lab`` and ``print_shapes`` are the suites, ``suites`` their list. ``light`` makes the
irradiance of a case, ``shot`` the image that a method gets, ``export`` files for other programs.
"""
