"""The page of a result: one file that opens anywhere, without a network."""
