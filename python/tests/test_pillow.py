"""Pillow's plugin."""

import io
import pickle

import numpy as np
import pytest
import ssplat
from pictures import KODIM05, waves
from PIL import Image, ImageFile, UnidentifiedImageError

PICTURE = Image.fromarray(waves(60, 80))


def saved(image, **options):
    out = io.BytesIO()
    image.save(out, "SSPLAT", **{"effort": 1} | options)
    return out.getvalue()


def opened(data):
    return Image.open(io.BytesIO(data))


FILE = saved(PICTURE)


def test_the_plugin_is_registered_by_the_import():
    assert Image.registered_extensions()[".ssplat"] == "SSPLAT"
    assert Image.MIME["SSPLAT"] == "image/x-ssplat"


@pytest.mark.parametrize(("mode", "channels"), [("L", None), ("LA", 2), ("RGB", 3), ("RGBA", 4)])
def test_every_mode_comes_back_with_its_pixels(mode, channels, tmp_path):
    path = tmp_path / "waves.ssplat"
    array = waves(60, 80, channels)
    Image.fromarray(array).save(path, ratio=20, effort=1)
    assert path.read_bytes() == ssplat.encode(array, ratio=20, effort=1)
    with Image.open(path) as image:
        assert (image.format, image.mode, image.size) == ("SSPLAT", mode, (80, 60))
        assert (np.asarray(image) == ssplat.decode(path)).all()


def test_grey_of_16_bits_is_i_16():
    deep = Image.fromarray(waves(60, 80, None, np.uint16))
    assert deep.mode == "I;16"
    data = saved(deep)
    image = opened(data)
    assert image.mode == "I;16"
    assert (np.asarray(image) == ssplat.decode(data)).all()
    assert ssplat.decode(data).dtype == np.uint16
    swapped = Image.frombytes("I;16B", deep.size, np.asarray(deep).astype(">u2").tobytes())
    assert saved(swapped) == data


def test_other_pictures_of_16_bits_are_drawn_with_8():
    data = ssplat.encode(waves(60, 80, 3, np.uint16), effort=1)
    image = opened(data)
    assert image.mode == "RGB"
    assert (np.asarray(image) == ssplat.decode(data, bits=8)).all()


@pytest.mark.parametrize(
    ("mode", "stored"), [("1", "L"), ("P", "RGB"), ("PA", "RGBA"), ("RGBX", "RGB"), ("RGBa", "RGBA"), ("La", "LA")]
)
def test_modes_that_no_file_holds_are_stored_as_what_they_show(mode, stored):
    source = PICTURE.convert("RGBA") if mode == "RGBa" else PICTURE.convert("LA") if mode == "La" else PICTURE
    image = source.convert("P").convert("PA") if mode == "PA" else source.convert(mode)
    assert saved(image) == saved(image.convert(stored))
    assert opened(saved(image)).mode == stored


def test_a_transparent_colour_becomes_alpha():
    image = PICTURE.convert("P")
    image.info["transparency"] = 3
    assert opened(saved(image)).mode == "RGBA"


@pytest.mark.parametrize("mode", ["CMYK", "F", "I", "LAB", "HSV", "YCbCr"])
def test_modes_without_a_place_are_refused_as_pillow_does(mode):
    with pytest.raises(OSError, match=f"cannot write mode {mode} as SSPLAT"):
        saved(Image.new(mode, (4, 4)))


def test_a_wrong_option_is_named_and_leaves_no_file(tmp_path):
    with pytest.raises(ssplat.ParameterError, match="effort"):
        PICTURE.save(tmp_path / "x.ssplat", effort=77)
    assert not (tmp_path / "x.ssplat").exists()


class Counted(io.BytesIO):
    """Counts the bytes that are read."""

    count = 0

    def read(self, size=-1):
        data = super().read(size)
        self.count += len(data)
        return data


def test_opening_reads_the_header_alone():
    file = Counted(FILE)
    image = Image.open(file)
    # Pillow itself reads the first 16 bytes.
    assert image.size == (80, 60) and file.count <= 16 + 32 < len(FILE)
    image.load()
    assert file.count >= len(FILE)


def test_metadata_are_there_before_the_pixels_and_go_back_into_files():
    exif = Image.Exif()
    exif[0x0112], exif[0x010E] = 6, "waves"
    image = opened(saved(PICTURE, icc_profile=b"profile", exif=exif))
    assert image.info["icc_profile"] == b"profile"
    assert (image.getexif()[0x0112], image.getexif()[0x010E]) == (6, "waves")
    again = opened(saved(image, metadata="all"))
    assert again.info == image.info
    jpeg = io.BytesIO()
    again.save(jpeg, "JPEG", exif=again.info["exif"])
    assert Image.open(jpeg).getexif()[0x010E] == "waves"
    assert "icc_profile" not in opened(saved(image, icc_profile=None)).info
    assert "exif" not in opened(saved(image, exif=b"")).info


