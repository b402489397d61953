"""Encoding and decoding: the results have the requested properties."""

import io
import pickle
import warnings

import numpy as np
import pytest
import ssplat
from pictures import KODIM05, VECTORS, waves
from PIL import Image

PICTURE = waves(60, 80)
SMALL = {"effort": 1, "bytes": 500}
FILE = ssplat.encode(PICTURE, **SMALL)


@pytest.mark.parametrize("channels", [None, 1, 2, 3, 4])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_shape_and_depth_come_back(channels, dtype):
    picture = waves(33, 47, channels, dtype)
    pixels = ssplat.decode(ssplat.encode(picture, effort=1, gaussians=40))
    assert pixels.dtype == dtype
    assert pixels.shape == ((33, 47) if channels in (None, 1) else (33, 47, channels))
    assert pixels.flags.c_contiguous and pixels.flags.writeable
    assert ssplat.metrics.psnr(pixels, picture.reshape(pixels.shape)) > 20


def test_a_file_is_no_larger_than_asked_for():
    assert 400 < len(FILE) <= 500
    assert len(ssplat.encode(PICTURE, effort=1, ratio=20)) <= PICTURE.size / 20


def test_number_of_gaussians_is_the_one_asked_for():
    assert ssplat.info(ssplat.encode(PICTURE, effort=1, gaussians=30, research={"needs": "everything"}))["gaussians"] == 30


def test_psnr_is_reached():
    pixels = ssplat.decode(ssplat.encode(PICTURE, effort=1, psnr=28))
    assert ssplat.metrics.psnr(pixels, PICTURE) > 27.9


def test_a_psnr_that_is_missed_in_the_time_gives_a_file_and_a_warning():
    with pytest.warns(ssplat.QualityWarning, match="psnr 90.0 was not met: the file has"):
        data = ssplat.encode(PICTURE, effort=1, psnr=90.0, time=0.02)
    assert ssplat.metrics.psnr(ssplat.decode(data), PICTURE) > 10


def test_hidden_colors_take_no_bytes_unless_they_are_kept():
    black = np.dstack([PICTURE, np.full(PICTURE.shape[:2], 255, np.uint8)])
    black[:, :20] = 0
    noise = black.copy()
    noise[:, :20, :3] = np.random.default_rng(1).integers(0, 256, noise[:, :20, :3].shape)
    assert ssplat.encode(black, effort=1, bytes=500) == ssplat.encode(noise, effort=1, bytes=500)
    kept = [ssplat.encode(picture, effort=1, bytes=500, keep_hidden=True) for picture in (black, noise)]
    assert kept[0] != kept[1]


def test_bytes_do_not_depend_on_threads():
    assert ssplat.encode(PICTURE, **SMALL, threads=1) == ssplat.encode(PICTURE, **SMALL, threads=3) == FILE
    assert (ssplat.decode(FILE, threads=1) == ssplat.decode(FILE, threads=3)).all()


def test_seed_changes_the_file():
    assert ssplat.encode(PICTURE, **SMALL, research={"seed": 1}) != FILE


def test_arrays_pictures_and_paths_give_one_file(tmp_path):
    path = tmp_path / "waves.png"
    Image.fromarray(PICTURE).save(path)
    assert ssplat.encode(path, **SMALL) == ssplat.encode(str(path), **SMALL) == FILE
    assert ssplat.encode(Image.open(path), **SMALL) == FILE


def test_the_caller_may_change_the_array_meanwhile():
    picture = PICTURE.copy()

    def spoil(stage, done):
        picture[:] = 0

    assert ssplat.encode(picture, **SMALL, progress=spoil) == FILE
    assert not picture.any()


def test_files_are_read_from_bytes_buffers_and_paths(tmp_path):
    path = tmp_path / "waves.ssplat"
    path.write_bytes(FILE)
    want = ssplat.decode(FILE)
    for data in (bytearray(FILE), memoryview(FILE), path, str(path)):
        assert (ssplat.decode(data) == want).all()
        assert ssplat.info(data) == ssplat.info(FILE)


def test_a_region_is_that_part_of_the_whole():
    whole = ssplat.decode(FILE)
    assert (ssplat.decode(FILE, region=(13, 7, 40, 21)) == whole[7:28, 13:53]).all()


