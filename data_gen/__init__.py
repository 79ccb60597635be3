"""Printed reliefs: what the fibres of Tab. 3 of the supplement look like as height fields."""