def test_a_camera_s_notes_are_carried_only_when_they_are_asked_for():
    exif = Image.Exif()
    exif[0x0112], exif[0x010E] = 6, "notes" * 2000
    camera = PICTURE.copy()
    camera.info |= {"icc_profile": b"profile", "exif": exif.tobytes()}
    # A size that could not hold the notes.
    plain = opened(saved(camera, bytes=700))
    assert plain.info["icc_profile"] == b"profile"
    assert dict(plain.getexif()) == {0x0112: 6}
    assert opened(saved(camera, bytes=700, metadata="icc")).info == {"icc_profile": b"profile"}
    assert opened(saved(camera, bytes=700, metadata="none")).info == {}
    assert opened(saved(camera, metadata="all")).getexif()[0x010E] == "notes" * 2000
    with pytest.raises(ssplat.ParameterError, match="EXIF block"):
        saved(camera, bytes=700, metadata="all")


def test_metadata_are_there_though_the_picture_cannot_be_had():
    data = saved(PICTURE, exif=b"MM" + bytes(30), icc_profile=b"p")
    cut = opened(data[:-3])
    assert cut.info["icc_profile"] == b"p" and len(cut.info["exif"]) == 38


def test_verify_finds_what_is_broken():
    opened(FILE).verify()
    for broken in (FILE[:-1], FILE[:-1] + bytes([FILE[-1] ^ 1])):
        with pytest.raises(OSError, match="checksum|cut off"):
            opened(broken).verify()


def test_thumbnails_are_drawn_small():
    source = Image.open(KODIM05)
    data = saved(source, ratio=200)
    drafted = opened(data)
    assert drafted.draft(None, (100, 100)) == ("RGB", (0, 0, 150, 100))
    assert drafted.size == (150, 100)
    assert (np.asarray(drafted) == ssplat.decode(data, size=(150, 100))).all()
    small, whole = opened(data), opened(data)
    small.thumbnail((96, 96))
    whole.load()
    whole.thumbnail((96, 96))
    assert small.size == whole.size == (96, 64)
    # One is low-passed by the decoder, the other by Pillow.
    assert ssplat.metrics.psnr(small, whole) > 35


def test_a_draft_never_enlarges_nor_changes_what_is_loaded():
    image = opened(FILE)
    assert image.draft(None, (80, 60)) is None and image.draft(None, (500, 10)) is None
    assert image.draft("L", None) is None
    assert image.draft("RGB", (7, 7))[1] == (0, 0, 10, 7)
    image.load()
    assert image.draft(None, (3, 3)) is None
    assert image.size == (10, 7)


def test_pillows_own_bound_on_pixels_holds(monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 3000)
    with pytest.warns(Image.DecompressionBombWarning):
        opened(FILE)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 2000)
    with pytest.raises(Image.DecompressionBombError):
        opened(FILE)


def test_broken_files_are_os_errors():
    with pytest.raises(UnidentifiedImageError):
        opened(FILE[:7])
    with pytest.raises(OSError, match="version 99"):
        opened(FILE[:4] + b"\x63" + FILE[5:])
    with pytest.raises(OSError, match="checksum"):
        opened(FILE[:-1] + bytes([FILE[-1] ^ 1])).load()


def test_truncated_files_show_what_is_intact_when_pillow_is_told_so(monkeypatch):
    data = saved(Image.open(KODIM05), ratio=300, levels=2)
    cut = data[: len(data) * 2 // 3]
    with pytest.raises(OSError, match="cut off after .*; ImageFile.LOAD_TRUNCATED_IMAGES = True decodes"):
        opened(cut).load()
    monkeypatch.setattr(ImageFile, "LOAD_TRUNCATED_IMAGES", True)
    with pytest.warns(ssplat.PartialWarning):
        image = opened(cut)
        image.load()
    assert ssplat.metrics.psnr(image, opened(data)) > 15


def test_files_are_closed_after_loading(tmp_path):
    path = tmp_path / "x.ssplat"
    path.write_bytes(FILE)
    image = Image.open(path)
    image.load()
    assert image.fp is None
    assert image.crop((1, 2, 30, 40)).size == (29, 38)
    copy = pickle.loads(pickle.dumps(image))
    assert copy.tobytes() == image.tobytes()
