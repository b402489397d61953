"""How far two pictures are apart, as the library and its reports measure it.

Pictures are what :func:`ssplat.encode` takes. Both must have one shape and one depth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from . import _ssplat
from ._input import pixels

if TYPE_CHECKING:
    from ._input import ImageLike

__all__ = ["ms_ssim", "psnr", "ssim"]


def psnr(a: ImageLike, b: ImageLike, *, threads: int | None = None) -> float:
    """Peak signal-to-noise ratio over all samples, dB; infinite when they are equal."""
    return _ssplat.psnr(pixels("a", a)[0], pixels("b", b)[0], threads)


def ssim(a: ImageLike, b: ImageLike, *, threads: int | None = None) -> float | None:
    """Structural similarity, at most 1, the mean over the channels; None when a side is under 11 pixels."""
    return _ssplat.compare(pixels("a", a)[0], pixels("b", b)[0], threads)[1]


def ms_ssim(a: ImageLike, b: ImageLike, *, threads: int | None = None) -> float | None:
    """Multi-scale structural similarity, 0 to 1; None when a side is under 161 pixels."""
    return _ssplat.compare(pixels("a", a)[0], pixels("b", b)[0], threads)[2]