def test_half_the_size_is_the_mean_of_two_by_two_pixels():
    whole = ssplat.decode(FILE, bits=16).astype(float)
    half = ssplat.decode(FILE, size=(40, 30), bits=16)
    means = whole.reshape(30, 2, 40, 2, 3).mean((1, 3))
    # A code value of 8 bits, which the specification allows.
    assert abs(means - half).max() <= 257


def test_bits_of_a_sample_can_be_chosen():
    deep = ssplat.decode(FILE, bits=16)
    assert deep.dtype == np.uint16
    assert abs(deep / 257 - ssplat.decode(FILE)).max() <= 0.51


def test_metadata_are_carried_and_those_of_a_picture_by_default():
    image = Image.fromarray(PICTURE)
    image.info["icc_profile"] = b"a profile"
    exif = Image.Exif()
    exif[0x0112] = 6
    image.info["exif"] = exif.tobytes()
    kept = ssplat.info(ssplat.encode(image, effort=1))
    assert kept["icc_profile"] == b"a profile"
    assert b"Exif\0\0" + kept["exif"] == exif.tobytes()
    dropped = ssplat.info(ssplat.encode(image, effort=1, icc_profile=None, exif=None))
    assert dropped["icc_profile"] is None and dropped["exif"] is None
    assert ssplat.info(ssplat.encode(PICTURE, effort=1, icc_profile=b"other"))["icc_profile"] == b"other"


def test_code_points_pass_through():
    hdr = (9, 16, 0, 1)
    data = ssplat.encode(PICTURE, effort=1, cicp=hdr)
    assert ssplat.info(data)["cicp"] == hdr and ssplat.info(data)["icc_profile"] is None
    assert np.array_equal(ssplat.decode(data), ssplat.decode(ssplat.encode(PICTURE, effort=1)))
    assert ssplat.info(ssplat.encode(PICTURE, effort=1))["cicp"] is None
    assert ssplat.info(ssplat.encode(PICTURE, effort=1, cicp=bytes(hdr)))["cicp"] == hdr
    # From one file to another, through Pillow; a profile of the caller replaces them.
    image = Image.open(io.BytesIO(data))
    assert image.info["cicp"] == hdr
    assert ssplat.info(ssplat.encode(image, effort=1))["cicp"] == hdr
    assert ssplat.info(ssplat.encode(image, effort=1, metadata="none"))["cicp"] is None
    replaced = ssplat.info(ssplat.encode(image, effort=1, icc_profile=b"profile"))
    assert (replaced["cicp"], replaced["icc_profile"]) == (None, b"profile")
    for wrong in [(9, 16, 9, 1), (9, 16, 0, 2), (9, 16, 0), (9, 16, 0, 256), "PQ", 9]:
        with pytest.raises(ssplat.ParameterError, match="cicp"):
            ssplat.encode(PICTURE, effort=1, cicp=wrong)


def test_a_reader_decodes_as_the_functions_do(tmp_path):
    data = ssplat.encode(PICTURE, effort=1, cicp=(9, 18, 0, 1), icc_profile=b"p", exif=b"MM")
    path = tmp_path / "a.ssplat"
    path.write_bytes(data)
    reader = ssplat.Reader(path)
    path.unlink()
    assert (reader.width, reader.height, reader.channels, reader.bits) == (80, 60, 3, 8)
    assert (reader.cicp, reader.icc_profile, reader.exif) == ((9, 18, 0, 1), b"p", b"MM")
    assert np.array_equal(reader.decode(), ssplat.decode(data))
    for region, size in [((10, 5, 20, 30), None), ((0, 0, 80, 60), (40, 30))]:
        assert np.array_equal(reader.decode(region, size=size), ssplat.decode(data, region=region, size=size))
    assert reader.info() == ssplat.info(data) and reader.gaussians().keys() == ssplat.gaussians(data).keys()
    assert np.array_equal(pickle.loads(pickle.dumps(reader)).decode(bits=16), ssplat.decode(data, bits=16))
    assert "80 x 60" in repr(reader)
    with pytest.raises(ssplat.FormatError):
        ssplat.Reader(b"no file")
    with pytest.raises(ssplat.LimitExceededError):
        ssplat.Reader(data, limits={"alloc": 10}).decode()
    with pytest.raises(ssplat.TruncatedError):
        ssplat.Reader(data[:40]).decode()
    with pytest.raises(ssplat.TruncatedError, match=r"the file is empty \(0 bytes\), not an ssplat file"):
        ssplat.decode(b"")


