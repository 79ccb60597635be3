"""Page of a run of the test bench: tables and pictures."""
