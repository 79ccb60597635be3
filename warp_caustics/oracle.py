"""The same model in plain torch, float64, slow and simple: what every kernel is checked against.

Written to be read, and independently of the kernels: the spline from its
definition, Snell's law with normalised vectors, the Jacobian of the map by
automatic differentiation, every footprint evaluated on every pixel. Memory
grows with photons x pixels: use tiny scenes. It imports nothing from what it
checks; its constants are written out once more.

Shapes: N photons, n x n heights, m x m pixels; a point of the plate is [2].
"""

import math

import torch

from warp_caustics.scene import Profile, Scene

_EXTENSION = 24
"""Samples by which the relief goes on beyond its edges: the spline forgets them by 0.27 per sample."""

_GAUSSIAN_REACH = 4.0
"""Half-width of the truncated Gaussian, in standard deviations of the whole one."""

_GAUSSIAN_ENERGY = math.erf(_GAUSSIAN_REACH / math.sqrt(2))
"""Energy of the whole Gaussian within that."""

_GAUSSIAN_SIGMA = math.sqrt(
    1 - 2 * _GAUSSIAN_REACH * math.exp(-(_GAUSSIAN_REACH**2) / 2) / math.sqrt(2 * math.pi) / _GAUSSIAN_ENERGY
)
"""Standard deviation of what is left; footprints are stretched by its inverse, so that theirs is as asked for."""

_REACH = {"gaussian": _GAUSSIAN_REACH / _GAUSSIAN_SIGMA, "spline": 3.0}
"""Half-width of each profile in standard deviations."""

_BOX_VARIANCE = 1 / 12
"""Variance of a pixel's box [px^2]."""

_LOOKS = 1500
"""Points of a path at which light is looked for outside of the glass."""

_PATHS_AT_ONCE = 8
"""Paths looked along together: their places and the splines there stay within the cache."""

_SHALLOWEST = 1e-5
"""By how much it has to be outside [samples]."""

_GENTLE = 0.7
"""Slopes along an axis, up to 1 together, up to which no light meets the relief again: it is bent by less than 1."""

_LEAST_SIGMA_PX = 0.02
"""Standard deviation added to every footprint [px]."""

_LARGEST_SIGMA = 1 / 16
"""Largest root of a footprint's trace, as a fraction of the image."""


def spline_coefficients(heights: torch.Tensor) -> torch.Tensor:
    """Interpolating spline coefficients of edge-extended heights [n, n] -> [n + 48, n + 48]."""
    n = heights.shape[0]
    index = torch.clamp(torch.arange(-_EXTENSION, n + _EXTENSION), 0, n - 1)  # [n + 48]
    extended = heights[index][:, index]  # [n + 48, n + 48]
    size = len(index)
    matrix = torch.eye(size, dtype=torch.float64) * (4 / 6)  # [n + 48, n + 48], samples of the spline
    matrix += torch.diag(torch.full((size - 1,), 1 / 6, dtype=torch.float64), 1)
    matrix += torch.diag(torch.full((size - 1,), 1 / 6, dtype=torch.float64), -1)
    # Beyond the extension the coefficients equal the constant edge value.
    matrix[0, 0] += 1 / 6
    matrix[-1, -1] += 1 / 6
    coefficients: torch.Tensor = torch.linalg.solve(matrix, torch.linalg.solve(matrix, extended).T).T
    return coefficients


def spline_basis(u: torch.Tensor) -> torch.Tensor:
    """Centred cubic B-spline, sum_k (-1)^k binom(4, k) (u + 2 - k)_+^3 / 6, of u of shape [n]."""
    signs = torch.tensor([(-1) ** k * math.comb(4, k) / 6 for k in range(5)], dtype=torch.float64)  # [5]
    beyond = u + 2 - torch.arange(5, dtype=torch.float64)[:, None]  # [5, n]
    # One clamp for all five: under nested forward differentiation each operation costs milliseconds.
    basis: torch.Tensor = signs @ torch.clamp(beyond, min=0) ** 3
    return basis


def surface_height(point: torch.Tensor, coefficients: torch.Tensor, scene: Scene) -> torch.Tensor:
    """h at a point (x, y) [m], shape [2] -> scalar [m]."""
    n = scene.height_samples
    index = torch.arange(coefficients.shape[0], dtype=torch.float64) - _EXTENSION  # [n + 48]
    u, v = (point / torch.tensor(scene.plate_size_m, dtype=torch.float64) + 0.5) * n - 0.5
    return spline_basis(v - index) @ coefficients @ spline_basis(u - index)


