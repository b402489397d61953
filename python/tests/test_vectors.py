"""The conformance vectors of the specification, through Python."""

import re

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
    width, height, channels, top = (int(re.search(rb"%s (\d+)" % k, head)[1]) for k in (b"WIDTH", b"HEIGHT", b"DEPTH", b"MAXVAL"))
    samples = np.frombuffer(body, ">u2" if top > 255 else "u1").reshape(height, width, channels)
    return samples[..., 0] if channels == 1 else samples


def test_there_are_vectors_of_every_kind():
    assert {folder.parent.name for folder in FOLDERS} == {"valid", "invalid", "limits"}


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda f: f"{f.parent.name}/{f.name}")
def test_a_vector_gives_its_picture_or_an_error(folder):
    case, data = case_of(folder), (folder / "file.ssplat").read_bytes()
    if case["expect"] == "error":
        with pytest.raises(KINDS[case["kind"]]):
            ssplat.decode(data)
        return
    pixels, want = ssplat.decode(data), picture_of(folder)
    assert (pixels.shape, pixels.dtype.itemsize) == (want.shape, want.dtype.itemsize)
    most = int(case["tolerance"])
    assert abs(pixels.astype(int) - want.astype(int)).max() <= most
    told = ssplat.info(data)
    assert (told["height"], told["width"]) == want.shape[:2]
    # The same Gaussians again: the way through floats loses nothing but their order.
    again = ssplat.from_gaussians(**ssplat.gaussians(data))
    assert abs(ssplat.decode(again).astype(int) - want.astype(int)).max() <= most
