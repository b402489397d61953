"""Pictures stored as 2D Gaussians: the .ssplat codec.

    import ssplat
    data = ssplat.encode("photo.png", quality=70)  # bytes of a file
    pixels = ssplat.decode(data)                   # numpy array

If Pillow is installed, ``Image.open("x.ssplat")`` and ``image.save("x.ssplat", quality=70)`` work once this module is
imported. All functions release the GIL, may be called from any thread, and work in forked and spawned processes. Errors
are subclasses of :class:`Error`; see :mod:`ssplat.errors`.
"""

from __future__ import annotations

from . import metrics
from ._codec import decode, encode, info, work_on_tile
from ._gaussians import from_gaussians, gaussians
from ._reader import Reader
from ._ssplat import FORMAT_VERSION, __version__
from .errors import (
    CancelledError,
    Error,
    FormatError,
    GpuError,
    IoError,
    LimitExceededError,
    ParameterError,
    PartialWarning,
    QualityWarning,
    TruncatedError,
    UnsupportedVersionError,
)

__all__ = [
    "FORMAT_VERSION",
    "CancelledError",
    "Error",
    "FormatError",
    "GpuError",
    "IoError",
    "LimitExceededError",
    "ParameterError",
    "PartialWarning",
    "QualityWarning",
    "Reader",
    "TruncatedError",
    "UnsupportedVersionError",
    "__version__",
    "decode",
    "encode",
    "from_gaussians",
    "gaussians",
    "info",
    "metrics",
    "work_on_tile",
]

try:
    from . import pillow as _pillow
except ModuleNotFoundError as _missing:
    # Pillow is optional; anything else that is missing is a fault.
    if (_missing.name or "").split(".")[0] != "PIL":
        raise
else:
    _pillow.register()
