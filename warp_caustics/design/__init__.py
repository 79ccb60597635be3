"""The way back: a relief whose caustic is a wanted picture."""
