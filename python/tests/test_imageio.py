"""imageio reads and writes through the Pillow plugin."""

import numpy as np
import pytest
import ssplat
from pictures import waves

iio = pytest.importorskip("imageio.v3")


def test_imageio_reads_and_writes_files(tmp_path):
    path, picture = tmp_path / "x.ssplat", waves(40, 50)
    iio.imwrite(path, picture, ratio=20, effort=1)
    assert path.read_bytes() == ssplat.encode(picture, ratio=20, effort=1)
    assert (iio.imread(path) == ssplat.decode(path)).all()
    properties = iio.improps(path)
    assert (properties.shape, properties.dtype) == ((40, 50, 3), np.uint8)
    assert (iio.imread(path.read_bytes(), extension=".ssplat") == ssplat.decode(path)).all()
