"""What a camera makes of brightness: uneven light, light that is not the plate's, filters and gains."""

import torch


def uneven_light(coefficients: torch.Tensor, height: int, width: int | None = None) -> torch.Tensor:
    """Light relative to even light, mean 1; shape [..., n_w, H, W].

    Args:
        coefficients: of x, y, x^2 less its mean, x y, y^2 less its mean, with x and y from -1 to 1 over the image;
            shape [..., n_w, 5].
        height: H.
        width: W; None is H.
    """

    def along(pixels: int) -> tuple[torch.Tensor, torch.Tensor]:
        place = (torch.arange(pixels, device=coefficients.device).to(coefficients.dtype) + 0.5) * (2 / pixels) - 1
        return place, place**2 - (place**2).mean()

    (y, square_y), (x, square_x) = along(height), along(height if width is None else width)
    one_y, one_x = torch.ones_like(y), torch.ones_like(x)
    rows = torch.stack((one_y, y, one_y, y, square_y))
    columns = torch.stack((x, one_x, square_x, x, one_x))
    return 1 + torch.einsum("...k,ky,kx->...yx", coefficients, rows, columns)


def mixed(images: torch.Tensor, mixing: torch.Tensor) -> torch.Tensor:
    """Camera channels [..., C, H, W] of wavelengths [..., n_w, H, W] by a matrix [..., C, n_w]."""
    return torch.einsum("...ij,...jyx->...iyx", mixing, images)
