"""The Gaussians of a file as arrays, and arrays of anyone's Gaussians as a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from . import _ssplat
from ._input import content, exif_of
from .errors import ParameterError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ._input import Data


def gaussians(data: Data, *, limits: Mapping[str, int] | None = None) -> dict[str, Any]:
    """The Gaussians of a file, n of them, and what is needed to draw them. A detail layer is left out.

    With d the vector from a mean to a point, in the frame of the Gaussian (turned back by its rotation, divided by its
    scales), its weight there is ``w = max(0, exp(-d·d / 2) - exp(-3.5² / 2))``. A picture blends either ``normalized``,
    ``(Σ w c + b / 128) / (Σ w + 1 / 128)``, or as a ``sum``, ``b + Σ w c``, with the colours c and the background b.

    Args:
        data: the file.
        limits: what the file may ask for, as for :func:`ssplat.decode`.

    Returns:
        ``mean``: float32, (n, 2): x and y in pixels; the centre of the first pixel is (0.5, 0.5).
        ``scale``: float32, (n, 2): standard deviations along the major and the minor axis, pixels.
        ``rotation``: float32, (n,): direction of the major axis, radians, from x towards y.
        ``color``: float32, (n, channels): encoded sRGB values, 0 black and 1 white, not bounded to that.
        ``background``: float32, (channels,).
        ``width``, ``height``, ``bits``, ``blend``, ``layout`` and ``steps`` as in :func:`ssplat.info`.

        ``from_gaussians(**gaussians(data))`` stores the same Gaussians again.

    Raises:
        FormatError, UnsupportedVersionError, LimitExceededError: as for :func:`ssplat.decode`.
    """
    return _ssplat.gaussians(content(data), None if limits is None else dict(limits))


def from_gaussians(
    mean: ArrayLike,
    scale: ArrayLike,
    rotation: ArrayLike,
    color: ArrayLike,
    *,
    width: int,
    height: int,
    background: ArrayLike | None = None,
    blend: Literal["normalized", "sum"] = "normalized",
    bytes: int | None = None,
    ratio: float | None = None,
    bits: Literal[8, 16] = 8,
    layout: Literal["coded", "planes", "packed"] = "coded",
    steps: Mapping[str, int] | None = None,
    icc_profile: bytes | None = None,
    exif: bytes | None = None,
) -> bytes:
    """Stores Gaussians that were fitted elsewhere: rounds each to the nearest the file can hold and returns the file.

    The arrays and their units are those of :func:`gaussians`; anything but contiguous float32 is converted, by a copy.
    Scales may come in either order and are held to 0.25 pixels and above. No Gaussian is left out or fitted again: all
    that is chosen is how finely they are rounded.

    Args:
        mean, scale, rotation, color: (n, 2), (n, 2), (n,) and (n, channels).
        width, height: of the picture, pixels. Every mean must lie within.
        background: (channels,); by default 0.
        blend: how the Gaussians blend; see :func:`gaussians`.
        bytes: largest size of the file: it gets the finest of ten sets of steps that fit.
        ratio: the same as width × height × channels over the size. By default the steps are those of the encoder's best
            pictures, whatever the size.
        bits: of a sample of the decoded picture.
        layout: how the integers become bytes.
        steps: indices of specification §4.1 as :func:`ssplat.info` gives them, instead of chosen ones.
        icc_profile, exif: to carry.

    Raises:
        ParameterError: shapes do not agree, a value has no place in the format, or the size is too small.
    """
    color = np.ascontiguousarray(color, dtype=np.float32)
    channels = color.shape[1] if color.ndim == 2 else 0
    if ratio is not None:
        if bytes is not None or not ratio > 0:
            raise ParameterError(
                f"bad parameter ratio: {ratio} is not positive, or bytes are asked for as well", "ratio"
            )
        bytes = int(width * height * channels / ratio)
    options = {
        "width": width,
        "height": height,
        "bits": bits,
        "blend": blend,
        "layout": layout,
        "background": _background(background, channels),
        "bytes": bytes,
        "steps": None if steps is None else dict(steps),
        "icc_profile": icc_profile,
        "exif": exif_of(exif),
    }
    return _ssplat.from_gaussians(
        _array("mean", mean, 2),
        _array("scale", scale, 2),
        _array("rotation", rotation, 1),
        _array("color", color, 2),
        options,
    )


def _array(name: str, values: ArrayLike, dimensions: int) -> np.ndarray:
    array = np.ascontiguousarray(values, dtype=np.float32)
    if array.ndim != dimensions:
        raise ParameterError(f"bad parameter {name}: shape {array.shape} has not {dimensions} dimensions", name)
    return array


def _background(background: ArrayLike | None, channels: int) -> Sequence[float]:
    if background is None:
        return [0.0] * channels
    return np.asarray(background, dtype=np.float32).ravel().tolist()
