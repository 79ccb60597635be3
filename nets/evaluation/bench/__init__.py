"""Methods on the suites of the test bench (``data_gen.bench``): scores, runs that go on where they stopped, tables."""
