"""How good a denoiser is on ten fields of its own: prints a table, draws one of them.

They are those of a denoiser's data set in the role "test": other reliefs than the development fields.

PSNR against the image of 1.6e7 photons, with the light of a flat plate as peak, of the noisy image (1e6 photons), of
the network's answer, and of the best Gaussian and the best non-local means of scikit-image (their parameters are
chosen on the first two fields by the truth itself, which favours them).

    python -m benchmarks.denoiser WEIGHTS [--device cuda] [--picture FILE] [--fields 10] [--photons 1e6 16e6]
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from skimage.restoration import denoise_nl_means, estimate_sigma

from data_gen.dataset_config import DatasetConfig
from data_gen.samples import make_sampler
from data_gen.testset import fields_config
from nets.weights import load_weights

SIGMAS_PX = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8)
STRENGTHS = (0.4, 0.6, 0.8, 1.2, 1.8)


def psnr_db(image: np.ndarray, clean: np.ndarray, peak: float = 1.0) -> float:
    """10 log10 (peak^2 / mean square difference)."""
    return float(10 * np.log10(peak**2 / np.mean((image - clean) ** 2)))


def non_local_means(image: np.ndarray, strength: float) -> np.ndarray:
    """Non-local means with a strength relative to the image's estimated noise."""
    sigma = float(estimate_sigma(image))
    denoised: np.ndarray = denoise_nl_means(
        image, patch_size=5, patch_distance=9, h=strength * sigma, sigma=sigma, fast_mode=True
    )
    return denoised


def best(
    parameters: tuple[float, ...],
    method: Callable[[np.ndarray, float], np.ndarray],
    pairs: list[tuple[np.ndarray, np.ndarray]],
) -> float:
    """The parameter of the highest mean PSNR."""
    scores = [np.mean([psnr_db(method(noisy, p), clean) for noisy, clean in pairs]) for p in parameters]
    return parameters[int(np.argmax(scores))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--fields", type=int, default=10)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--photons", type=float, nargs=2, default=(1e6, 16e6), help="noisy and clean")
    arguments = parser.parse_args()
    loaded = load_weights(arguments.weights, map_location=arguments.device)
    photons = {
        name: {"preset": "paper", "n_photons": int(count)}
        for name, count in zip(("noisy", "clean"), arguments.photons, strict=True)
    }
    tree = fields_config(loaded.info.scene).model_dump() | {"kind": "denoiser", **photons}
    sampler = make_sampler(DatasetConfig.model_validate(tree), arguments.device)
    arrays = sampler.draw(range(arguments.fields)).arrays
    noisy, clean = (arrays[name].astype(np.float32) for name in ("noisy", "clean"))
    with torch.no_grad():
        answers = [
            loaded.module(torch.from_numpy(image[None]).to(arguments.device)).cpu().numpy()[0] for image in noisy
        ]
    pairs = [(noisy[k, c], clean[k, c]) for k in range(min(2, len(noisy))) for c in range(noisy.shape[1])]
    sigma = best(SIGMAS_PX, gaussian_filter, pairs)
    strength = best(STRENGTHS, non_local_means, pairs)
    others: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "noisy": lambda image: image,
        f"Gaussian, {sigma} px": lambda image: gaussian_filter(image, sigma),
        f"non-local means, {strength}": lambda image: non_local_means(image, strength),
    }
    wavelengths = [f"{1e9 * w:.0f} nm" for w in loaded.info.scene.wavelengths_m]
    print("{:<24}".format("PSNR [dB]") + "".join(f"{name:>9}" for name in wavelengths))
    results = {
        name: [[call(image[c]) for c in range(len(wavelengths))] for image in noisy] for name, call in others.items()
    }
    results["network"] = [list(answer) for answer in answers]
    for name, images in results.items():
        rows = [[psnr_db(images[k][c], clean[k, c]) for c in range(len(wavelengths))] for k in range(len(noisy))]
        print(f"{name:<24}" + "".join(f"{value:9.2f}" for value in np.mean(rows, axis=0)), flush=True)
    if arguments.picture:
        draw(arguments.picture, {**{n: i[0][1] for n, i in results.items()}, "1.6e7 photons": clean[0, 1]})


def draw(path: Path, images: dict[str, np.ndarray]) -> None:
    """A detail of each image side by side."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2.6 * len(images), 2.9), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    clean = images["1.6e7 photons"]
    size = max(32, len(clean) // 4)
    # The brightest part of the image is where the caustic is.
    bright = gaussian_filter(clean, size / 4)
    row, column = (
        int(np.clip(k - size // 2, 0, len(clean) - size)) for k in np.unravel_index(bright.argmax(), bright.shape)
    )
    for axes, (name, image) in zip(figure.subplots(1, len(images)), images.items(), strict=True):
        shown = image[row : row + size, column : column + size]
        axes.imshow(shown, cmap="gray", vmin=0, vmax=float(np.percentile(clean, 99.5)), origin="upper")
        axes.set_title(name, fontsize=9)
        axes.set_xticks([])
        axes.set_yticks([])
    figure.savefig(path)


if __name__ == "__main__":
    main()
