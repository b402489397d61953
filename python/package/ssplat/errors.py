"""Exceptions and warnings of this package. All exceptions are subclasses of :class:`Error`."""

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
    "TruncatedError",
    "UnsupportedVersionError",
]


class Error(Exception):
    """Base class of all exceptions of this package. It is raised directly only for a bug in the package."""


class IoError(Error, OSError):
    """The operating system reported an error."""


class FormatError(Error, ValueError):
    """The file breaks the specification."""


class TruncatedError(FormatError):
    """The file ends too early: it was cut off, or has not arrived completely.

    Attributes:
        bytes: the length of the data.
        of: the length of the whole file, or None if the data do not state it.
    """

    def __init__(self, message: str, bytes: int = 0, of: int | None = None) -> None:
        super().__init__(message)
        self.bytes, self.of = bytes, of


class UnsupportedVersionError(Error, ValueError):
    """The file has a format version that is not supported, for example a newer one.

    Attributes:
        found: the version stated in the file.
    """

    def __init__(self, message: str, found: int = 0) -> None:
        super().__init__(message)
        self.found = found


class LimitExceededError(Error, ValueError):
    """The file may be valid but exceeds the limits.

    Attributes:
        what: name of the limit, as in ``limits`` of :func:`ssplat.decode`.
        requested: amount that the file needs.
        allowed: amount that is allowed.
    """

    def __init__(self, message: str, what: str = "", requested: int = 0, allowed: int = 0) -> None:
        super().__init__(message)
        self.what, self.requested, self.allowed = what, requested, allowed


class ParameterError(Error, ValueError):
    """An argument is outside its documented range.

    Attributes:
        name: name of the argument.
    """

    def __init__(self, message: str, name: str = "") -> None:
        super().__init__(message)
        self.name = name


class CancelledError(Error):
    """The progress callback stopped the encode."""


class GpuError(Error, RuntimeError):
    """The GPU is missing, failed or has too little memory."""


class PartialWarning(UserWarning):
    """A damaged file was decoded partially, as requested."""


class QualityWarning(UserWarning):
    """The file does not have the requested quality or PSNR, because it is out of reach or the time ran out."""
