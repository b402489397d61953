"""The type of what :func:`ssplat.info` returns."""

from __future__ import annotations

import builtins
from typing import Literal, TypedDict

__all__ = ["DetailInfo", "Info", "StepsInfo"]


class DetailInfo(TypedDict):
    """A detail layer: its bytes and bits in the file, its levels, and how many of its tiles have some."""

    bytes: int
    bits: float
    levels: int
    tiles: int
    of_tiles: int


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
    """A file, all but its primitives; :func:`ssplat.info` says what each is."""

    width: int
    height: int
    channels: int
    bits: int
    bytes: int
    primitives: int
    layout: Literal["coded", "packed", "planes"]
    blend: Literal["normalized", "sum"]
    levels: list[int]
    groups: int
    codebook: int | None
    detail: DetailInfo | None
    steps: StepsInfo
    parts: dict[str, int]
    icc_profile: builtins.bytes | None
    exif: builtins.bytes | None
    thumbnail: builtins.bytes | None
