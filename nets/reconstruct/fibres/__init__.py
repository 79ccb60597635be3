"""``fibres``: the printed lines themselves, from a network's relief to the image."""
