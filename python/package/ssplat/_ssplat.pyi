"""The compiled module, for which the package ``ssplat`` is a wrapper."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._info import Cicp, Info

__all__ = [
    "FORMAT_VERSION",
    "MAGIC",
    "__version__",
    "carried",
    "compare",
    "decode",
    "encode",
    "from_gaussians",
    "gaussians",
    "header",
    "info",
    "metadata",
    "psnr",
    "ssimulacra2",
    "work_on_tile",
]

__version__: str
FORMAT_VERSION: int
MAGIC: bytes

def encode(
    image: np.ndarray,
    options: Mapping[str, Any],
    progress: Callable[[str, float], object] | None,
    workers: tuple[Callable[[bytes], Callable[[], bytes]], int] | None,
) -> tuple[bytes, float | None, float]: ...
def carried(
    which: str, cicp: Cicp | None, icc: bytes | None, exif: bytes | None
) -> tuple[Cicp | None, bytes | None, bytes | None]: ...
def work_on_tile(task: bytes, threads: int | None, progress: Callable[[str, float], object] | None) -> bytes: ...
def decode(
    data: bytes, options: Mapping[str, Any]
) -> tuple[np.ndarray, tuple[int, int, int, list[int], list[int], bool]]: ...
def header(data: bytes) -> tuple[int, int, int, int, bool]: ...
def info(data: bytes, limits: Mapping[str, int] | None = None) -> Info: ...
def metadata(data: bytes, limits: Mapping[str, int] | None = None) -> tuple[Cicp | None, bytes | None, bytes | None]: ...
def gaussians(data: bytes, limits: Mapping[str, int] | None = None) -> dict[str, Any]: ...
def from_gaussians(
    mean: NDArray[np.float32],
    scale: NDArray[np.float32],
    rotation: NDArray[np.float32],
    color: NDArray[np.float32],
    options: Mapping[str, Any],
) -> bytes: ...
def compare(a: np.ndarray, b: np.ndarray, threads: int | None) -> tuple[float, float | None, float | None]: ...
def psnr(a: np.ndarray, b: np.ndarray, threads: int | None) -> float: ...
def ssimulacra2(a: np.ndarray, b: np.ndarray, threads: int | None) -> float: ...
