"""Where a flat plate's light lands, and how bright it is: taken out of a picture before a network sees it.

Light that meets the plate at x lands at x + f_w (t + x / D), t its direction at the plate's centre, 1 / D its
divergence and, by Snell's law at both faces (d base, g gap, n and n' the indices of glass and of what is below),

    f_w(s) = (d / sqrt(n^2 - s^2) + g / sqrt(n'^2 - s^2)) sqrt(1 - s^2)

with s the sine of its angle to the normal. A tilt is a shift for each wavelength, a lamp nearby a magnification, and a
window aside a shift of all. What is left of the picture is what the relief did.

f is taken at t for the shift; for the magnification at the angle where a straight line fits its third order best over
the square plate: at <x^4> / <x^2> = 14/15 of the squared half side. What that leaves is below 0.05 px of 512 for a lamp
at 0.25 m.

A lamp nearby lights a flat plate by the cube of the cosine of its angle, and the divergence below spreads that by
(1 + f / D)^2; relative to L_i, which the simulator has at the foot of the lamp.

What a relief does is scaled besides (:meth:`FlatLight.height_scale`).

Closed forms, for thousands of benches in a batch on any device, each told by its numbers. One bench exactly, whatever
its lamp, is simulated: :mod:`warp_caustics.calibration.flat_light`. For lamps from 0.25 m on the two agree to 1e-3; a
test holds that.
"""

import torch

from nets.told import ToldTable, bench_values
from warp_caustics.resampling import resampled, spline_reach
from warp_caustics.scene import Scene

NO_BLUR = spline_reach(0.0)


