"""Types of the result of :func:`ssplat.info`."""

from __future__ import annotations

import builtins
from typing import Literal, TypeAlias, TypedDict

__all__ = ["DetailInfo", "ExactInfo", "Info", "StepsInfo"]


#: Code points of colours by ITU-T H.273: primaries, transfer characteristics, matrix coefficients, full range.
Cicp: TypeAlias = "tuple[int, int, int, int]"


class DetailInfo(TypedDict):
    """Bytes and bits of a detail layer, its levels, and the number of its tiles that have levels."""

    bytes: int
    bits: float
    levels: int
    tiles: int
    of_tiles: int


class ExactInfo(TypedDict):
    """Bytes of an exact layer, the number of pixels that it stores, and the side of its tiles in pixels."""

    bytes: int
    covered_pixels: int
    tile_side: int


class StepsInfo(TypedDict):
    """The step indices of specification §4.1."""

    scale: int
    angle: int
    position: int
    coarsest: int
    range: int
    luma: int
    chroma: int


class Info(TypedDict):
    """Properties of a file; :func:`ssplat.info` documents them."""

    width: int
    height: int
    channels: int
    bits: int
    bytes: int
    gaussians: int
    layout: Literal["coded", "packed", "planes"]
    blend: Literal["normalized", "sum"]
    levels: list[int]
    groups: int
    codebook: int | None
    detail: DetailInfo | None
    exact: ExactInfo | None
    steps: StepsInfo
    parts: dict[str, int]
    cicp: Cicp | None
    icc_profile: builtins.bytes | None
    exif: builtins.bytes | None
    thumbnail: builtins.bytes | None
