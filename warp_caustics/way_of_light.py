"""How far light goes behind a relief, per slope by which it was bent."""

from warp_caustics.scene import Scene


def way_of_light_m(scene: Scene) -> float:
    """D: how far light goes per slope, through base and gap [m], mean over the wavelengths that shine."""
    gap = -scene.screen_position_m[2]
    ways = [
        scene.base_thickness_m / glass + gap / outside
        for glass, outside, light in zip(scene.glass_indices, scene.exit_indices, scene.radiosity_W_m2, strict=True)
        if light > 0
    ]
    return sum(ways) / len(ways)
