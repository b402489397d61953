"""Pictures to files and back."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from . import _ssplat
from ._info import Info
from ._input import content, exif_of, real, source, whole
from .errors import PartialWarning, QualityWarning

if TYPE_CHECKING:
    import numpy as np

    from ._input import Data, ImageLike

#: Points by which a file may miss the quality that is asked for.
_CLOSE = 0.5
_KEEP: Any = type("_Keep", (), {"__repr__": lambda self: "KEEP"})()


def encode(
    image: ImageLike,
    *,
    ratio: float | None = None,
    bytes: int | None = None,
    psnr: float | None = None,
    primitives: int | None = None,
    quality: float | None = None,
    effort: int = 5,
    time: float | None = None,
    progress: Callable[[str, float], object] | None = None,
    seed: int = 0,
    threads: int | None = None,
    levels: int = 1,
    tiles: int | None = None,
    thumbnail: Literal["auto"] | int | None = "auto",
    detail: Literal["auto", "off"] | float = "auto",
    tune: Literal["psnr", "ssim", "iq"] | None = None,
    layout: Literal["coded", "planes", "packed"] = "coded",
    blend: Literal["normalized", "sum"] | None = None,
    needs: Literal["measured", "everything"] = "measured",
    backend: Literal["auto", "cpu", "gpu"] = "auto",
    metadata: Literal["needed", "all", "icc", "none"] = "needed",
    icc_profile: bytes | None = _KEEP,
    exif: bytes | None = _KEEP,
    keep_hidden: bool = False,
    start: Callable[[bytes], Callable[[], bytes]] | None = None,
    at_once: int = 4,
) -> bytes:
    """Encodes a picture and returns the bytes of a file. Equal arguments give equal bytes on any number of threads.

    Args:
        image: an array of uint8 or uint16 with shape (height, width) or (height, width, 1 to 4 channels: grey, grey and
            alpha, RGB, RGBA); a Pillow image; or a picture that Pillow can open: its path, its bytes or a file. The samples are copied
            once, so the array may change meanwhile. An array that is not contiguous or not in native byte order is
            copied once more. Other types are a ParameterError. Of a ``numpy.memmap`` with ``tiles`` only the parts at work
            are in memory.
        ratio: bytes of the samples with 8 bits each over bytes of the file. 50 when nothing else is asked for.
        bytes: largest size of the file.
        psnr: PSNR to reach, dB; the smallest file found that does. With ``time`` the best file so far, and a QualityWarning if it
            has less.
        primitives: number of Gaussians.
        quality: as eyes see it, 0 to 100: the SSIMULACRA2 score that the file shall have, within half a point; about 30, 50,
            70 and 90 for low, medium, high and very high quality. It takes up to six tries. A QualityWarning says where it
            is missed. At most one of these five.
        effort: 1 to 9.
        time: wall-clock budget, seconds; the best state reached by then is written.
        progress: called with a stage's name and the share of it that is done, 0 to 1, in this thread. It stops the
            encode by raising, or by returning False, which raises a CancelledError.
        seed: of everything random.
        threads: how many to use; None: one for each core.
        levels: 1 to 8 progressive levels; a file that is cut after one is a coarser picture.
        tiles: side of the tiles that the picture is fitted in, pixels: a multiple of 128. It bounds the memory of a large
            one. None: only pictures above 268 megapixels are, in tiles of 2048.
        thumbnail: the most bytes that a small version of the picture may take in the file. ``"auto"``: a hundredth of
            files of 100 000 bytes and more, at most 4000. None: there is none.
        detail: whether the file has a detail layer, a transform of what the Gaussians leave: ``auto``, where it pays; ``off``; or the
            share of the bytes that the Gaussians get, above 0 and below 1.
        tune: the measure to favour: PSNR, SSIM, or ``iq``, what eyes see. None: ``iq``, but ``psnr`` with ``psnr=``.
        layout: how the integers become bytes.
        blend: how primitives blend; None: normalized.
        needs: whether to look for what can be left out of the fit.
        backend: the device; only a build with the feature ``gpu`` has another than the CPU.
        metadata: what of the picture's own metadata the file carries: ``needed``, the ICC profile and the orientation;
            ``all`` of the EXIF block, with time and place; ``icc``; or ``none``. They count as the file's bytes.
        icc_profile: profile to carry whatever ``metadata`` says; None: none.
        exif: EXIF block to carry whatever ``metadata`` says, with or without ``Exif\\0\\0`` before it; None: none.
        keep_hidden: keep the colours of pixels of alpha 0. By default they are replaced by a continuation of the visible
            colours, which takes fewer bytes.
        start: has others work on the tiles. It is called in this thread with the bytes of a task, hands them to a worker who
            calls :func:`work_on_tile` on them, and returns a function that waits for the answer: with a pool of
            ``concurrent.futures``, ``lambda task: pool.submit(ssplat.work_on_tile, task).result``. The file is the same
            as without. What it raises stops the encode.
        at_once: how many tasks may be out, each with the pixels of a tile: enough to keep all workers busy.

    Raises:
        ParameterError: an argument is out of range, the size cannot hold the picture, or an answer to a task is none; then
            the text names the tile.
        CancelledError: ``progress`` returned False.
        KeyboardInterrupt: at once; the work ends at its next step.
    """
    array, *own = source("image", image)
    own_profile, own_exif = _ssplat.carried(metadata, *own)
    options = {
        "ratio": real("ratio", ratio),
        "bytes": whole("bytes", bytes),
        "psnr": real("psnr", psnr),
        "primitives": whole("primitives", primitives),
        "quality": real("quality", quality),
        "effort": whole("effort", effort),
        "time": real("time", time),
        "seed": whole("seed", seed),
        "threads": whole("threads", threads),
        "levels": whole("levels", levels),
        "tiles": whole("tiles", tiles),
        "thumbnail": thumbnail,
        "detail": detail,
        "tune": tune,
        "layout": layout,
        "blend": blend,
        "needs": needs,
        "backend": backend,
        "icc_profile": own_profile if icc_profile is _KEEP else icc_profile,
        "exif": own_exif if exif is _KEEP else exif_of(exif),
        "keep_hidden": keep_hidden,
    }
    data, found, reached = _ssplat.encode(array, options, progress, None if start is None else (start, at_once))
    if quality is not None and found is not None and abs(found - quality) > _CLOSE:
        warnings.warn(f"quality {quality} was not met: the file has {found:.1f}", QualityWarning, stacklevel=2)
    if psnr is not None and reached < psnr:
        warnings.warn(f"psnr {psnr} was not met: the file has {reached:.2f} dB", QualityWarning, stacklevel=2)
    return data


def work_on_tile(
    task: bytes, *, threads: int | None = None, progress: Callable[[str, float], object] | None = None
) -> bytes:
    """Works on a tile for an :func:`encode` elsewhere that gave ``start`` a task. Equal tasks have equal answers.

    Args:
        task: the bytes that ``start`` was called with. They hold all that is needed, the pixels too.
        threads: how many to use; None: one for each core.
        progress: as for :func:`encode`; the stage is ``tile``.

    Returns:
        The answer, for the encode.

    Raises:
        ParameterError: these bytes are no task, or one of another version of this package.
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
    """Decodes a file, or the part of it that is asked for; of a large file little more than that part is read.

    Args:
        data: the file as bytes, its path, or a file that is open. Other buffers are copied, since they may change.
        region: left, top, width and height of the part, pixels of the picture.
        size: width and height of the output, pixels. Larger ones sample the continuous picture, smaller ones are
            low-passed.
        partial: of a damaged file, draw what is intact and warn with a PartialWarning. Files in groups, those of large pictures or
            with several levels, and those with a detail layer have parts that stand alone.
        detail: draw the detail layer, if the file has one; False: the Gaussians alone.
        bits: bits of a sample; None: those of the source.
        threads: how many to use; None: as many as are worth it.
        limits: what the file may ask for, in place of the defaults: any of ``width``, ``height``, ``primitives``,
            ``tile_pairs``, ``work``, ``overlap``, ``alloc`` and ``metadata``, as the library's Limits have them.

    Returns:
        A new array of uint8 or uint16, (height, width) for grey, else (height, width, channels).

    Raises:
        FormatError: the file is broken.
        UnsupportedVersionError: it is newer than this package.
        LimitExceededError: it asks for too much.
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
    array, (primitives, groups, of_groups, tiles, of_tiles, damaged) = _ssplat.decode(content(data, limits), options)
    lost = [f"{groups} of {of_groups} groups with {primitives} primitives"] if groups else []
    lost += [f"{tiles} of {of_tiles} tiles of the detail layer"] if tiles else []
    if lost:
        warnings.warn(f"{' and '.join(lost)} are missing", PartialWarning, stacklevel=2)
    elif damaged:
        text = "the file is damaged or cut off, but the requested part of the picture is complete"
        warnings.warn(text, PartialWarning, stacklevel=2)
    return array


def info(data: Data, *, limits: Mapping[str, int] | None = None) -> Info:
    """What a file says about itself: all but the primitives.

    Args:
        data: the file.
        limits: what the file may ask for, as for :func:`decode`.

    Returns:
        ``width`` and ``height`` in pixels, ``channels`` (1 to 4), ``bits`` of a sample (8 or 16), ``bytes`` of the
        file, ``primitives``, ``layout``, ``blend``, ``levels`` (primitives in each), ``groups``, ``codebook`` (colours
        in it, or None), ``detail`` (None, or of the detail layer ``bytes``, ``bits`` and ``levels``, and ``tiles`` with levels of
        ``of_tiles``), ``steps`` (the indices of specification §4.1), ``parts`` (bytes of each part of the file),
        ``icc_profile``, ``exif`` and ``thumbnail`` (bytes, or None; the last is a file that :func:`decode` takes).

    Raises:
        FormatError, UnsupportedVersionError, LimitExceededError: as for :func:`decode`.
    """
    return _ssplat.info(content(data, limits), None if limits is None else dict(limits))
