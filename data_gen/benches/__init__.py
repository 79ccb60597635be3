"""Benches at random: drawn by number, recorded as named numbers, and seen through a camera of their own."""
