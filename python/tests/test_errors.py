"""Errors by kind, with the offending value."""

import pickle

import numpy as np
import pytest
import ssplat
from pictures import waves

PICTURE = waves(20, 30)
FILE = ssplat.encode(PICTURE, effort=1, gaussians=9)


def changed(position, value):
    data = bytearray(FILE)
    data[position] = value
    return bytes(data)


@pytest.mark.parametrize(
    ("kind", "also", "call"),
    [
        (ssplat.FormatError, ValueError, lambda: ssplat.decode(b"not a file")),
        (ssplat.FormatError, ValueError, lambda: ssplat.decode(b"")),
        (ssplat.FormatError, ValueError, lambda: ssplat.decode(FILE[:-1])),
        (ssplat.FormatError, ValueError, lambda: ssplat.info(changed(-1, FILE[-1] ^ 1))),
        (ssplat.FormatError, ValueError, lambda: ssplat.gaussians(FILE + b"more")),
        (ssplat.UnsupportedVersionError, ValueError, lambda: ssplat.decode(changed(4, 200))),
        (ssplat.LimitExceededError, ValueError, lambda: ssplat.decode(FILE, limits={"width": 10})),
        (ssplat.ParameterError, ValueError, lambda: ssplat.decode(FILE, region=(0, 0, 31, 1))),
        (ssplat.CancelledError, Exception, lambda: ssplat.encode(PICTURE, progress=lambda stage, done: False)),
        (FileNotFoundError, OSError, lambda: ssplat.decode("there is no such file")),
        (FileNotFoundError, OSError, lambda: ssplat.encode("there is no such file")),
    ],
)
def test_each_kind_has_its_class(kind, also, call):
    with pytest.raises(kind) as caught:
        call()
    assert isinstance(caught.value, also)
    assert str(caught.value)


@pytest.mark.parametrize("shape", [(1 << 21, 1 << 21), (1, (1 << 20) + 1, 3), (8, 0), (1 << 20, 1 << 20, 1 << 20), (1 << 30,), (2,) * 9])
def test_the_shape_of_a_picture_is_checked_before_it_is_copied(shape):
    # A single sample with strides of 0: a copy would take up to 10^18 bytes.
    with pytest.raises(ssplat.ParameterError) as caught:
        ssplat.encode(np.broadcast_to(np.uint8(7), shape), effort=1)
    assert caught.value.name == "image" and str(list(shape)) in str(caught.value)


