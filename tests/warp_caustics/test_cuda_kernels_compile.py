"""What only a GPU runs is compiled for one, without one: Warp carries NVIDIA's compiler."""

import pytest
import warp as wp

from warp_caustics.kernels.effects import Effects
from warp_caustics.kernels.fused import fused_kernels, unpack_kernel
from warp_caustics.kernels.fused_adjoint import fused_adjoint_kernels
from warp_caustics.kernels.lattice_surface import lattice_adjoint_kernels
from warp_caustics.kernels.prefilter import prefilter_kernels
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.kernels.surface_adjoint import surface_adjoint_kernel
from warp_caustics.prints.fit_kernels import weigh_together

POINT = Effects(fresnel=True, lamp=True, tilt=False, point=True, second_hits=True)

KERNELS = {
    "packed": lambda: fused_kernels(wp.float32, "spline", True, 3, 1, True).splat_photons,
    "deferred blocks": lambda: fused_kernels(wp.float32, "gaussian", False, 3, 32, False).splat_deferred,
    "adjoint by wavelength": lambda: (
        fused_adjoint_kernels(wp.float32, "spline", True, 1, True, by_wavelength=True).splat_photons_adjoint
    ),
    "adjoint in order": lambda: (
        fused_adjoint_kernels(wp.float32, "gaussian", False, 32, False, POINT, True).splat_deferred_adjoint
    ),
    "packed image": lambda: unpack_kernel(wp.float32),
    "scattered photons": lambda: surface_adjoint_kernel(wp.float32, False),
    "lattice": lambda: lattice_adjoint_kernels(wp.float32).gather_along_y,
    "prefilter": lambda: prefilter_kernels(wp.float32).filter_columns,
    "fits of lines": lambda: weigh_together,
    "prefilter that tells": lambda: prefilter_kernels(wp.float32).filter_columns_there,
}


@pytest.mark.parametrize(
    ("name", "arch"), [*((name, 90) for name in KERNELS), ("packed", 75), ("scattered photons", 75)]
)
def test_kernel_is_compiled_for_a_gpu(name, arch, tmp_path):
    """Snippets of C++ that only a GPU sees hold no mistakes that a compiler finds; 90 adds 16 bytes at once."""
    start_warp()
    if wp.get_cuda_toolkit_version() is None:
        pytest.skip("Warp was built without CUDA")
    kernel = KERNELS[name]()
    wp.compile_aot_module(kernel.module, device=None, arch=arch, module_dir=tmp_path, use_ptx=True)
    (code,) = tmp_path.glob("*.ptx")
    assert f".target sm_{arch}".encode() in code.read_bytes()
    assert (b"red.global.add.v4.f32" in code.read_bytes()) == (arch == 90 and name in ("packed", "deferred blocks"))
