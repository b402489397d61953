"""Plugin for Pillow: after ``import ssplat``, ``Image.open`` and ``Image.save`` support .ssplat.

``Image.open`` reads the header, and the ICC profile and EXIF block if there are any; the picture is decoded when its
pixels are accessed. ``draft`` and ``thumbnail`` render at the smaller size, which is faster. ``save`` accepts the
options of :func:`ssplat.encode`. The modes are L, LA, RGB, RGBA and I;16. Other pictures with 16 bits are opened with
8, because Pillow has no mode for them. With ``ImageFile.LOAD_TRUNCATED_IMAGES``, the intact parts of a damaged file
are shown.
"""

from __future__ import annotations

import inspect
import math
from typing import IO, Any, Literal

import numpy as np
from PIL import Image, ImageFile

from . import _ssplat
from ._codec import decode, encode
from ._input import MODES
from .errors import Error, FormatError, ParameterError

__all__ = ["SsplatImageFile", "register"]

_FORMAT = "SSPLAT"
#: What the header takes at most.
_HEADER = 32
_OPTIONS = frozenset(inspect.signature(encode).parameters) - {"image", "cicp", "icc_profile", "exif"}


class SsplatImageFile(ImageFile.ImageFile):
    """An opened file, of which only the header has been read."""

    format = _FORMAT
    format_description = "Pictures stored as 2D Gaussians"

    def _open(self) -> None:
        assert self.fp is not None
        head = self.fp.read(_HEADER)
        try:
            width, height, channels, bits, has_metadata = _ssplat.header(head)
        except FormatError as e:
            # Pillow interprets this exception as "another format".
            raise SyntaxError(str(e)) from e
        except Error as e:
            raise OSError(str(e)) from e
        self._size = (width, height)
        self._mode = "I;16" if (channels, bits) == (1, 16) else MODES[channels - 1]
        self.tile = [ImageFile._Tile("ssplat", (0, 0, width, height), 0, (self._mode, self._size))]
        if has_metadata:
            # The picture may be too large to be had, and its metadata still of use.
            self._describe(head + self.fp.read())

    def _describe(self, data: bytes) -> None:
        try:
            cicp, profile, exif = _ssplat.metadata(data)
        except Error:
            # Loading says what is wrong.
            return
        if cicp:
            self.info["cicp"] = cicp
        if profile:
            self.info["icc_profile"] = profile
        if exif:
            self.info["exif"] = b"Exif\0\0" + exif

    def verify(self) -> None:
        """Reads and checks the whole file without rendering the picture. Raises an OSError if the file is invalid."""
        if self.fp is None:
            raise RuntimeError("verify must be called directly after open")
        self.fp.seek(0)
        try:
            _ssplat.info(self.fp.read())
        except Error as e:
            raise OSError(str(e)) from e
        finally:
            super().verify()

    def draft(self, mode: str | None, size: tuple[int, int] | None) -> tuple[str, tuple[int, int, float, float]] | None:
        """Sets the output to the smallest size with the same aspect ratio that is not smaller than ``size``."""
        if size is None or len(self.tile) != 1:
            return None
        scale = max(size[0] / self.width, size[1] / self.height)
        if not 0 < scale < 1:
            return None
        width, height = (min(side, math.ceil(side * scale)) for side in self.size)
        self._size = (width, height)
        self.tile = [ImageFile._Tile("ssplat", (0, 0, width, height), 0, (self._mode, self._size))]
        return self._mode, (0, 0, width, height)


class _Decoder(ImageFile.PyDecoder):
    """Decodes the whole file at once."""

    _pulls_fd = True

    def decode(self, buffer: Any) -> tuple[int, int]:
        mode, size = self.args
        bits: Literal[8, 16] = 16 if mode == "I;16" else 8
        assert self.fd is not None
        try:
            array = decode(self.fd.read(), size=size, bits=bits, partial=ImageFile.LOAD_TRUNCATED_IMAGES)
        except Error as e:
            # Pillow's word for `partial`.
            text = str(e).replace("partial=True", "ImageFile.LOAD_TRUNCATED_IMAGES = True")
            raise OSError(text) from e
        # I;16 is little-endian everywhere.
        self.set_as_raw(array.astype("<u2" if bits == 16 else np.uint8, copy=False).tobytes(), mode)
        return -1, 0


def _accept(prefix: bytes) -> bool:
    return prefix.startswith(_ssplat.MAGIC)


def _save(im: Image.Image, fp: IO[bytes], filename: str | bytes) -> None:
    wanted = im.encoderinfo
    options = {name: wanted[name] for name in _OPTIONS & wanted.keys()}
    # What is asked for, else what ``metadata`` says of the picture's own; an empty one is none.
    options |= {name: wanted[name] or None for name in ("cicp", "icc_profile", "exif") if name in wanted}
    try:
        fp.write(encode(im, **options))
    except ParameterError as e:
        if e.name == "image":
            raise OSError(f"cannot write mode {im.mode} as {_FORMAT}") from e
        raise


def register() -> None:
    """Registers the plugin with Pillow; ``import ssplat`` calls it."""
    Image.register_decoder("ssplat", _Decoder)
    Image.register_open(_FORMAT, SsplatImageFile, _accept)
    Image.register_save(_FORMAT, _save)
    Image.register_extension(_FORMAT, ".ssplat")
    Image.register_mime(_FORMAT, "image/x-ssplat")