def test_info_has_the_keys_that_its_type_names():
    from ssplat._info import DetailInfo, ExactInfo, Info, StepsInfo

    found = ssplat.info(FILE)
    assert set(found) == set(Info.__annotations__)
    assert set(found["steps"]) == set(StepsInfo.__annotations__)
    detailed = ssplat.info(ssplat.encode(waves(64, 64), bytes=3000, effort=1, detail=0.5))["detail"]
    assert detailed is not None and set(detailed) == set(DetailInfo.__annotations__)
    exact = ssplat.info(ssplat.encode(waves(64, 64), lossless=True))["exact"]
    assert exact is not None and set(exact) == set(ExactInfo.__annotations__)
    assert exact["covered_pixels"] == 64 * 64


def test_info_names_what_was_encoded():
    told = ssplat.info(FILE)
    assert (told["width"], told["height"], told["channels"], told["bits"]) == (80, 60, 3, 8)
    assert told["bytes"] == len(FILE) == sum(told["parts"].values())
    assert (told["layout"], told["blend"], sum(told["levels"])) == ("coded", "normalized", told["gaussians"])


def test_progress_tells_the_stages_up_to_their_end():
    seen = []
    ssplat.encode(PICTURE, **SMALL, progress=lambda stage, done: seen.append((stage, done)))
    assert {stage for stage, _ in seen} == {"fit", "finish"}
    assert all(0 <= done <= 1 for _, done in seen)
    assert max(done for stage, done in seen if stage == "fit") > 0.9