def screen_position(
    point: torch.Tensor, coefficients: torch.Tensor, scene: Scene, channel: int, aside: torch.Tensor | None = None
) -> torch.Tensor:
    """Where the path through a point of the relief meets the screen [m], shape [2] -> [2]; NaN if reflected.

    ``aside``, shape [2], moves the light: a point source by so much along x and y [m], collimated light by so much
    along the unit vectors of :func:`across` [rad].
    """
    height = surface_height(point, coefficients, scene)  # scalar [m]
    slope = torch.func.jacfwd(surface_height)(point, coefficients, scene)  # [2]
    position = torch.cat([point, (scene.base_thickness_m + height)[None]])  # [3]
    normal = torch.cat([-slope, torch.ones(1, dtype=torch.float64)])
    normal = normal / torch.linalg.vector_norm(normal)  # [3]
    direction = incident_direction(position, scene, aside)  # [3]
    inside = refract(direction, normal, 1.0, scene.glass_indices[channel])  # [3]
    position = position + inside * (position[2] / -inside[2])  # [3], on the bottom face
    upward = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    outside = refract(inside, upward, scene.glass_indices[channel], scene.exit_indices[channel])  # [3]
    position = position + outside * ((position[2] - scene.screen_position_m[2]) / -outside[2])  # [3], on the screen
    return position[:2]


def incident_direction(position: torch.Tensor, scene: Scene, aside: torch.Tensor | None = None) -> torch.Tensor:
    """Unit direction of the light at a position [m], shape [3]; ``aside`` as for :func:`screen_position`.

    Without it, of positions of shape [..., 3] too.
    """
    if scene.is_collimated:
        slopes = [math.tan(angle) for angle in scene.light_tilt_rad]
        ray = torch.tensor([*slopes, -1.0], dtype=torch.float64)
        if aside is not None:
            ray = ray / torch.linalg.vector_norm(ray) + aside @ across(ray)
    else:
        ray = position - torch.tensor(scene.light_position_m, dtype=torch.float64)
        if aside is not None:
            ray = ray - torch.cat([aside, torch.zeros(1, dtype=torch.float64)])
    unit: torch.Tensor = ray / torch.linalg.vector_norm(ray, dim=-1, keepdim=True)
    return unit


def across(ray: torch.Tensor) -> torch.Tensor:
    """Two unit vectors at right angles to a ray [3] and to each other, shape [2, 3]."""
    _, _, vectors = torch.linalg.svd(ray[None])
    basis: torch.Tensor = vectors[1:]
    return basis


def refract(direction: torch.Tensor, normal: torch.Tensor, n_before: float, n_behind: float) -> torch.Tensor:
    """Snell's law for unit vectors [..., 3], normal against the light; NaN at total reflection."""
    eta = n_before / n_behind
    cos_in = -(direction * normal).sum(-1, keepdim=True)
    cos_out = torch.sqrt(1 - eta**2 * (1 - cos_in**2))
    return eta * direction + (eta * cos_in - cos_out) * normal


def path_weight(point: torch.Tensor, coefficients: torch.Tensor, scene: Scene) -> torch.Tensor:
    """Irradiance on the (x, y) plane per unit radiosity at a point of the relief."""
    if scene.is_collimated and not any(scene.light_tilt_rad):
        return torch.ones((), dtype=torch.float64)
    height = surface_height(point, coefficients, scene)  # scalar [m]
    slope = torch.func.jacfwd(surface_height)(point, coefficients, scene)  # [2]
    position = torch.cat([point, (scene.base_thickness_m + height)[None]])  # [3]
    if scene.is_collimated:
        ray = incident_direction(position, scene)
        return torch.relu((ray @ torch.cat([-slope, torch.ones(1, dtype=torch.float64)])) / ray[2])
    ray = position - torch.tensor(scene.light_position_m, dtype=torch.float64)
    distance = torch.linalg.vector_norm(ray)
    facing = -(ray @ torch.cat([-slope, torch.ones(1, dtype=torch.float64)])) / distance
    nominal = scene.light_position_m[2] - scene.base_thickness_m
    in_cone = -ray[2] / distance >= math.cos(scene.emission_half_angle_rad)
    return torch.where(in_cone, torch.relu(facing) * (nominal / distance) ** 2, torch.zeros_like(facing))


