"""Quality measures of a picture against a reference, as the library and its reports compute them.

Both pictures are of types that :func:`ssplat.encode` accepts, and have the same shape and depth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from . import _ssplat
from ._input import pixels

if TYPE_CHECKING:
    from ._input import ImageLike

__all__ = ["ms_ssim", "psnr", "ssim", "ssimulacra2"]


def psnr(a: ImageLike, b: ImageLike, *, threads: int | None = None) -> float:
    """Returns the peak signal-to-noise ratio over all samples in dB; infinity if the pictures are equal."""
    return _ssplat.psnr(pixels("a", a)[0], pixels("b", b)[0], threads)


def ssim(a: ImageLike, b: ImageLike, *, threads: int | None = None) -> float | None:
    """Returns the SSIM, at most 1, as a mean over the channels; None if a side has less than 11 pixels."""
    return _ssplat.compare(pixels("a", a)[0], pixels("b", b)[0], threads)[1]


def ms_ssim(a: ImageLike, b: ImageLike, *, threads: int | None = None) -> float | None:
    """Returns the multi-scale structural similarity (MS-SSIM), 0 to 1; None if a side has less than 161 pixels."""
    return _ssplat.compare(pixels("a", a)[0], pixels("b", b)[0], threads)[2]


def ssimulacra2(a: ImageLike, b: ImageLike, *, threads: int | None = None) -> float:
    """Returns the SSIMULACRA2 score, at most 100. Very high, high, medium and low quality are about 90, 70, 50 and 30;
    worse pictures are below 0. Pictures with a side below 64 pixels are mirrored before they are measured."""
    return _ssplat.ssimulacra2(pixels("a", a)[0], pixels("b", b)[0], threads)
