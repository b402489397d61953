"""The conformance vectors of the specification, through Python."""

import re
import warnings

import numpy as np
import pytest
import ssplat
from pictures import VECTORS

FOLDERS = sorted(case.parent for case in VECTORS.glob("*/*/case.txt"))

KINDS = {
    "format": ssplat.FormatError,
    "unsupported": ssplat.UnsupportedVersionError,
    "limit": ssplat.LimitExceededError,
}


def case_of(folder):
    return dict(line.split(": ", 1) for line in (folder / "case.txt").read_text().splitlines())


def picture_of(folder):
    head, body = (folder / "picture.pam").read_bytes().split(b"ENDHDR\n", 1)
    width, height, channels, top = (
        int(re.search(rb"%s (\d+)" % k, head)[1]) for k in (b"WIDTH", b"HEIGHT", b"DEPTH", b"MAXVAL")
    )
    samples = np.frombuffer(body, ">u2" if top > 255 else "u1").reshape(height, width, channels)
    return samples[..., 0] if channels == 1 else samples


def test_there_are_vectors_of_every_kind():
    assert {folder.parent.name for folder in FOLDERS} >= {"valid", "reduced", "partial", "invalid", "limits"}


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda f: f"{f.parent.name}/{f.name}")
def test_a_vector_gives_its_picture_or_an_error(folder):
    case, data = case_of(folder), (folder / "file.ssplat").read_bytes()
    if case["expect"] == "error":
        with pytest.raises(KINDS[case["kind"]]):
            ssplat.decode(data)
        return
    size = [int(side) for side in case["size"].split(" ")] if "size" in case else None
    want, most = picture_of(folder), int(case["tolerance"])
    partial = "partial" in case
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ssplat.PartialWarning)
        check(ssplat.decode(data, size=size, partial=partial), want, most, size)
    if partial:
        with pytest.raises(ssplat.FormatError):
            ssplat.decode(data)
        return
    told = ssplat.info(data)
    assert size or (told["height"], told["width"]) == want.shape[:2]
    # The same Gaussians again: the conversion to floats loses only their order.
    again = ssplat.decode(ssplat.from_gaussians(**ssplat.gaussians(data)), size=size)
    if told["detail"] or told["exact"]:
        # The layers are not part of the Gaussians.
        want = ssplat.decode(data, size=size, detail=False)
    check(again, want, most, size)


def check(pixels, want, most, size):
    assert (pixels.shape, pixels.dtype.itemsize) == (want.shape, want.dtype.itemsize)
    off = abs(pixels.astype(float) - want)
    if size and want.shape[2:] in ((2,), (4,)):
        # In a reduced picture, colours have less weight where alpha is low.
        off[..., :-1] *= np.minimum(1, 16 * want[..., -1:] / np.iinfo(pixels.dtype).max)
    assert off.max() <= most
