"""Makes examples/data/capture.tif, the photo of the caustic of examples/data/true_heights.npy, with another renderer.

Mitsuba traces photons through the relief, a mesh of its spline, so that nothing of this project's optics is in the
image that it is tried on. A camera then records it: exposure of each channel, vignetting, dark offset, shot and read
noise, as in dark.tif and flat.tif, which stay. The screen is in contact with the plate (demo.yaml): light is refracted
once. In an environment of its own:

    pip install mitsuba==3.9.1 numpy scipy tifffile
    python examples/make_capture.py          # after make_design.py; LLVM is needed, and two minutes of two cores
"""

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy.ndimage
import tifffile

mi.set_variant("llvm_ad_mono")

DATA = Path(__file__).parent / "data"
PLATE_MM, BASE_MM, SCREEN_MM = 50.0, 3.0, -1e-3
PIXELS = 512
INDICES = (1.4577117327234501, 1.4607994580422927, 1.4671904818645791)
"""Of fused silica at 610, 530 and 430 nm (Malitson 1965)."""
QUADS = 2048
"""Of the mesh, along a side: 16 between two heights."""
PHOTONS = 20480
"""Along a side, one in each cell of a lattice, anywhere in it: 0.3 % of noise in a pixel of flat light."""
CHUNK = 2**23
"""Photons at a time, for memory."""
SEED = 21

GAIN, OFFSET = np.array([5200.0, 6100.0, 4300.0]), np.array([210.0, 205.0, 220.0])
"""Counts of flat light in the middle, and of none, per channel; measured in flat.tif and dark.tif, as what follows."""
VIGNETTING = 0.72
"""Light is 1 - 0.72 r^2, r the distance from the middle in units of the window."""
COUNTS_PER_ELECTRON, READ_NOISE = 0.6, 3.0


def mesh_of(heights_m: np.ndarray) -> mi.Mesh:
    """The relief on its base [mm], with the spline's own normals at the vertices."""
    n, pad = len(heights_m), 8
    coefficients = scipy.ndimage.spline_filter(1e3 * np.pad(heights_m, pad, mode="edge"), order=3)

    def height_mm(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        places = [(at / PLATE_MM + 0.5) * n - 0.5 + pad for at in (y, x)]
        return np.asarray(scipy.ndimage.map_coordinates(coefficients, places, order=3, mode="nearest", prefilter=False))

    along = np.linspace(-PLATE_MM / 2, PLATE_MM / 2, QUADS + 1)
    x, y = np.meshgrid(along, along)
    step = 1e-4
    slopes = [(height_mm(x + dx, y + dy) - height_mm(x - dx, y - dy)) / (2 * step) for dx, dy in ((step, 0), (0, step))]
    normals = np.stack([-slopes[0], -slopes[1], np.ones_like(x)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    corner = np.arange(QUADS * (QUADS + 1)).reshape(QUADS, QUADS + 1)[:, :-1].ravel()
    above = corner + QUADS + 1
    faces = np.concatenate([np.stack([corner, corner + 1, above + 1], -1), np.stack([corner, above + 1, above], -1)])
    mesh = mi.Mesh("relief", (QUADS + 1) ** 2, len(faces), has_vertex_normals=True)
    parts = mi.traverse(mesh)
    parts["vertex_positions"] = np.stack([x, y, BASE_MM + height_mm(x, y)], -1).astype(np.float32).ravel()
    parts["vertex_normals"] = normals.astype(np.float32).ravel()
    parts["faces"] = faces.astype(np.uint32).ravel()
    parts.update()
    return mesh


def traced(scene: mi.Scene, index: float, seed: int) -> np.ndarray:
    """Irradiance on the screen where flat light is 1, shape [512, 512]; row grows with +y."""
    landed = np.zeros(PIXELS * PIXELS)
    rows = max(1, CHUNK // PHOTONS)
    for first in range(0, PHOTONS, rows):
        count = (min(first + rows, PHOTONS) - first) * PHOTONS
        random = mi.PCG32(size=count, initstate=seed * 1_000_003 + first)
        number = dr.arange(mi.UInt32, count)
        x = (mi.Float(number % PHOTONS) + random.next_float32()) * (PLATE_MM / PHOTONS) - PLATE_MM / 2
        y = (mi.Float(number // PHOTONS) + first + random.next_float32()) * (PLATE_MM / PHOTONS) - PLATE_MM / 2
        hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(x, y, 10.0), mi.Vector3f(0, 0, -1)))
        normal = hit.sh_frame.n
        inside = dr.sqrt(1 - (1 - normal.z * normal.z) / index**2)
        towards = mi.Vector3f(0, 0, -1) / index + normal * (normal.z / index - inside)
        reach = (SCREEN_MM - hit.p.z) / towards.z
        column, row = (
            (place / PLATE_MM + 0.5) * PIXELS for place in (hit.p.x + towards.x * reach, hit.p.y + towards.y * reach)
        )
        lands = hit.is_valid() & (column >= 0) & (column < PIXELS) & (row >= 0) & (row < PIXELS)
        pixels = dr.zeros(mi.UInt32, PIXELS * PIXELS)
        pixel = mi.UInt32(row) * PIXELS + mi.UInt32(column)
        dr.scatter_reduce(dr.ReduceOp.Add, pixels, mi.UInt32(1), pixel, lands)
        landed += np.array(pixels)
    return landed.reshape(PIXELS, PIXELS) * (PIXELS / PHOTONS) ** 2


def recorded(irradiance: np.ndarray) -> np.ndarray:
    """Counts of 16 bits, shape [512, 512, 3], of irradiance of that shape."""
    random = np.random.default_rng(SEED)
    along = (np.arange(PIXELS) + 0.5) / PIXELS - 0.5
    seen = 1 - VIGNETTING * (along[:, None, None] ** 2 + along[None, :, None] ** 2)
    electrons = random.poisson(GAIN * seen * irradiance / COUNTS_PER_ELECTRON)
    counts = COUNTS_PER_ELECTRON * electrons + OFFSET + random.normal(0, READ_NOISE, electrons.shape)
    return np.clip(np.rint(counts), 0, 65535).astype(np.uint16)


def main() -> None:
    """Trace the three wavelengths, and write what the camera makes of them."""
    scene = mi.load_dict({"type": "scene", "relief": mesh_of(np.load(DATA / "true_heights.npy"))})
    light = [traced(scene, index, SEED + channel) for channel, index in enumerate(INDICES)]
    tifffile.imwrite(DATA / "capture.tif", recorded(np.stack(light, -1)), photometric="rgb", compression="zlib")


if __name__ == "__main__":
    main()
