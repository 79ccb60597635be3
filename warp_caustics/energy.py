"""Where the light goes: no loss is silent."""

from typing import Any, NamedTuple

import torch

from warp_caustics.chunked import CPU_SLOTS, on_all_cores, warp_stream
from warp_caustics.errors import InputError
from warp_caustics.kernels.trace import FATE_NAMES, MET_AGAIN
from warp_caustics.photons import Chunk
from warp_caustics.simulator import CausticSimulator

FRESNEL = "fresnel"
"""Key of a budget: light that both faces reflect beyond what a flat plate does."""

MET_AGAIN_NAME = "met_again"
"""Key of a budget: light inside the glass that meets the relief again."""

OVER_BORDER = "over_border"
"""Key of a budget: light of footprints that reach over the border of the image."""


class _Light(NamedTuple):
    """Of a chunk of photons, per wavelength: light and paths of each fate, and light that is reflected or met again."""

    light: torch.Tensor
    paths: torch.Tensor
    reflected: torch.Tensor
    through: torch.Tensor | None = None


def energy_budget(
    simulator: CausticSimulator, heights: torch.Tensor, image: torch.Tensor | None = None
) -> dict[str, Any]:
    """Account of the light of one simulation, by the fate of each path.

    Traced and summed in float64 whatever the simulator's precision: a float32
    sum of 1.6e7 equal photons comes out 4 % short.

    Args:
        simulator: its scene, photons and device are used.
        heights: relief above the base [m], shape [n, n].
        image: their caustic by the same simulator [W/m^2], shape [n_w, m, m]; None leaves ``over_border`` out.

    Returns:
        ``wavelengths_m``; ``emitted_W``, the light that falls on the plate [W]
        (collimated: area times radiosity; tilted or from a point source: what
        meets the relief); for each fate of :data:`FATE_NAMES` the fraction of the
        emitted light, one number per wavelength, and the same for ``fresnel``
        and ``met_again`` where the scene has these losses: all together are 1.
        Where light that meets the relief again is let through, ``met_again`` is
        told beside that sum. A fate counts the path's centre; ``over_border`` is
        the part of the landed light that is not in the image, because footprints
        of paths near the border reach over it: the image holds ``landed - over_border``. For a point source and tilted
        light ``unlit`` counts paths instead of light, because they carry none.

    Raises:
        InputError: no light falls on the plate.
    """
    engine = simulator.engine.in_double_precision
    scene = simulator.scene
    channels = scene.n_wavelengths
    light = torch.zeros(channels, len(FATE_NAMES) + 1, dtype=torch.float64, device=engine.device)
    paths, reflected, through = torch.zeros_like(light), torch.zeros_like(light[:, 0]), torch.zeros_like(light[:, 0])
    batch = heights.detach().to(torch.float64)[None].contiguous()

    def of_chunk(chunk: Chunk) -> _Light:
        positions = engine.positions(chunk)
        maps = engine.maps(coefficients, chunk, positions)
        photons = engine.told(coefficients, engine.photons(positions))
        landed = engine.land(maps, positions, photons)
        passed = landed.energies[0] * landed.shares[0]
        part = _Light(torch.zeros_like(light), torch.zeros_like(paths), (landed.energies[0] - passed).sum(1))
        for fate in range(light.shape[1]):
            is_fate = landed.fates[0] == fate
            count = is_fate.sum(1)
            part.paths[:, fate] = count
            if bool(count.any()):  # most fates are nobody's, and light that is none takes as long to add up
                part.light[:, fate] = torch.where(is_fate, passed, 0.0).sum(1)
        if scene.second_hits != "passed":
            return part
        is_clear = engine.clear_paths(coefficients, photons)[0].bool()
        return part._replace(through=torch.where(is_clear, 0.0, passed).sum(1))

    with warp_stream(engine.device):
        coefficients = engine.coefficients(batch)
        if engine.device.type == "cpu":  # whose launches run on one core each, and share the memory
            parts = on_all_cores(of_chunk, list(engine.parts(CPU_SLOTS)))
        else:
            parts = map(of_chunk, engine.parts(1))
        for part in parts:
            light += part.light
            paths += part.paths
            reflected += part.reflected
            if part.through is not None:
                through += part.through
    pixel_x, pixel_y = scene.pixel_size_m
    if scene.is_collimated and not scene.is_tilted:
        emitted = torch.full((channels,), scene.plate_area_m2 / (pixel_x * pixel_y), dtype=torch.float64)
    else:
        emitted = (light.sum(1) + reflected).cpu()
        if not bool((emitted > 0).all()):
            raise InputError(
                f"none of {engine.plan.count} light paths meets the part of the plate that light's cone of half-angle "
                f"{scene.emission_half_angle_rad:g} rad reaches from {list(scene.light_position_m)} m; move the light, "
                "widen the cone, or raise --n-photons"
            )
    fractions = light.cpu() / emitted[:, None]
    unlit = FATE_NAMES.index("unlit")
    fractions[:, unlit] = paths[:, unlit].cpu() / engine.plan.count
    radiosity = torch.tensor(scene.radiosity_W_m2, dtype=torch.float64)
    emitted_W = emitted * radiosity * pixel_x * pixel_y
    budget: dict[str, Any] = {
        "wavelengths_m": list(scene.wavelengths_m),
        "emitted_W": emitted_W.tolist(),
        **{name: fractions[:, k].tolist() for k, name in enumerate(FATE_NAMES)},
    }
    if scene.fresnel:
        budget[FRESNEL] = (reflected.cpu() / emitted).tolist()
    if scene.second_hits != "ignored":
        met = fractions[:, MET_AGAIN] if scene.second_hits == "lost" else through.cpu() / emitted
        budget[MET_AGAIN_NAME] = met.tolist()
    if image is not None:
        in_image = image.detach().double().sum(dim=(1, 2)).cpu() * pixel_x * pixel_y
        on_screen = fractions[:, FATE_NAMES.index("landed")]
        over = torch.where(emitted_W > 0, on_screen - in_image / torch.where(emitted_W > 0, emitted_W, 1.0), 0.0)
        budget[OVER_BORDER] = over.clamp_min(0.0).tolist()
    return budget


def check_reaches(budget: dict[str, Any]) -> None:
    """Refuse a simulation whose image is black.

    Raises:
        InputError: no light lands in the image.
    """
    if any(budget["landed"]):
        return
    told = ", ".join(
        f"{100 * max(budget[name]):.3g} % {name.replace('_', ' ')}"
        for name in (*FATE_NAMES[1:], FRESNEL, MET_AGAIN_NAME)
        if name in budget
    )
    raise InputError(
        f"no light reaches the image ({told}): it would be black; check scene.screen_position_m and "
        "scene.light_position_m, or whether heights are metres"
    )
