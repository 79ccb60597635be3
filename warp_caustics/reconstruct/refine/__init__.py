"""``refine``: descent on the exact model of the caustic."""