def test_a_version_and_a_limit_tell_their_values():
    with pytest.raises(ssplat.UnsupportedVersionError) as caught:
        ssplat.decode(changed(4, 200))
    assert caught.value.found == 200
    with pytest.raises(ssplat.LimitExceededError) as caught:
        ssplat.decode(FILE, limits={"width": 10})
    assert (caught.value.what, caught.value.requested, caught.value.allowed) == ("width", 30, 10)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"effort": 0}, "effort"),
        ({"effort": 10}, "effort"),
        ({"effort": -1}, "effort"),
        ({"effort": 1 << 70}, "effort"),
        ({"ratio": 0}, "ratio"),
        ({"ratio": float("nan")}, "ratio"),
        ({"ratio": 50, "bytes": 100}, "ratio"),
        ({"ratio": 50, "quality": 70}, "ratio"),
        ({"quality": 101}, "quality"),
        ({"metadata": "some"}, "metadata"),
        ({"bytes": -1}, "bytes"),
        ({"bytes": 3}, "bytes"),
        ({"psnr": -3.0}, "psnr"),
        ({"gaussians": 1 << 40}, "gaussians"),
        ({"time": -1.0}, "time"),
        ({"time": float("inf")}, "time"),
        ({"research": {"seed": -1}}, "seed"),
        ({"research": {"seed": 1 << 64}}, "seed"),
        ({"threads": 0}, "threads"),
        ({"threads": 1 << 20}, "threads"),
        ({"levels": 9}, "levels"),
        ({"tiles": 100}, "tiles"),
        ({"thumbnail": 5}, "thumbnail"),
        ({"thumbnail": "large"}, "thumbnail"),
        ({"tune": "vmaf"}, "tune"),
        ({"research": {"layout": "zip"}}, "layout"),
        ({"research": {"blend": "multiply"}}, "blend"),
        ({"backend": "tpu"}, "backend"),
        ({"research": {"needs": "nothing"}}, "needs"),
        ({"research": {"sede": 1}}, "research"),
    ],
)
def test_an_option_out_of_range_is_named(options, name):
    with pytest.raises(ssplat.ParameterError) as caught:
        ssplat.encode(PICTURE, **options)
    assert caught.value.name == name


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"region": (0, 0, 0, 5)}, "region"),
        ({"region": (20, 0, 40, 5)}, "region"),
        ({"region": (0, -1, 5, 5)}, "region"),
        ({"size": (0, 5)}, "size"),
        ({"size": (5, 1 << 21)}, "size"),
        ({"bits": 10}, "bits"),
        ({"threads": 0}, "threads"),
        ({"limits": {"colour": 5}}, "limits"),
        ({"limits": {"alloc": -5}}, "limits"),
    ],
)
def test_an_option_of_decoding_out_of_range_is_named(options, name):
    with pytest.raises(ssplat.ParameterError) as caught:
        ssplat.decode(FILE, **options)
    assert caught.value.name == name


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"effort": "high"}, "effort: 'high' is not a whole number"),
        ({"effort": 1.5}, "effort: 1.5 is not a whole number"),
        ({"ratio": "50"}, "ratio: '50' is not a number"),
        ({"quality": b"70"}, "quality: b'70' is not a number"),
        ({"research": 5}, "research: 5 is not a mapping"),
        ({"research": {"seed": 1.5}}, "seed: 1.5 is not a whole number"),
        ({"research": {"layout": 3}}, "layout: 3 is not a name"),
    ],
)
def test_an_option_of_another_type_is_a_type_error_that_names_it(options, text):
    with pytest.raises(TypeError, match=f"^{text}$"):
        ssplat.encode(PICTURE, **options)


def test_every_error_survives_the_way_between_processes():
    errors = [
        ssplat.FormatError("a"),
        ssplat.IoError("b"),
        ssplat.UnsupportedVersionError("c", 9),
        ssplat.LimitExceededError("d", "width", 30, 10),
        ssplat.ParameterError("e", "ratio"),
        ssplat.CancelledError("f"),
        ssplat.GpuError("g"),
    ]
    for error in errors:
        again = pickle.loads(pickle.dumps(error))
        assert isinstance(again, ssplat.Error)
        assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))


def test_pictures_of_two_shapes_cannot_be_compared():
    with pytest.raises(ssplat.ParameterError, match="30×20 and 7×20"):
        ssplat.metrics.psnr(PICTURE, PICTURE[:, :7])
    with pytest.raises(ssplat.ParameterError):
        ssplat.metrics.ssim(PICTURE, PICTURE.astype(np.uint16))


def test_a_file_beyond_the_limit_is_not_read(tmp_path):
    path = tmp_path / "big.ssplat"
    with open(path, "wb") as file:
        file.write(FILE)
        file.truncate(12 << 30)
    for call in [ssplat.decode, ssplat.info]:
        with pytest.raises(ssplat.LimitExceededError) as caught:
            call(path)
        assert (caught.value.what, caught.value.requested) == ("alloc", 12 << 30)
    # A file of unknown length is read only up to the limit.
    class Endless:
        count = 0

        def read(self, size):
            self.count += size
            return b"\0" * size

    endless = Endless()
    with pytest.raises(ssplat.LimitExceededError):
        ssplat.decode(endless, limits={"alloc": 5 << 20})
    assert endless.count < 8 << 20
