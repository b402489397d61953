"""Conversion between files and arrays of Gaussians."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from . import _ssplat
from ._input import cicp_of, content, exif_of
from .errors import ParameterError

if TYPE_CHECKING:
    from ._info import Cicp
    from numpy.typing import ArrayLike

    from ._input import Data


def gaussians(data: Data, *, limits: Mapping[str, int] | None = None) -> dict[str, Any]:
    """Returns the n Gaussians of a file, and the parameters for rendering them. A detail layer is ignored.

    Let d be the vector from the mean of a Gaussian to a point, rotated by the negative of its rotation and divided by
    its scales. The weight of the Gaussian at that point is ``w = max(0, exp(-d·d / 2) - exp(-3.5² / 2))``. With the
    colours c and the background b, the value of the picture is ``(Σ w c + b / 128) / (Σ w + 1 / 128)`` for the blend
    ``normalized`` and ``b + Σ w c`` for the blend ``sum``.

    Args:
        data: the file.
        limits: limits for the file, as for :func:`ssplat.decode`.

    Python, Rust and JavaScript have the values of a Gaussian in the same order and units: mean, scale, rotation, color.

    Returns:
        ``mean``: float32, (n, 2): x and y in pixels; the centre of the first pixel is (0.5, 0.5).
        ``scale``: float32, (n, 2): standard deviations along the major and the minor axis, pixels.
        ``rotation``: float32, (n,): direction of the major axis, radians, from x towards y.
        ``color``: float32, (n, channels): encoded sRGB values; 0 is black and 1 is white, but values can lie outside
            this range.
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
    cicp: Cicp | None = None,
    icc_profile: bytes | None = None,
    exif: bytes | None = None,
) -> bytes:
    """Stores Gaussians of any origin. Rounds each to the nearest values that a file can store, and returns the file.

    The arrays and their units are those of :func:`gaussians`; arrays that are not contiguous float32 are copied and
    converted. The two scales may be in either order, and are clamped to at least 0.25 pixels. No Gaussian is
    omitted or fitted again; only the precision of the rounding is chosen.

    Args:
        mean, scale, rotation, color: (n, 2), (n, 2), (n,) and (n, channels).
        width, height: of the picture, pixels. Every mean must lie within.
        background: (channels,); by default 0.
        blend: how the Gaussians blend; see :func:`gaussians`.
        bytes: maximum size of the file. The finest of ten sets of steps that fits is used.
        ratio: the maximum size, as width × height × channels divided by the size. Without ``bytes`` and ``ratio``, the
            steps are those of the encoder's best pictures, whatever the size.
        bits: bits per sample of the decoded picture.
        layout: encoding of the integers.
        steps: indices of specification §4.1 as returned by :func:`ssplat.info`; by default they are chosen.
        cicp, icc_profile, exif: metadata to store; see :func:`encode`.

    Raises:
        ParameterError: the shapes do not match, the format cannot store a value, or the size is too small.
    """
    color = np.ascontiguousarray(color, dtype=np.float32)
    channels = color.shape[1] if color.ndim == 2 else 0
    if ratio is not None:
        if bytes is not None or not ratio > 0:
            raise ParameterError(
                f"bad parameter ratio: {ratio} is not positive, or bytes is given as well", "ratio"
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
        "cicp": cicp_of(cicp),
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
        raise ParameterError(f"bad parameter {name}: shape {array.shape} does not have {dimensions} dimensions", name)
    return array


def _background(background: ArrayLike | None, channels: int) -> Sequence[float]:
    if background is None:
        return [0.0] * channels
    return np.asarray(background, dtype=np.float32).ravel().tolist()