def test_a_damaged_file_is_drawn_in_part_when_asked_for():
    levels = ssplat.encode(KODIM05, effort=1, ratio=300, levels=2, detail="off")
    cut = levels[: len(levels) * 2 // 3]
    with pytest.raises(ssplat.TruncatedError, match=f"cut off after {len(cut)} of {len(levels)} bytes; partial=True decodes") as told:
        ssplat.decode(cut)
    assert (told.value.bytes, told.value.of) == (len(cut), len(levels))
    with pytest.warns(ssplat.PartialWarning, match="groups"):
        pixels = ssplat.decode(cut, partial=True)
    whole = ssplat.decode(levels)
    assert pixels.shape == whole.shape
    assert 15 < ssplat.metrics.psnr(pixels, whole) < 60


def test_a_wrong_checksum_is_told_where_nothing_is_missing():
    levels = ssplat.encode(PICTURE, effort=1, gaussians=60, levels=2)
    wrong = levels[:-1] + bytes([levels[-1] ^ 1])
    with pytest.raises(ssplat.FormatError):
        ssplat.decode(wrong)
    with pytest.warns(ssplat.PartialWarning, match="damaged or cut off, but the requested part"):
        pixels = ssplat.decode(wrong, partial=True)
    assert np.array_equal(pixels, ssplat.decode(levels))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ssplat.decode(levels, partial=True)


def test_a_layer_without_an_index_takes_no_memory():
    # 38 bytes that claim 2^24 tiles.
    data = bytes.fromhex("89535350068280804080804000946468014474616c089ed572870098ecf3bf40000021f704d4")
    with pytest.warns(ssplat.PartialWarning, match="16777216 of 16777216 tiles"):
        pixels = ssplat.decode(data, partial=True, region=(0, 0, 10, 10), limits={"alloc": 1 << 20})
    assert pixels.shape[:2] == (10, 10)


def test_missing_tiles_are_told_by_layer():
    data = bytearray((VECTORS / "valid/exact-both-layers/file.ssplat").read_bytes())
    data[-13] ^= 1
    with pytest.warns(ssplat.PartialWarning, match="^1 of 1 tiles of the exact layer are missing"):
        ssplat.decode(bytes(data), partial=True)
    data[-389] ^= 1
    both = "^1 of 1 tiles of the detail layer and 1 of 1 tiles of the exact layer are missing"
    with pytest.warns(ssplat.PartialWarning, match=both):
        ssplat.decode(bytes(data), partial=True)


def test_a_time_budget_gives_a_file():
    assert ssplat.decode(ssplat.encode(PICTURE, bytes=500, effort=9, time=0.2)).shape == PICTURE.shape


def test_every_tune_weighs_errors_in_its_own_way():
    # Noise in one half: the tunes differ by how much an error there counts.
    picture = np.full((40, 80, 3), 120, np.uint8)
    picture[:, 40:] += np.random.default_rng(1).integers(0, 100, (40, 40, 3), np.uint8)
    files = {ssplat.encode(picture, effort=1, bytes=400, tune=tune) for tune in ("psnr", "iq")}
    assert len(files) == 2


def test_every_layout_and_blend_holds_the_picture():
    for layout in ("coded", "planes", "packed"):
        for blend in ("normalized", "sum"):
            data = ssplat.encode(PICTURE, effort=1, bytes=900, research={"layout": layout, "blend": blend})
            told = ssplat.info(io.BytesIO(data).getvalue())
            assert (told["layout"], told["blend"]) == (layout, blend)
            assert ssplat.metrics.psnr(ssplat.decode(data), PICTURE) > 15


def test_a_thumbnail_is_a_file_of_its_own_within_the_size():
    data = ssplat.encode(KODIM05, effort=1, bytes=3000, thumbnail=500)
    small = ssplat.info(data)["thumbnail"]
    assert len(data) <= 3000 and len(small) <= 500
    assert ssplat.decode(small).shape == (171, 256, 3)
    assert ssplat.info(ssplat.encode(KODIM05, effort=1, bytes=3000))["thumbnail"] is None


def test_tiles_make_one_file_of_the_asked_size():
    data = ssplat.encode(KODIM05, effort=1, bytes=6000, tiles=256)
    assert len(data) <= 6000
    whole = ssplat.encode(KODIM05, effort=1, bytes=6000)
    # Tiles of a quarter of a megapixel and less lose some tenths of a decibel.
    loss = [ssplat.metrics.psnr(KODIM05, ssplat.decode(d)) for d in (whole, data)]
    assert 0.0 < loss[0] - loss[1] < 1.0 or loss[1] > loss[0]


def test_pictures_and_files_are_taken_as_bytes_and_as_open_files():
    with Image.open(KODIM05) as image:
        expected = ssplat.encode(image.crop((0, 0, 80, 60)), bytes=400, effort=1)
        cropped = io.BytesIO()
        image.crop((0, 0, 80, 60)).save(cropped, "PNG")
    assert ssplat.encode(cropped.getvalue(), bytes=400, effort=1) == expected
    cropped.seek(0)
    assert ssplat.encode(cropped, bytes=400, effort=1) == expected
    assert (ssplat.decode(io.BytesIO(expected)) == ssplat.decode(expected)).all()


def test_a_quality_is_met_or_warned_about():
    with Image.open(KODIM05) as image:
        picture = np.asarray(image.crop((200, 100, 360, 220)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data = ssplat.encode(picture, quality=60, effort=1)
    found = ssplat.metrics.ssimulacra2(picture, ssplat.decode(data))
    assert abs(found - 60) <= 0.5
    noise = np.random.default_rng(0).integers(0, 256, (24, 24), np.uint8)
    with pytest.warns(ssplat.QualityWarning, match="quality 99 was not met"):
        ssplat.encode(noise, quality=99, effort=1, detail="off")
    # Noise is stored without loss, and without a target the quality is 70.
    assert (ssplat.decode(ssplat.encode(noise, quality=99, effort=1)) == noise).all()
    assert ssplat.encode(picture, effort=1) == ssplat.encode(picture, quality=70, effort=1)


def test_the_detail_layer_is_told_drawn_and_left_out():
    picture = np.asarray(Image.open(KODIM05))[100:228, 200:328]
    data = ssplat.encode(picture, bytes=3000, detail=0.5, effort=1, thumbnail=None)
    told = ssplat.info(data)["detail"]
    assert told["levels"] > 0 and told["tiles"] == told["of_tiles"] == 1
    assert 0 < told["bits"] / 8 <= told["bytes"] < len(data)
    both, gaussians = ssplat.decode(data), ssplat.decode(data, detail=False)
    assert ssplat.metrics.psnr(picture, both) > ssplat.metrics.psnr(picture, gaussians) + 0.5
    assert ssplat.info(ssplat.encode(picture, bytes=3000, detail="off", effort=1))["detail"] is None
    for wrong in (0, 1.0, "always"):
        with pytest.raises(ssplat.ParameterError) as caught:
            ssplat.encode(picture, detail=wrong)
        assert caught.value.name == "detail"
