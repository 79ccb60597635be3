"""Printed lines: one model of a line, its fit to a relief, lists of lines and their tolerance."""
