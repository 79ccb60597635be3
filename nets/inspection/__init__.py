"""Inspection of a plate whose design is known."""
