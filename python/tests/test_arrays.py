"""Arrays of every shape, type and stride are accepted, or rejected with an error that names the argument."""

import numpy as np
import pytest
import ssplat
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from pictures import waves

SHAPES = st.tuples(st.integers(1, 24), st.integers(1, 24)).flatmap(
    lambda side: st.sampled_from([None, 1, 2, 3, 4]).map(lambda c: side if c is None else (*side, c))
)
PICTURES = st.sampled_from(["|u1", "<u2", ">u2"]).flatmap(lambda d: arrays.arrays(np.dtype(d), SHAPES))


@settings(max_examples=60, deadline=None)
@given(PICTURES)
def test_every_legal_array_is_encoded_and_comes_back_in_its_shape(picture):
    pixels = ssplat.decode(ssplat.encode(picture, effort=1, gaussians=3))
    assert pixels.dtype == picture.dtype.newbyteorder("=")
    assert pixels.shape == (picture.shape[:2] if picture.ndim == 2 or picture.shape[2] == 1 else picture.shape)


@settings(max_examples=100, deadline=None)
@given(
    st.sampled_from(["bool", "i1", "i2", "u4", "i8", "f2", "f4", "f8", "c8", "S1", "O", "datetime64[s]"]),
    st.sampled_from([(4, 5), (4, 5, 3)]),
)
def test_other_types_are_refused_by_name(dtype, shape):
    with pytest.raises(ssplat.ParameterError, match="image.*dtype") as caught:
        ssplat.encode(np.zeros(shape, dtype))
    assert caught.value.name == "image"


@settings(max_examples=100, deadline=None)
@given(
    arrays.array_shapes(min_dims=0, max_dims=5, min_side=0, max_side=6).filter(
        lambda s: not (len(s) in (2, 3) and all(s) and (len(s) == 2 or s[2] <= 4))
    )
)
def test_other_shapes_are_refused_by_name(shape):
    with pytest.raises(ssplat.ParameterError):
        ssplat.encode(np.zeros(shape, np.uint8))


@pytest.mark.parametrize("cut", [np.s_[::2, ::3], np.s_[::-1], np.s_[:, ::-1, ::-1], np.s_[5:20, 7:]])
def test_any_strides_are_the_picture_that_they_show(cut):
    view = waves(40, 50)[cut]
    assert not view.flags.c_contiguous
    assert ssplat.encode(view, effort=1, gaussians=9) == ssplat.encode(view.copy(), effort=1, gaussians=9)
    assert ssplat.encode(view.T[0].T, effort=1, gaussians=9) == ssplat.encode(
        view[..., 0].copy(), effort=1, gaussians=9
    )


def test_read_only_arrays_and_subclasses_are_taken():
    picture = waves(20, 30)
    want = ssplat.encode(picture, effort=1, gaussians=9)
    picture.flags.writeable = False
    assert ssplat.encode(picture, effort=1, gaussians=9) == want
    assert ssplat.encode(picture.view(np.ma.MaskedArray), effort=1, gaussians=9) == want


@pytest.mark.parametrize("image", [None, 7, b"bytes", [[1, 2], [3, 4]], memoryview(b"1234")])
def test_what_is_no_picture_is_refused(image):
    with pytest.raises(ssplat.ParameterError, match="image"):
        ssplat.encode(image)
