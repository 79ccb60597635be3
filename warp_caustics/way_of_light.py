"""How far light goes behind a relief, per slope by which it was bent."""

from warp_caustics.scene import Scene


def ways_of_light_m(scene: Scene) -> list[float]:
    """D: how far light of each wavelength goes per slope, through base and gap [m], length n_w."""
    gap = -scene.screen_position_m[2]
    indices = zip(scene.glass_indices, scene.exit_indices, strict=True)
    return [scene.base_thickness_m / glass + gap / outside for glass, outside in indices]


def way_of_light_m(scene: Scene) -> float:
    """The same, mean over the wavelengths that shine [m]."""
    lit = [way for way, light in zip(ways_of_light_m(scene), scene.radiosity_W_m2, strict=True) if light > 0]
    return sum(lit) / len(lit)