def passed_share(point: torch.Tensor, coefficients: torch.Tensor, scene: Scene, channel: int) -> torch.Tensor:
    """Share of the flux that both faces let through at a point of the relief, over that of a flat plate [1].

    Each face takes the light as unpolarised. The flat plate is seen by collimated light as it comes, and right below
    a point source.
    """
    if not scene.fresnel:
        return torch.ones((), dtype=torch.float64)
    height = surface_height(point, coefficients, scene)  # scalar [m]
    slope = torch.func.jacfwd(surface_height)(point, coefficients, scene)  # [2]
    position = torch.cat([point, (scene.base_thickness_m + height)[None]])  # [3]
    normal = torch.cat([-slope, torch.ones(1, dtype=torch.float64)])
    normal = normal / torch.linalg.vector_norm(normal)  # [3]
    upward = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    glass, outside = scene.glass_indices[channel], scene.exit_indices[channel]
    direction = incident_direction(position, scene)  # [3]
    straight = direction if scene.is_collimated else -upward  # [3]

    def through(ray: torch.Tensor, facing: torch.Tensor) -> torch.Tensor:
        inside = refract(ray, facing, 1.0, glass)  # [3]
        first = 1 - reflectance(-(ray @ facing), 1.0, glass)
        return first * (1 - reflectance(-(inside @ upward), glass, outside))

    return through(direction, normal) / through(straight, upward)


def reflectance(cosine: torch.Tensor, n_before: float, n_behind: float) -> torch.Tensor:
    """Part of unpolarised light that a face reflects, by Fresnel's amplitudes; NaN at total reflection."""
    behind = torch.sqrt(1 - (n_before / n_behind) ** 2 * (1 - cosine**2))
    across = (n_before * cosine - n_behind * behind) / (n_before * cosine + n_behind * behind)
    within = (n_behind * cosine - n_before * behind) / (n_behind * cosine + n_before * behind)
    return (across**2 + within**2) / 2


def meets_again(point: torch.Tensor, coefficients: torch.Tensor, scene: Scene, channel: int) -> torch.Tensor:
    """Whether light that enters the glass at a point of the relief comes out of the relief below, shape [2] -> bool.

    Looked for at many points on the straight way down to the lowest that the relief can be, above the plate only.
    """
    height = surface_height(point, coefficients, scene)  # scalar [m]
    slope = torch.func.jacfwd(surface_height)(point, coefficients, scene)  # [2]
    position = torch.cat([point, (scene.base_thickness_m + height)[None]])  # [3]
    normal = torch.cat([-slope, torch.ones(1, dtype=torch.float64)])
    normal = normal / torch.linalg.vector_norm(normal)  # [3]
    inside = refract(incident_direction(position, scene), normal, 1.0, scene.glass_indices[channel])  # [3]
    depth = torch.linspace(0, 1, _LOOKS + 1, dtype=torch.float64)[1:] * (height - coefficients.min())  # [_LOOKS]
    places = point + depth[:, None] * inside[:2] / -inside[2]  # [_LOOKS, 2]
    glass = torch.vmap(lambda place: surface_height(place, coefficients, scene))(places) - (height - depth)
    size = torch.tensor(scene.plate_size_m, dtype=torch.float64)  # [2]
    shallowest = _SHALLOWEST * min(scene.sample_pitch_m)
    return ((glass < -shallowest) & (places.abs() <= size / 2).all(1)).any()


def lamp_covariance(positions: torch.Tensor, coefficients: torch.Tensor, scene: Scene, channel: int) -> torch.Tensor:
    """What a lamp of finite size adds to footprints [px^2], shape [N, 2, 2], from positions [N, 2] [m].

    A uniform disc of radius r has the variance r^2 / 4 along each axis.
    """
    radius = math.sin(scene.lamp_half_angle_rad) if scene.is_collimated else scene.lamp_radius_m
    pixel = torch.tensor(scene.pixel_size_m, dtype=torch.float64)  # [2]
    still = torch.zeros(2, dtype=torch.float64)

    def moved(point: torch.Tensor) -> torch.Tensor:
        def landing(aside: torch.Tensor) -> torch.Tensor:
            return screen_position(point, coefficients, scene, channel, aside)

        found: torch.Tensor = torch.func.jacfwd(landing)(still)
        return found

    spread = torch.vmap(moved)(positions) / pixel[:, None] * radius / 2  # [N, 2, 2], per standard deviation [px]
    return spread @ spread.transpose(1, 2)


def profile_distribution(t: torch.Tensor, profile: Profile) -> torch.Tensor:
    """Distribution function of the footprint's profile at t standard deviations."""
    if profile == "spline":
        # Integral of the quadratic B-spline: truncated powers of degree 3 at knots 2 apart.
        terms = ((-1) ** k * math.comb(3, k) * torch.relu(t / 2 + 1.5 - k) ** 3 / 6 for k in range(4))
        return sum(terms, torch.zeros_like(t))
    scaled = torch.clamp(t * _GAUSSIAN_SIGMA, -_GAUSSIAN_REACH, _GAUSSIAN_REACH)
    below: torch.Tensor = 0.5 + (torch.special.ndtr(scaled) - 0.5) / _GAUSSIAN_ENERGY
    return below


