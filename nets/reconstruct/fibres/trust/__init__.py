"""How wrong lines may be."""
