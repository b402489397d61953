"""Conversion of arguments: pictures to arrays, and files to bytes."""

from __future__ import annotations

import io
import operator
import os
import sys
from collections.abc import Mapping
from numbers import Real
from typing import TYPE_CHECKING, Any, BinaryIO, TypeAlias, TypeGuard, cast

import numpy as np

from .errors import LimitExceededError, ParameterError

if TYPE_CHECKING:
    from ._info import Cicp
    from PIL import Image

    ImageLike: TypeAlias = np.ndarray | Image.Image | str | os.PathLike[str] | bytes | bytearray | BinaryIO
    Data: TypeAlias = bytes | bytearray | memoryview | str | os.PathLike[str] | BinaryIO

#: Longest side of a picture, pixels.
MAX_SIDE = 1 << 20
#: Modes of Pillow that hold what a file holds.
MODES = ("L", "LA", "RGB", "RGBA", "I;16")
#: Modes of which the array is one that a file holds.
_ARRAYS = (*MODES, "I;16B", "I;16L")
#: What shows the same as a mode that no file holds, and as one with a transparent colour beside its samples.
_SAME = {"1": "L", "La": "LA", "RGBa": "RGBA", "RGBX": "RGB", "P": "RGB", "PA": "RGBA"}
_TRANSPARENT = {"1": "LA", "L": "LA", "RGB": "RGBA", "P": "RGBA"}


def whole(name: str, value: object) -> Any:
    """Converts a whole number or None. Raises a TypeError that names the argument for other values."""
    try:
        return None if value is None else operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        raise TypeError(f"{name}: {value!r} is not a whole number") from None


def real(name: str, value: object) -> Any:
    """Converts a number or None. Raises a TypeError that names the argument for other values."""
    if value is None or isinstance(value, Real):
        return value
    raise TypeError(f"{name}: {value!r} is not a number")


def is_path(value: object) -> TypeGuard[str | os.PathLike[str]]:
    return isinstance(value, (str, os.PathLike))


def is_pillow(value: object) -> TypeGuard[Image.Image]:
    # Does not import Pillow, which the caller may not use.
    return hasattr(value, "getbands") and hasattr(value, "mode")


def convert(image: Image.Image) -> Image.Image:
    """Converts the picture to an equivalent mode that a file can store. Raises a ParameterError if there is none."""
    if "transparency" in image.info and image.mode in _TRANSPARENT:
        return image.convert(_TRANSPARENT[image.mode])
    if image.mode in _ARRAYS:
        return image
    if image.mode in _SAME:
        return image.convert(_SAME[image.mode])
    text = f"bad parameter image: mode {image.mode} is not stored; convert it to one of {', '.join(MODES)}"
    raise ParameterError(text, "image")


def contiguous(name: str, array: Any) -> np.ndarray:
    """Returns the array itself if it is contiguous and in native byte order, otherwise a copy that is."""
    if not isinstance(array, np.ndarray):
        raise ParameterError(f"bad parameter {name}: {type(array).__name__} is not an array, a picture or a file", name)
    if array.dtype.kind != "u" or array.dtype.itemsize > 2:
        way = "; for values of 0 to 1: (255 * array.clip(0, 1)).round().astype(numpy.uint8)" if array.dtype.kind == "f" else ""
        raise ParameterError(f"bad parameter {name}: dtype {array.dtype} is neither uint8 nor uint16{way}", name)
    # Checked before the copy, because an array with strides of 0 can have any size.
    shape = list(array.shape)
    if len(shape) not in (2, 3) or len(shape) == 3 and not 1 <= shape[2] <= 4:
        text = f"shape {shape} is neither (height, width) nor (height, width, 1 to 4)"
        raise ParameterError(f"bad parameter {name}: {text}", name)
    for side in shape[:2]:
        if not 1 <= side <= MAX_SIDE:
            text = f"shape {shape}: a side of {side} is outside 1..={MAX_SIDE}"
            raise ParameterError(f"bad parameter {name}: {text}", name)
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("="))


def pixels(name: str, image: ImageLike) -> tuple[np.ndarray, Cicp | None, bytes | None, bytes | None]:
    """Returns the samples of a picture, its code points, its ICC profile and its EXIF block."""
    if isinstance(image, (bytes, bytearray)):
        image = io.BytesIO(image)
    if is_path(image) or hasattr(image, "read"):
        from PIL import Image, UnidentifiedImageError

        try:
            with Image.open(cast("str | BinaryIO", image)) as opened:
                return pixels(name, opened)
        except UnidentifiedImageError as e:
            raise ParameterError(f"bad parameter {name}: {e}", name) from None
    if is_pillow(image):
        return (
            contiguous(name, np.asarray(convert(image))),
            cicp_of(image.info.get("cicp")),
            image.info.get("icc_profile"),
            exif_of(image.info.get("exif")),
        )
    return contiguous(name, image), None, None, None


def source(name: str, image: ImageLike) -> tuple[np.ndarray, Cicp | None, bytes | None, bytes | None]:
    """Like :func:`pixels`, but a memory map is returned unchanged, and its parts are read when they are needed."""
    if isinstance(image, np.memmap) and image.dtype.isnative:
        return image, None, None, None
    return pixels(name, image)


def cicp_of(numbers: Any) -> Cicp | None:
    """Checks that code points are four numbers of 0 to 255, as a tuple or as bytes."""
    if numbers is None:
        return None
    try:
        primaries, transfer, matrix, full_range = bytes(tuple(numbers))
    except (TypeError, ValueError):
        raise ParameterError(f"bad parameter cicp: {numbers!r} are not four numbers of 0 to 255", "cicp") from None
    return primaries, transfer, matrix, full_range


def exif_of(block: Any) -> bytes | None:
    """Returns an EXIF block as it is stored in files: starting with its TIFF header."""
    if block is None:
        return None
    if hasattr(block, "tobytes") and not isinstance(block, memoryview):
        block = block.tobytes()
    return bytes(block).removeprefix(b"Exif\0\0") or None


def _at_most(file: BinaryIO, length: int, most: int) -> bytes:
    """Reads the rest of a file of ``length`` bytes, if known. Raises a LimitExceededError beyond ``most``."""
    pieces: list[bytes] = []
    held = 0
    while length <= most and (piece := file.read(_PIECE)):
        pieces.append(piece)
        held += len(piece)
        length = max(length, held)
    if length > most:
        text = f"limit exceeded: alloc {length} over the allowed {most}"
        raise LimitExceededError(text, "alloc", length, most)
    return b"".join(pieces)


#: Bytes that are read at a time.
_PIECE = 1 << 20
#: Most bytes of a file that are read where no limit is given, as the library's Limits have it.
_ALLOC = (1 if sys.maxsize < 2**32 else 4) << 30


def content(data: Data, limits: Mapping[str, int] | None = None) -> bytes:
    """Returns the bytes of a file: unchanged, copied from a mutable buffer, or read from a path or an open file within
    the limit ``alloc``."""
    if isinstance(data, bytes):
        return data
    most = whole("alloc", (limits or {}).get("alloc", _ALLOC))
    if is_path(data):
        with open(data, "rb") as file:
            return _at_most(file, os.fstat(file.fileno()).st_size, most)
    if isinstance(data, (bytearray, memoryview)):
        return bytes(data)
    if hasattr(data, "read"):
        return _at_most(cast("BinaryIO", data), 0, most)
    raise ParameterError(f"bad parameter data: {type(data).__name__} is not bytes, a path or a file", "data")
