"""A file that is read once and decoded many times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from . import _ssplat
from ._codec import decode, info
from ._input import content
from ._gaussians import gaussians

if TYPE_CHECKING:
    import numpy as np

    from ._info import Cicp, Info
    from ._input import Data

__all__ = ["Reader"]


class Reader:
    """A file in memory, from which many parts are decoded, as viewers of large pictures and data loaders do.

        reader = ssplat.Reader("map.ssplat")
        tile = reader.decode(region=(512, 0, 256, 256))

    The file is read when the reader is made, and only its header and metadata are parsed. Each part is decoded from its
    own bytes, as by :func:`ssplat.decode`. A reader may be used by several threads at a time, and pickled.

    Attributes:
        width, height: of the picture, pixels.
        channels: 1 grey, 2 grey and alpha, 3 RGB, 4 RGB and alpha.
        bits: bits per sample, 8 or 16.
        cicp: code points of the colours as four numbers, or None; they take precedence over the profile.
        icc_profile, exif: metadata of the file as bytes, or None.
    """

    width: int
    height: int
    channels: int
    bits: int
    cicp: Cicp | None
    icc_profile: bytes | None
    exif: bytes | None

    def __init__(self, data: Data, *, limits: Mapping[str, int] | None = None) -> None:
        """Reads a file.

        Args:
            data: the file as bytes, a path or an open file. Other buffers are copied.
            limits: limits for the file that replace the defaults; see :func:`ssplat.decode`.

        Raises:
            FormatError: the header or the metadata are broken.
            LimitExceededError: the file exceeds the limits.
        """
        self._limits = None if limits is None else dict(limits)
        self._data = content(data, limits)
        self.width, self.height, self.channels, self.bits, has_metadata = _ssplat.header(self._data)
        found = _ssplat.metadata(self._data, self._limits) if has_metadata else (None, None, None)
        self.cicp, self.icc_profile, self.exif = found

    def __repr__(self) -> str:
        return f"<ssplat.Reader of {self.width} x {self.height} pixels, {self.channels} channels, {self.bits} bits>"

    def decode(
        self,
        region: Sequence[int] | None = None,
        *,
        size: Sequence[int] | None = None,
        partial: bool = False,
        detail: bool = True,
        bits: Literal[8, 16] | None = None,
        threads: int | None = None,
    ) -> np.ndarray:
        """Decodes the picture or a part of it, with the arguments, result and errors of :func:`ssplat.decode`."""
        return decode(
            self._data,
            region=region,
            size=size,
            partial=partial,
            detail=detail,
            bits=bits,
            threads=threads,
            limits=self._limits,
        )

    def info(self) -> Info:
        """Returns the properties of the file, as :func:`ssplat.info` does."""
        return info(self._data, limits=self._limits)

    def gaussians(self) -> dict[str, Any]:
        """Returns the Gaussians of the file, as :func:`ssplat.gaussians` does."""
        return gaussians(self._data, limits=self._limits)
