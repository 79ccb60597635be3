"""Methods on the suites of the test bench (``data_gen.suites``): scores, runs that go on where they stopped, tables."""
