"""What lines are compared with, the misfit that they descend on, and what they leave of an image."""
