"""What can go wrong, by whose fault it is. All are subclasses of :class:`Error`."""

from __future__ import annotations

__all__ = [
    "CancelledError",
    "Error",
    "FormatError",
    "GpuError",
    "IoError",
    "LimitExceededError",
    "PartialWarning",
    "ParameterError",
    "QualityWarning",
    "UnsupportedVersionError",
]


class Error(Exception):
    """Everything that this package raises on its own. Raised as such only for a bug in it."""


class IoError(Error, OSError):
    """The world: the system refused something."""


class FormatError(Error, ValueError):
    """The file: it breaks the specification."""


class UnsupportedVersionError(Error, ValueError):
    """A newer file: its format version is not known.

    Attributes:
        found: the version that the file names.
    """

    def __init__(self, message: str, found: int = 0) -> None:
        super().__init__(message)
        self.found = found


class LimitExceededError(Error, ValueError):
    """Policy: the file may be sound but asks for more than the limits allow.

    Attributes:
        what: what was limited, as the ``limits`` of :func:`ssplat.decode` name it.
        requested: what the file asked for.
        allowed: what is allowed.
    """

    def __init__(self, message: str, what: str = "", requested: int = 0, allowed: int = 0) -> None:
        super().__init__(message)
        self.what, self.requested, self.allowed = what, requested, allowed


class ParameterError(Error, ValueError):
    """The caller: an argument is out of its documented range.

    Attributes:
        name: the argument.
    """

    def __init__(self, message: str, name: str = "") -> None:
        super().__init__(message)
        self.name = name


class CancelledError(Error):
    """The progress callback asked to stop."""


class GpuError(Error, RuntimeError):
    """The device: a GPU is missing, failed or is too small."""


class PartialWarning(UserWarning):
    """A damaged file was decoded in part, as the caller allowed."""


class QualityWarning(UserWarning):
    """A file misses the quality or the PSNR that was asked for: it cannot be reached, or was not within the time."""