class FlatLight:
    """Light behind flat plates of benches.

    Args:
        table: of the network; its scene gives plate, pixels and what is below the plate.
    """

    def __init__(self, table: ToldTable):
        scene, device = table.scene, table.centre.device
        self.table, self.pixels, self.wavelengths = table, scene.image_pixels, scene.n_wavelengths
        self.middle = scene.n_wavelengths // 2
        self.is_contact = scene.exit_medium == "glass"
        self.exit = torch.tensor(scene.exit_indices, dtype=torch.float32, device=device)
        self.pixel = torch.tensor(scene.pixel_size_m, dtype=torch.float32, device=device)
        half = [size / 2 for size in scene.plate_size_m]
        self.mean_square_m2 = 14 / 15 * (half[0] ** 2 + half[1] ** 2) / 2
        along_x, along_y = (
            (torch.arange(self.pixels, device=device) + 0.5) * size - edge
            for size, edge in zip(scene.pixel_size_m, half, strict=True)
        )
        self.along_x, self.along_y = along_x.float(), along_y.float()

    def _light(self, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """t, shape [B, 2], and 1 / D, shape [B]."""
        x, y = self.table.x, self.table.y
        return values[:, x : y + 1], values[:, y + 1]

    def _way(self, values: torch.Tensor, tangent2: torch.Tensor) -> torch.Tensor:
        """f [m] of light whose tangent squared to the normal is given, shape [B]; shape [B, n_w]."""
        base, gap, middle = values[:, 0, None], values[:, 1, None], values[:, 2, None]
        apart = values[:, 3 : 2 + self.wavelengths]
        index = torch.cat((middle + apart[:, : self.middle], middle, middle + apart[:, self.middle :]), dim=1)
        outside = index if self.is_contact else self.exit
        cosine2 = 1 / (1 + tangent2[:, None])
        sine2 = 1 - cosine2
        return (base / (index**2 - sine2).sqrt() + gap / (outside**2 - sine2).sqrt()) * cosine2.sqrt()

    def places(self, values: torch.Tensor, window_m: torch.Tensor | None = None) -> tuple[torch.Tensor, torch.Tensor]:
        """How to move a picture so that a flat plate's light lands where it met the plate.

        Args:
            values: parameters, shape [B, P].
            window_m: where the window's centre lies, seen from where light of the middle wavelength through the plate's
                centre lands [m], shape [B, 2]; None for there.

        Returns:
            Shift [px], shape [B, n_w, 2], and magnification less 1, shape [B, n_w], as
            :func:`warp_caustics.resampling.resampled` takes them.
        """
        light, divergence = self._light(values)
        aside = light.square().sum(dim=1)
        shift = self._way(values, aside)[:, :, None] * light[:, None, :]
        shift = shift - shift[:, self.middle, None]
        if window_m is not None:
            shift = shift - window_m[:, None, :]
        larger = 1 + self._way(values, aside + self.mean_square_m2 * divergence**2) * divergence[:, None]
        return -shift / self.pixel / larger[:, :, None], 1 / larger - 1

    def height_scale(self, values: torch.Tensor) -> torch.Tensor:
        """Heights on benches over heights that move light as far on the network's own scene, shape [B, 1, 1].

        To first order a slope s moves light by s (n - 1) f: what a network reads from a picture are heights in the unit
        of its own (n - 1) f. Of the middle wavelength, for light from straight above; 1 for the network's scene.
        """
        own = self.table.centre[None]
        found, here = (
            (each[:, 2] - 1) * self._way(each, torch.zeros_like(each[:, 0]))[:, self.middle] for each in (own, values)
        )
        return (found / here)[:, None, None]

    def level(self, values: torch.Tensor) -> torch.Tensor:
        """Irradiance behind flat plates relative to L_i, in the window's pixels, shape [B, n_w, m, m]."""
        light, divergence = self._light(values)
        larger = 1 + self._way(values, light.square().sum(dim=1)) * divergence[:, None]  # [B, n_w]
        # Where the light of a pixel met the plate, times 1/D: its tangent.
        slope = (divergence[:, None] / larger)[..., None]
        tangent_x = light[:, 0, None, None] + slope * self.along_x  # [B, n_w, m]
        tangent_y = light[:, 1, None, None] + slope * self.along_y
        tangent2 = tangent_x.square()[:, :, None, :] + tangent_y.square()[:, :, :, None]
        is_near = divergence[:, None, None, None] > 0
        level = (1 + tangent2) ** -1.5 / larger[..., None, None] ** 2
        return torch.where(is_near, level, 1.0)

    def rectified(
        self, images: torch.Tensor, values: torch.Tensor, window_m: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Pictures, shape [B, n_w, m, m], moved by :meth:`places`."""
        shift, scale = self.places(values, window_m)
        return resampled(images, shift, scale, torch.zeros_like(scale), NO_BLUR)


def window_of(scene: Scene) -> tuple[float, float]:
    """Where a scene's window lies, seen from where light of the middle wavelength through the plate's centre lands [m].

    For a point source that ray is as tilted as collimated light that comes from the lamp's direction.
    """
    middle = scene.n_wavelengths // 2
    flat = FlatLight(ToldTable(scene))
    values = torch.tensor([[*bench_values(scene), 0.0, 0.0]])
    light, _ = flat._light(values)
    landed = (flat._way(values, light.square().sum(dim=1))[0, middle] * light[0]).tolist()
    return scene.screen_position_m[0] - landed[0], scene.screen_position_m[1] - landed[1]


def rectified(image: torch.Tensor, scene: Scene) -> torch.Tensor:
    """A picture moved and scaled so that a flat plate's light would lie where it met the plate of the told scene.

    A scene of straight light and no window aside gives the picture itself.

    Args:
        image: irradiance, shape [n_w, m, m].
        scene: told.
    """
    table = ToldTable(scene, image.device)
    values = table.centre[None]
    window = window_of(scene)
    if not (values[:, table.x : table.y + 2].any() or any(window)):
        return image
    moved = FlatLight(table).rectified(
        image[None], values, torch.tensor([window], dtype=torch.float32, device=image.device)
    )
    return moved[0].to(image.dtype)
