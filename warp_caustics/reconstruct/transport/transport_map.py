"""Optimal transport between two densities on one square grid: the back-and-forth method.

Of all maps that carry a density f to a density g, the optimal one for the cost
|x - y|^2 / 2 is the only gradient of a convex function (Brenier 1991): it folds
nowhere. It is found by ascent on the dual problem (Jacobs and Leger 2020, "A fast
approach to optimal transport: the back-and-forth method", arXiv 1905.12154),

    J(phi) = sum phi g + sum phi^c f,    phi^c(x) = min_y |x - y|^2 / 2 - phi(y),

stepping in turn in phi and in its transform psi = phi^c,

    phi <- phi + sigma (-Laplacian)^-1 (g - T#f),    psi <- phi^c,    T = id - grad psi,

then the same with f and g, phi and psi exchanged: g - T#f is the gradient of J, taken
in the metric of the Laplacian. c-transforms are separable, axis by axis.

Lengths are pixels here. Departures from the paper: every one-dimensional
minimum is refined by a parabola through its three lowest values, since
displacements of a fraction of a pixel matter; minima are sought within a window
that grows when it proves too small, since light moves a few per cent of the
plate at most, which makes the transform fit a GPU; and light is pushed by
squares as large as they get stretched, so that the sum leaves no gaps.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch.nn.functional import avg_pool2d, grid_sample, interpolate, pad

from warp_caustics.errors import InputError

SUBDIVISION = 4
"""Every cell is pushed forward as so many squares per side."""

MIN_CELLS = 32
"""Cells per side of the coarsest grid, at least."""

FLOORS = (0.3, 0.1, 0.03, 0.0)
"""Light added to both densities, relative to their mean, on the way to the densities themselves. From a guess far
away, a dark image is then approached through brighter ones."""

FIRST_REACH = 4
"""Half the width of the window of the c-transform [px] for a flat potential."""

SHORTER, LONGER = 0.7, 1.25
"""Factors on the length of a step that gained too little, or as much as promised."""

LEAST_PROGRESS, PATIENCE = 0.02, 4
"""A grid is left when the mass error has not become 2 % better for four steps."""

CORRECTIONS, CORRECTION_STEP = 12, 0.7
"""Steps of the last correction, and their length; 1 would solve the linear problem."""

DARKEST = 1e-2
"""Light, relative to the mean, below which a residual is not magnified any more."""

Report = Callable[[str, float], None]
"""Called after every step with a stage and the mass error; may raise to stop."""


@dataclass(frozen=True)
class TransportMap:
    """Map from the cells of f to points of g, both on one N x N grid.

    Attributes:
        displacement_px: (x, y) of T(x) - x [px], shape [2, N, N].
        mass_error: misplaced share of the mass, sum |T#f - g| / (2 sum g): 0 is perfect, 1 nothing fits.
        steps: back-and-forth steps on all grids.
        stop: what ended it early, Ctrl-C or the report; None if nothing did.
    """

    displacement_px: torch.Tensor
    mass_error: float
    steps: int
    stop: KeyboardInterrupt | None = None


def optimal_transport(
    source: torch.Tensor,
    target: torch.Tensor,
    *,
    max_steps: int = 20,
    tolerance: float = 1e-2,
    report: Report | None = None,
) -> TransportMap:
    """Optimal map from one density to another.

    Coarse to fine; on the coarsest grid the floor under both densities falls through
    :data:`FLOORS`. No flag of the iteration is trusted: what counts, and what is
    returned, is the map of the least mass error on the finest grid.

    Args:
        source: density f, not negative, shape [N, N].
        target: density g, not negative, same shape; scaled to the mass of f.
        max_steps: back-and-forth steps per grid and floor, at most.
        tolerance: mass error at which a grid is left, relative to that of no transport at all.
        report: called after every step. KeyboardInterrupt, from here or from Ctrl-C, ends the iteration with the
            best map so far.

    Raises:
        InputError: shapes differ, or a density is negative, not finite, or empty.
    """
    _check_density("source", source)
    _check_density("target", target)
    if source.shape != target.shape:
        raise InputError(f"source {list(source.shape)} and target {list(target.shape)} differ; resample one of them")
    sizes = grid_sizes(len(source))
    potential = torch.zeros(sizes[0], sizes[0], device=source.device, dtype=source.dtype)
    steps, step = 0, 1.0
    stop: KeyboardInterrupt | None = None
    for size in sizes:
        f, g = (_relative(binned(density, size)) for density in (source, target))
        if size != sizes[0]:
            # Lengths double with the number of pixels, potentials are squares of lengths.
            potential = 4 * interpolate(potential[None, None], (size, size), mode="bicubic")[0, 0]
        level = _Level(f, g, potential, step, f"transport, {size} x {size} cells", report)
        try:
            for floor in FLOORS if size == sizes[0] else FLOORS[-1:]:
                if stop is None:
                    level.solve(floor, max_steps, tolerance)
            if size == sizes[-1] and stop is None:
                level.correct()
        except KeyboardInterrupt as interruption:
            stop = interruption
        potential, step = level.best, level.step
        steps += level.steps
    return TransportMap(-level.basis.gradient(potential), mass_error(level.f, level.g, potential), steps, stop)


def grid_sizes(cells: int) -> list[int]:
    """Cells per side from coarse to fine: halved while whole and at least :data:`MIN_CELLS`."""
    sizes = [cells]
    while sizes[0] % 2 == 0 and sizes[0] // 2 >= MIN_CELLS:
        sizes.insert(0, sizes[0] // 2)
    return sizes


def most_steps(cells: int, max_steps: int) -> int:
    """Steps on all grids and floors, at most."""
    return max_steps * (len(grid_sizes(cells)) + len(FLOORS) - 1) + CORRECTIONS


def binned(density: torch.Tensor, size: int) -> torch.Tensor:
    """Means over equal squares, shape [size, size]."""
    return avg_pool2d(density[None, None], len(density) // size)[0, 0]


def _relative(density: torch.Tensor) -> torch.Tensor:
    return density / density.mean()


def _check_density(name: str, density: torch.Tensor) -> None:
    if density.ndim != 2 or density.shape[0] != density.shape[1] or len(density) < 2:
        raise InputError(f"{name} has shape {list(density.shape)}; give a square of at least 2 x 2")
    if not bool(torch.isfinite(density).all()):
        raise InputError(f"{name} is not finite everywhere; repair or mask it")
    if float(density.min()) < 0 or float(density.sum()) <= 0:
        raise InputError(
            f"{name} has minimum {float(density.min()):g} and sum {float(density.sum()):g}; "
            "give densities of at least 0 that are not empty"
        )


class _Level:
    """Back-and-forth ascent on one grid.

    ``best`` is the potential psi of the least mass error, at the last floor.
    """

    def __init__(
        self, f: torch.Tensor, g: torch.Tensor, psi: torch.Tensor, step: float, stage: str, report: Report | None
    ):
        self.f, self.g, self.best, self.step, self.stage, self.report = f, g, psi, step, stage, report
        self.basis, self.steps = CosineBasis(len(f), f), 0

    def solve(self, floor: float, max_steps: int, tolerance: float) -> None:
        """Improve ``best`` for densities with a floor."""
        f, g = ((density + floor) / (1 + floor) for density in (self.f, self.g))
        least, waited = math.inf, 0
        wanted = tolerance * _misplaced(f, g)
        phi = self._transform(self.best)
        psi = self._transform(phi)
        for _ in range(max_steps):
            pushed = push_forward(f, psi)
            error = _misplaced(pushed, g)
            waited = 0 if error < (1 - LEAST_PROGRESS) * least else waited + 1
            if error < least:
                self.best, least = psi, error
            self.steps += 1
            if self.report is not None:
                self.report(self.stage, error)
            if least <= wanted or waited >= PATIENCE:
                break
            phi, psi = self._ascend(phi, psi, g - pushed, g, f)
            phi = self._transform(psi)
            psi, phi = self._ascend(psi, phi, f - push_forward(g, phi), f, g)
            psi = self._transform(phi)

    def correct(self) -> None:
        """Improve ``best`` without c-transforms, which know a potential only to the parabolas between its samples.

        For a potential that is nearly right, T#f changes by div(f grad(change)), taken where the light lands. The same
        step as before, then, with the residual looked up there; kept while the mass error falls. It is what makes
        weak caustics exact: those move less light than the transforms misplace.
        """
        n = len(self.f)
        centres = (torch.arange(n, device=self.f.device, dtype=self.f.dtype) + 0.5) * (2 / n) - 1
        grid = torch.stack(torch.meshgrid(centres, centres, indexing="xy"))
        # The start of all may be the better one.
        psi = min((self.best, torch.zeros_like(self.best)), key=lambda p: mass_error(self.f, self.g, p))
        self.best, least = psi, math.inf
        for _ in range(CORRECTIONS):
            pushed = push_forward(self.f, psi, self.basis)
            error = _misplaced(pushed, self.g)
            if error < least:
                self.best, least = psi, error
            self.steps += 1
            if self.report is not None:
                self.report(self.stage, error)
            # grid_sample spans the square by -1 to 1.
            landed = (grid - self.basis.gradient(psi) * (2 / n)).permute(1, 2, 0)[None]
            excess = ((pushed - self.g) / pushed.clamp_min(DARKEST))[None, None]
            excess = grid_sample(excess, landed, padding_mode="border", align_corners=False)[0, 0]
            psi = psi + CORRECTION_STEP * self.basis.inverse_laplacian(excess * self.f)

    def _ascend(
        self, moved: torch.Tensor, other: torch.Tensor, gradient: torch.Tensor, f: torch.Tensor, g: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """A step in one potential and the transform of the result; sets the length of the next step.

        ``f`` weighs the moved potential in the dual value, ``g`` the other.
        """
        direction = self.basis.inverse_laplacian(gradient)
        wanted = self.step * float((gradient * direction).sum())
        after = moved + self.step * direction
        transformed = self._transform(after)
        gain = float((f * (after - moved)).sum() + (g * (transformed - other)).sum())
        # Armijo and Goldstein's test, as in the paper: a step that gains much less than promised was too long.
        if gain < 0.25 * wanted:
            self.step *= SHORTER
        elif gain > 0.75 * wanted:
            self.step *= LONGER
        return after, transformed

    def _transform(self, potential: torch.Tensor) -> torch.Tensor:
        """c-transform within a window that holds all displacements, with a margin."""
        largest = max(float(potential.diff(dim=axis).abs().max()) for axis in (0, 1))
        reach = min(len(potential) - 1, FIRST_REACH + int(1.25 * largest))
        return c_transform(potential, reach)


def mass_error(source: torch.Tensor, target: torch.Tensor, potential: torch.Tensor) -> float:
    """Share of the mass that id - grad potential puts in the wrong place; all shapes [N, N]."""
    return _misplaced(push_forward(source, potential, CosineBasis(len(source), source)), target)


def _misplaced(found: torch.Tensor, wanted: torch.Tensor) -> float:
    return float((found - wanted).abs().sum() / (2 * wanted.sum()))


class CosineBasis:
    """Cosine transform as a matrix: one code for CPU and GPU, where N^3 matmuls of N <= 512 are nothing.

    Args:
        cells: N.
        like: gives device and dtype.
    """

    def __init__(self, cells: int, like: torch.Tensor):
        index = torch.arange(cells, device=like.device, dtype=like.dtype)
        angle = math.pi / cells * index
        scale = torch.full_like(index, math.sqrt(2 / cells))
        scale[0] = math.sqrt(1 / cells)
        self.matrix = torch.cos(angle[:, None] * (index + 0.5)) * scale[:, None]
        self.sine = -angle[:, None] * torch.sin(angle[:, None] * (index + 0.5)) * scale[:, None]
        edge = torch.arange(cells + 1, device=like.device, dtype=like.dtype)
        self.at_edges = torch.cos(angle[:, None] * edge) * scale[:, None]
        self.sine_at_edges = -angle[:, None] * torch.sin(angle[:, None] * edge) * scale[:, None]
        eigenvalue = 2 - 2 * torch.cos(angle)
        laplacian = eigenvalue[:, None] + eigenvalue[None, :]
        laplacian[0, 0] = 1.0
        self.inverse = 1 / laplacian
        self.inverse[0, 0] = 0.0

    def inverse_laplacian(self, values: torch.Tensor) -> torch.Tensor:
        """u with -Laplacian u = values - mean, free edges, mean 0; shape [N, N]."""
        return self.matrix.T @ ((self.matrix @ values @ self.matrix.T) * self.inverse) @ self.matrix

    def gradient(self, values: torch.Tensor) -> torch.Tensor:
        """(d/dx, d/dy) at the cell centres [1/px], exact for what the cosines hold; shape [2, N, N]."""
        spectrum = self.matrix @ values @ self.matrix.T
        return torch.stack([self.matrix.T @ spectrum @ self.sine, self.sine.T @ spectrum @ self.matrix])

    def corner_gradient(self, values: torch.Tensor) -> torch.Tensor:
        """The same at the corners of the cells, shape [2, N + 1, N + 1]."""
        spectrum = self.matrix @ values @ self.matrix.T
        along_x = self.at_edges.T @ spectrum @ self.sine_at_edges
        return torch.stack([along_x, self.sine_at_edges.T @ spectrum @ self.at_edges])


def c_transform(potential: torch.Tensor, reach: int) -> torch.Tensor:
    """min_y |x - y|^2 / 2 - potential(y) over |x - y| <= reach along each axis, shape [N, N].

    Beyond the edges the potential is mirrored: a mirror image is never nearer than its
    original, so the minimum is unchanged, and the parabola has values on both sides.
    """
    # Axis by axis: min_(a, b) = min_b (b^2/2 + min_a (a^2/2 - phi)).
    return _lower_envelope(_lower_envelope(-potential, reach).T, reach).T.contiguous()


def _lower_envelope(values: torch.Tensor, reach: int) -> torch.Tensor:
    """min_k k^2 / 2 + values[i + k] along the first axis, |k| <= reach, refined between the samples."""
    count = len(values)
    index = torch.arange(-reach - 1, count + reach + 1, device=values.device) % (2 * count)
    padded = values[torch.minimum(index, 2 * count - 1 - index)]
    least = torch.full_like(values, math.inf)
    before, after = least.clone(), least.clone()
    previous, present = padded[:count] + (reach + 1) ** 2 / 2, padded[1 : count + 1] + reach**2 / 2
    for k in range(-reach, reach + 1):
        following = padded[k + reach + 2 : k + reach + 2 + count] + (k + 1) ** 2 / 2
        is_less = present < least
        least = torch.where(is_less, present, least)
        before = torch.where(is_less, previous, before)
        after = torch.where(is_less, following, after)
        previous, present = present, following
    bend = (before - 2 * least + after).clamp_min(1e-12)
    # Where the edge of the window is lower still, the window is too small; no parabola there.
    inside = torch.minimum(before, after) >= least
    return least - torch.where(inside, (before - after) ** 2 / (8 * bend), 0.0)


def push_forward(density: torch.Tensor, potential: torch.Tensor, basis: CosineBasis | None = None) -> torch.Tensor:
    """Density carried by T = id - grad potential, shape [N, N]; mass is conserved to rounding.

    The corners of a cell move by the gradient there, its inside bilinearly. With a basis the gradient is that of the
    cosines; without, differences of neighbours, which blunt fine detail and so keep an iteration calm.
    """
    n = len(density)
    corners = _corner_displacement(potential) if basis is None else -basis.corner_gradient(potential)
    fraction = (torch.arange(SUBDIVISION, device=density.device, dtype=density.dtype) + 0.5) / SUBDIVISION
    base = torch.arange(n, device=density.device, dtype=density.dtype)
    low, high = corners[:, :-1], corners[:, 1:]
    stretch = [corners[axis].diff(dim=1 - axis) for axis in (0, 1)]
    shear = [corners[axis].diff(dim=axis) for axis in (0, 1)]
    result = torch.zeros(n * n, device=density.device, dtype=density.dtype)
    share = density / SUBDIVISION**2
    width = []
    for axis in (0, 1):
        # Extent of a pushed square along this axis: what its Jacobian row says.
        along = (1 + _cell_mean(stretch[axis], axis)).abs() + _cell_mean(shear[axis], 1 - axis).abs()
        width.append((along / SUBDIVISION).clamp(1e-3, 1.0))
    for t in fraction.tolist():
        row = low + t * (high - low)
        left, right = row[:, :, :-1], row[:, :, 1:]
        for s in fraction.tolist():
            moved = left + s * (right - left)
            # Position in pixels, pixel i spanning i to i + 1; T maps the square into itself.
            x, y = (moved[0] + base[None, :] + s), (moved[1] + base[:, None] + t)
            _deposit(result, share, x, y, width, n)
    return result.reshape(n, n)


def _corner_displacement(potential: torch.Tensor) -> torch.Tensor:
    """-grad potential at the corners of the cells, mirrored at the edges, shape [2, N + 1, N + 1]."""
    padded = pad(potential[None, None], (1, 1, 1, 1), mode="replicate")[0, 0]
    along_x, along_y = padded.diff(dim=1), padded.diff(dim=0)
    return -torch.stack([along_x[1:] + along_x[:-1], along_y[:, 1:] + along_y[:, :-1]]) / 2


def _cell_mean(edges: torch.Tensor, axis: int) -> torch.Tensor:
    """Mean over the two edges of each cell; ``axis`` 0 averages rows, 1 columns."""
    return (edges[1:] + edges[:-1]) / 2 if axis == 0 else (edges[:, 1:] + edges[:, :-1]) / 2


def _deposit(
    result: torch.Tensor, share: torch.Tensor, x: torch.Tensor, y: torch.Tensor, width: list[torch.Tensor], n: int
) -> None:
    """Adds rectangles of the given widths (at most a pixel) and total ``share`` to the pixels they cover."""
    column, right = _split(x, width[0], n)
    row, above = _split(y, width[1], n)
    for rows, weight_y in ((row, 1 - above), ((row + 1).clamp_max(n - 1), above)):
        for columns, weight_x in ((column, 1 - right), ((column + 1).clamp_max(n - 1), right)):
            result.index_add_(0, (rows * n + columns).ravel(), (share * weight_y * weight_x).ravel())


def _split(centre: torch.Tensor, width: torch.Tensor, n: int) -> tuple[torch.Tensor, torch.Tensor]:
    """First pixel that an interval covers, and the share of it that lies in the next one."""
    first = (centre - width / 2).floor().clamp(0, n - 1)
    share = ((centre + width / 2 - first - 1) / width).clamp(0, 1)
    return first.long(), share