def footprint_pixels(centre: torch.Tensor, covariance: torch.Tensor, pixels: int, profile: Profile) -> torch.Tensor:
    """Integral of footprints over all pixels by the rule of ``kernels/pixels.py``, without a window.

    Args:
        centre: (column, row) [px], shape [N, 2].
        covariance: [px^2], shape [N, 2, 2].
        pixels: m.
        profile: shape of the footprint.

    Returns:
        Shape [N, m, m].
    """
    var_x, cov, var_y = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    edges = torch.arange(pixels + 1, dtype=torch.float64)  # [m + 1]
    offset = edges - centre[:, 1, None]  # [N, m + 1]
    rows = profile_distribution(offset / var_y.sqrt()[:, None], profile).diff(dim=1)  # [N, m]
    beta = cov / (var_y + _BOX_VARIANCE)  # [N]
    row_centre = centre[:, 0, None] + beta[:, None] * (offset[:, :-1] + 0.5)  # [N, m]
    sigma = (var_x - beta * cov).sqrt()  # [N]
    across = (edges - row_centre[:, :, None]) / sigma[:, None, None]  # [N, m, m + 1]
    columns = profile_distribution(across, profile).diff(dim=2)  # [N, m, m]
    return rows[:, :, None] * columns


def oracle_image(
    heights: torch.Tensor,
    scene: Scene,
    positions: torch.Tensor,
    smoothing: float,
    profile: Profile,
    squeeze: bool = False,
) -> torch.Tensor:
    """Irradiance [n_w, m, m] [W/m^2] of heights [n, n] [m] from photons at positions [N, 2] [m].

    Differentiable by autograd. ``squeeze`` ends footprints at the edge of the plate, as for lattices.
    """
    count = len(positions)
    coefficients = spline_coefficients(heights.to(torch.float64))  # [n + 48, n + 48]
    pixel = torch.tensor(scene.pixel_size_m, dtype=torch.float64)  # [2]
    window = torch.tensor(scene.screen_position_m[:2], dtype=torch.float64)  # [2]
    corner = window - torch.tensor(scene.plate_size_m, dtype=torch.float64) / 2  # [2]
    # Covariance of the biweight kernel on a disc of radius s sqrt(A / (pi n_l)).
    sigma0 = smoothing * math.sqrt(scene.plate_area_m2 / (8 * math.pi * count))
    share = scene.plate_area_m2 / count / float(pixel.prod())
    weight = torch.vmap(lambda p: path_weight(p, coefficients, scene))(positions) * share  # [N]
    size = torch.tensor(scene.plate_size_m, dtype=torch.float64)  # [2]
    sigma = torch.full_like(positions, sigma0)  # [N, 2]
    if squeeze:
        sigma = torch.minimum(sigma, (size / 2 - positions.abs()) / _REACH[profile])
    steepest = max(float(coefficients.detach().diff(dim=axis).abs().max()) for axis in (0, 1)) / min(
        scene.sample_pitch_m
    )
    channels = []
    for c in range(scene.n_wavelengths):

        def landing(p: torch.Tensor, channel: int = c) -> torch.Tensor:
            return screen_position(p, coefficients, scene, channel)

        centre = (torch.vmap(landing)(positions) - corner) / pixel  # [N, 2]
        jacobian = torch.vmap(torch.func.jacfwd(landing))(positions)  # [N, 2, 2]
        spread = jacobian / pixel[:, None] * sigma[:, None, :]  # [N, 2, 2], per standard deviation on the plate [px]
        covariance = spread @ spread.transpose(1, 2) + lamp_covariance(positions, coefficients, scene, c)  # [N, 2, 2]
        trace = covariance.diagonal(dim1=1, dim2=2).sum(1)  # [N]
        largest = (_LARGEST_SIGMA * scene.image_pixels) ** 2
        covariance = covariance * torch.clamp(largest / trace, max=1.0)[:, None, None]
        covariance = covariance + _LEAST_SIGMA_PX**2 * torch.eye(2, dtype=torch.float64)
        keep = torch.isfinite(centre).all(1) & (weight > 0)  # [N]
        if scene.second_hits == "lost" and steepest > _GENTLE:

            def leaves(p: torch.Tensor, channel: int = c) -> torch.Tensor:
                return meets_again(p, coefficients.detach(), scene, channel)

            lost = torch.vmap(leaves, chunk_size=_PATHS_AT_ONCE)(positions)  # [N]
            keep = keep & ~lost
        passed = torch.vmap(lambda p, channel=c: passed_share(p, coefficients, scene, channel))(positions)  # [N]
        shares = footprint_pixels(centre[keep], covariance[keep], scene.image_pixels, profile)  # [N, m, m]
        channels.append(torch.einsum("p,pij->ij", (weight * passed)[keep], shares) * scene.radiosity_W_m2[c])
    return torch.stack(channels)
