"""The updater's data set with simulated images denoised by a network."""

import torch

from data_gen.dataset_config import DatasetConfig
from data_gen.sampler import Sampler
from data_gen.samples import make_sampler
from nets.weights import load_weights
from warp_caustics.errors import MismatchError


def denoised_sampler(config: DatasetConfig, device: str, weights: str) -> Sampler:
    """The updater's sampler with a denoiser from a file; with ``weights`` filled in, a factory for the builder.

    Raises:
        MismatchError: other weights than the configuration names, or those of another scene or network.
    """
    loaded = load_weights(weights, scene=config.scene, map_location=device)
    if loaded.info.architecture.kind != "denoiser":
        raise MismatchError(f"weights {weights!r} are of a {loaded.info.architecture.kind}; give those of a denoiser")
    if loaded.info.content_hash != config.denoiser:
        raise MismatchError(
            f"weights {weights!r} have hash {loaded.info.content_hash[:12]}, the data set names "
            f"{str(config.denoiser)[:12]}; give the file that it was begun with"
        )

    def denoise(images: torch.Tensor) -> torch.Tensor:
        answer: torch.Tensor = loaded.module(images)
        return answer

    return make_sampler(config, device, denoise)
