"""How far two pictures are apart, as the library and its reports measure it.

Pictures are what :func:`ssplat.encode` takes. Both must have one shape and one depth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from . import _ssplat
from ._input import pixels

if TYPE_CHECKING:
    from ._input import ImageLike

__all__ = ["ms_ssim", "psnr", "ssim", "ssimulacra2"]


def psnr(a: ImageLike, b: ImageLike, *, threads: int | None = None) -> float:
    """Peak signal-to-noise ratio over all samples, dB; infinite when they are equal."""
    return _ssplat.psnr(pixels("a", a)[0], pixels("b", b)[0], threads)


def ssim(a: ImageLike, b: ImageLike, *, threads: int | None = None) -> float | None:
    """Structural similarity, at most 1, the mean over the channels; None when a side is under 11 pixels."""
    return _ssplat.compare(pixels("a", a)[0], pixels("b", b)[0], threads)[1]


def ms_ssim(a: ImageLike, b: ImageLike, *, threads: int | None = None) -> float | None:
    """Multi-scale structural similarity, 0 to 1; None when a side is under 161 pixels."""
    return _ssplat.compare(pixels("a", a)[0], pixels("b", b)[0], threads)[2]


def ssimulacra2(a: ImageLike, b: ImageLike, *, threads: int | None = None) -> float | None:
    """SSIMULACRA2, at most 100: about 90, 70, 50 and 30 for very high, high, medium and low quality, below 0 for worse; None
    when a side is under 8 pixels."""
    return _ssplat.ssimulacra2(pixels("a", a)[0], pixels("b", b)[0], threads)
