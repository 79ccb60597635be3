"""Files in and out: images, height maps and meshes.

Everything read is checked first and refused with one clear line; everything
written appears complete or not at all. Importing this package loads no codec.
"""

from warp_caustics.io.atomic import atomic_path
from warp_caustics.io.heights import read_heights, write_heights
from warp_caustics.io.image_file import ImageFile
from warp_caustics.io.images import read_image, write_image
from warp_caustics.io.mesh import height_field_mesh, write_mesh
from warp_caustics.io.noise import estimate_noise_std

__all__ = [
    "ImageFile",
    "atomic_path",
    "estimate_noise_std",
    "height_field_mesh",
    "read_heights",
    "read_image",
    "write_heights",
    "write_image",
    "write_mesh",
]
