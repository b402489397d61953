"""Encoding and decoding of pictures."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from . import _ssplat
from ._info import Cicp, Info
from ._input import cicp_of, content, exif_of, real, source, whole
from ._research import Research, research_options
from .errors import PartialWarning, QualityWarning

if TYPE_CHECKING:
    import numpy as np

    from ._input import Data, ImageLike

#: Points by which a file may miss the quality that is asked for.
_CLOSE = 0.5
#: Quality of a file for which no target is given.
_DEFAULT_QUALITY = 70.0
_KEEP: Any = type("_Keep", (), {"__repr__": lambda self: "KEEP"})()


def encode(
    image: ImageLike,
    *,
    ratio: float | None = None,
    bytes: int | None = None,
    psnr: float | None = None,
    gaussians: int | None = None,
    quality: float | None = None,
    lossless: bool = False,
    effort: int = 5,
    time: float | None = None,
    progress: Callable[[str, float], object] | None = None,
    threads: int | None = None,
    levels: int = 1,
    tiles: int | None = None,
    thumbnail: Literal["auto"] | int | None = "auto",
    detail: Literal["auto", "off"] | float = "auto",
    tune: Literal["psnr", "iq"] | None = None,
    backend: Literal["auto", "cpu", "gpu"] = "auto",
    metadata: Literal["needed", "all", "icc", "none"] = "needed",
    cicp: Cicp | None = _KEEP,
    icc_profile: bytes | None = _KEEP,
    exif: bytes | None = _KEEP,
    keep_hidden: bool = False,
    research: Research | Mapping[str, Any] | None = None,
) -> bytes:
    """Encodes a picture and returns the bytes of a file. Equal arguments give equal bytes on any number of threads.

    Args:
        image: an array of uint8 or uint16 with shape (height, width) or (height, width, 1 to 4 channels: grey, grey and
            alpha, RGB, RGBA); a Pillow image; or a picture that Pillow can open, as a path, bytes or an open file. The
            samples are copied once, so the array may change in the meantime. An array that is not contiguous or not in
            native byte order is copied once more. Other types raise a ParameterError. A ``numpy.memmap`` with ``tiles``
            is read in parts.
        ratio: bytes of the samples at 8 bits each, divided by bytes of the file.
        bytes: maximum size of the file.
        psnr: PSNR to reach, dB. The result is the smallest file found that reaches it. If ``time`` runs out first, the
            result is the best file so far, with a QualityWarning.
        gaussians: number of Gaussians.
        quality: perceptual quality to reach, 0 to 100: the SSIMULACRA2 score of the file, within half a point. Low,
            medium, high and very high quality are about 30, 50, 70 and 90. 70 if no target is given. Where the picture
            without loss takes no more bytes, it is stored without loss. A QualityWarning is issued if the score is not
            reached.
        lossless: the file decodes to the samples of the picture. Colours under alpha 0 become black unless
            ``keep_hidden`` is set. At most one of these six targets may be given.
        effort: 1 to 9.
        time: wall-clock budget, seconds. If it is too short for ``effort``, a lower effort is used. When it runs out, the
            best state so far is written.
        progress: callback that receives the name of a stage and the fraction of it that is done, 0 to 1. It is called
            in this thread. It stops the encode by raising an exception, or by returning False, which raises a
            CancelledError.
        threads: number of threads; None: one per core.
        levels: number of progressive levels, 1 to 8. A file that is truncated after a level is a coarser picture.
        tiles: side of the tiles in which the picture is fitted, pixels, a multiple of 128. Tiles bound the memory for
            large pictures. None: pictures above 33.5 megapixels are fitted in tiles of 2048 (with a GPU above 268),
            others as a whole.
        thumbnail: maximum size of the thumbnail in the file, bytes. ``"auto"``: a hundredth of the file, at most 4000,
            in files of at least 100 000 bytes. None: no thumbnail.
        detail: whether the file has a detail layer, the transform-coded residual of the Gaussians. ``auto``: if the
            file gains by it; ``off``: never; or the share of the bytes for the Gaussians, above 0 and below 1.
        tune: the measure to favour: ``psnr`` or ``iq`` (perceptual quality). None: ``iq``, or ``psnr`` if the
            target is ``psnr``.
        backend: the device. Only a build with the feature ``gpu`` supports devices other than the CPU.
        metadata: the metadata of the picture to store: ``needed``, the colours and the orientation; ``all``, also the
            rest of the EXIF block, including time and location; ``icc``, only the colours; or ``none``.
            Metadata counts towards the size of the file.
        cicp: code points of the colours to store, regardless of ``metadata``: primaries, transfer characteristics,
            matrix coefficients (0) and full range (1) by ITU-T H.273, such as (9, 16, 0, 1) for BT.2020 with PQ, which no
            profile can express; None: none. They take precedence over a profile. Samples are stored as they are. Pillow
            has no code points of PNG files, but ``info["cicp"]`` of a Pillow image is stored.
        icc_profile: profile to store, regardless of ``metadata``; None: none.
        exif: EXIF block to store, regardless of ``metadata``, with or without a leading ``Exif\\0\\0``; None: none.
        keep_hidden: keep the colours of pixels of alpha 0. By default they are replaced by a continuation of the
            visible colours, which takes fewer bytes.
        research: options for research, and for workers that share the tiles of one picture, as one mapping. It may have
            these keys:

            - ``seed``: seed of all random numbers, 0 by default.
            - ``layout``: encoding of the integers, ``coded`` (the default), ``planes`` or ``packed``.
            - ``blend``: how the Gaussians are blended, ``normalized`` (the default) or ``sum``.
            - ``needs``: ``measured`` (the default): the encoder measures which parts of the fit the picture needs;
              ``everything``: it keeps all of them.
            - ``start``: starts the work on a tile elsewhere. It is called in this thread with the bytes of a task. It
              passes them to a worker, which calls :func:`work_on_tile`, and returns a function that waits for the
              result. With a pool of ``concurrent.futures``, it is
              ``lambda task: pool.submit(ssplat.work_on_tile, task).result``. The file is the same as without ``start``.
              An exception stops the encode.
            - ``at_once``: maximum number of unfinished tasks, 4 by default. It should keep all workers busy. Each task
              holds the pixels of a tile.

    Raises:
        ParameterError: an argument is out of range, the size cannot hold the picture, or the result of a task is
            invalid; in this case, the message names the tile.
        CancelledError: ``progress`` returned False.
        KeyboardInterrupt: raised at once; the work in the background ends at its next step.
    """
    array, picture_cicp, picture_profile, picture_exif = source("image", image)
    own_cicp, own_profile, own_exif = _ssplat.carried(metadata, picture_cicp, picture_profile, picture_exif)
    if cicp is not _KEEP or icc_profile is not _KEEP:
        # Colours that are given replace all that the picture states.
        own_cicp, own_profile = None, None
    rare = research_options(research)
    options = {
        "ratio": real("ratio", ratio),
        "bytes": whole("bytes", bytes),
        "psnr": real("psnr", psnr),
        "gaussians": whole("gaussians", gaussians),
        "quality": real("quality", quality),
        "lossless": lossless,
        "effort": whole("effort", effort),
        "time": real("time", time),
        "seed": rare["seed"],
        "threads": whole("threads", threads),
        "levels": whole("levels", levels),
        "tiles": whole("tiles", tiles),
        "thumbnail": thumbnail,
        "detail": detail,
        "tune": tune,
        "layout": rare["layout"],
        "blend": rare["blend"],
        "needs": rare["needs"],
        "backend": backend,
        "cicp": own_cicp if cicp is _KEEP else cicp_of(cicp),
        "icc_profile": own_profile if icc_profile is _KEEP else icc_profile,
        "exif": own_exif if exif is _KEEP else exif_of(exif),
        "keep_hidden": keep_hidden,
    }
    workers = None if rare["start"] is None else (rare["start"], rare["at_once"])
    data, found, reached = _ssplat.encode(array, options, progress, workers)
    wanted = _DEFAULT_QUALITY if quality is None else quality
    if found is not None and found < wanted - _CLOSE:
        warnings.warn(f"quality {wanted:g} was not met: the file has {found:.1f}", QualityWarning, stacklevel=2)
    if psnr is not None and reached < psnr:
        warnings.warn(f"psnr {psnr} was not met: the file has {reached:.2f} dB", QualityWarning, stacklevel=2)
    return data


def work_on_tile(
    task: bytes, *, threads: int | None = None, progress: Callable[[str, float], object] | None = None
) -> bytes:
    """Processes a task that :func:`encode` passed to ``start`` in ``research``, possibly on another machine. Equal tasks
    have equal results.

    Args:
        task: the bytes with which ``start`` was called. They include the pixels.
        threads: number of threads; None: one per core.
        progress: as for :func:`encode`; the stage is ``tile``.

    Returns:
        The result, which the function returned by ``start`` must return.

    Raises:
        ParameterError: the bytes are not a task of this version of the package.
        CancelledError: ``progress`` returned False.
    """
    return _ssplat.work_on_tile(task, threads, progress)


def decode(
    data: Data,
    *,
    region: Sequence[int] | None = None,
    size: Sequence[int] | None = None,
    partial: bool = False,
    detail: bool = True,
    bits: Literal[8, 16] | None = None,
    threads: int | None = None,
    limits: Mapping[str, int] | None = None,
) -> np.ndarray:
    """Decodes a file, or a part of it. For a part of a large file, little more than that part is read.

    Args:
        data: the file as bytes, a path or an open file. Other buffers are copied, because they may change.
        region: left, top, width and height of the part, in pixels of the picture.
        size: width and height of the output, pixels. A larger output samples the continuous picture; a smaller one is
            low-pass filtered.
        partial: decode the intact parts of a damaged file and issue a PartialWarning. Files in groups (large pictures
            and several levels) and files with a detail layer have parts that can be decoded independently.
        detail: render all layers of the file; False: only the Gaussians.
        bits: bits per sample; None: those of the source.
        threads: number of threads; None: as many as are useful.
        limits: limits for the file that replace the defaults: any of ``width``, ``height``, ``gaussians``,
            ``tile_pairs``, ``work``, ``overlap``, ``alloc`` and ``metadata``, which
            ``Limits`` of the Rust library documents.

    Returns:
        A new array of uint8 or uint16 with shape (height, width) for grey, otherwise (height, width, channels).

    Raises:
        TruncatedError: the file is cut off; a FormatError.
        FormatError: the file is broken.
        UnsupportedVersionError: this package does not support the version of the file.
        LimitExceededError: the file exceeds the limits.
        ParameterError: an argument is out of range.
    """
    options = {
        "region": None if region is None else list(region),
        "size": None if size is None else list(size),
        "bits": bits,
        "partial": bool(partial),
        "detail": bool(detail),
        "threads": threads,
        "limits": None if limits is None else dict(limits),
    }
    array, (gaussians, groups, of_groups, *layers, damaged) = _ssplat.decode(content(data, limits), options)
    lost = [f"{groups} of {of_groups} groups with {gaussians} Gaussians"] if groups else []
    for layer, (tiles, of_tiles) in zip(("detail", "exact"), layers, strict=True):
        lost += [f"{tiles} of {of_tiles} tiles of the {layer} layer"] if tiles else []
    if lost:
        warnings.warn(f"{' and '.join(lost)} are missing", PartialWarning, stacklevel=2)
    elif damaged:
        text = "the file is damaged or cut off, but the requested part of the picture is complete"
        warnings.warn(text, PartialWarning, stacklevel=2)
    return array


def info(data: Data, *, limits: Mapping[str, int] | None = None) -> Info:
    """Returns the properties of a file without decoding its picture.

    Args:
        data: the file.
        limits: limits for the file, as for :func:`decode`.

    Returns:
        ``width`` and ``height`` in pixels, ``channels`` (1 to 4), ``bits`` of a sample (8 or 16), ``bytes`` of the
        file, ``gaussians``, ``layout``, ``blend``, ``levels`` (Gaussians in each), ``groups``, ``codebook`` (colours
        in it, or None), ``detail`` (None, or a dict of the detail layer's ``bytes``, ``bits`` and ``levels``, and of
        the number of ``tiles`` that have levels, out of ``of_tiles``), ``exact`` (None, or a dict of the exact layer's
        ``bytes``, ``covered_pixels`` and ``tile_side``), ``steps`` (the indices of specification §4.1), ``parts``
        (bytes of each part of the file), ``cicp`` (code points as four numbers, or None), ``icc_profile``, ``exif`` and
        ``thumbnail`` (bytes, or None; the last is a
        file that :func:`decode` takes).

    Raises:
        FormatError, UnsupportedVersionError, LimitExceededError: as for :func:`decode`.
    """
    return _ssplat.info(content(data, limits), None if limits is None else dict(limits))
