"""Runs examples/ray_encode.py on a local cluster of two workers: no picture is lost or encoded twice."""

import json
import os
import pathlib
import sys

import pytest
import ssplat
from jobs import DiesOnce, TileDiesOnce
from pictures import ROOT, waves
from PIL import Image

ray = pytest.importorskip("ray")
pytest.importorskip("ray.data")
sys.path.insert(0, str(ROOT / "examples"))

import ray_encode

OPTIONS = {"bytes": 300, "effort": 1}
GOOD = [f"{k:02}.png" for k in range(11)] + ["deeper/11.jpg"]
BROKEN = "05-broken.png"


@pytest.fixture(scope="module")
def cluster():
    # Workers find this module and the example in the same places as this process.
    path = os.pathsep.join([str(ROOT / "examples"), str(pathlib.Path(__file__).parent)])
    ray.init(
        num_cpus=2,
        include_dashboard=False,
        object_store_memory=100 << 20,
        runtime_env={"env_vars": {"PYTHONPATH": path}},
        logging_level="error",
    )
    yield
    ray.shutdown()


@pytest.fixture
def folders(tmp_path):
    source, out = tmp_path / "in", tmp_path / "out"
    (source / "deeper").mkdir(parents=True)
    for k, name in enumerate(GOOD):
        Image.fromarray(waves(40, 50, seed=k)).save(source / name)
    (source / BROKEN).write_bytes((source / GOOD[0]).read_bytes()[:900])
    (source / "notes.txt").write_text("no picture")
    return str(source), str(out)


def rows_of(out):
    return ray_encode.read_manifest(out).to_pylist()


def check(source, out):
    """Every picture has one row; the files match the rows, are complete, and equal local encodes."""
    rows = rows_of(out)
    assert sorted(row["path"] for row in rows) == sorted([*GOOD, BROKEN])
    there = {str(p.relative_to(out)) for p in pathlib.Path(out).rglob("*") if p.is_file() and "manifest" not in p.parts}
    assert {row["output"] for row in rows if row["output"]} == {name for name in there if not name.endswith(".part")}
    for row in rows:
        if row["path"] == BROKEN:
            assert row["output"] is None and row["bytes"] is None
            assert "Error" in row["error"]
            continue
        picture = pathlib.Path(source, row["path"])
        data = pathlib.Path(out, row["output"]).read_bytes()
        assert row["error"] is None
        assert data == ssplat.encode(picture, **OPTIONS)
        assert row["bytes"] == len(data) <= 300
        assert row["psnr"] == pytest.approx(ssplat.metrics.psnr(picture, ssplat.decode(data)))
        assert row["ms_ssim"] is None and row["seconds"] > 0


def test_a_broken_picture_and_a_killed_worker_cost_no_other_picture(cluster, folders, tmp_path):
    source, out = folders
    marker = tmp_path / "died"
    encode = DiesOnce(GOOD[7], str(marker))
    assert ray_encode.run(source, out, OPTIONS, block=3, encode=encode) == len(GOOD) + 1
    assert marker.exists()
    check(source, out)
    # The worker died after writing a part of a file; the next one wrote the whole file.
    assert len(list(pathlib.Path(out).glob("*.part"))) == 1


def test_a_second_run_goes_on_where_the_first_was_stopped(cluster, folders):
    source, out = folders
    later = [pathlib.Path(source, name) for name in GOOD[4:]]
    for path in later:
        path.rename(path.with_suffix(".later"))
    assert ray_encode.run(source, out, OPTIONS, block=3) == 5
    before = {row["path"]: row for row in rows_of(out)}
    for path in later:
        path.with_suffix(".later").rename(path)
    assert ray_encode.run(source, out, OPTIONS, block=3) == len(GOOD) - 4
    check(source, out)
    assert all(row == before[row["path"]] for row in rows_of(out) if row["path"] in before)
    assert ray_encode.run(source, out, OPTIONS, block=3) == 0
    # Pictures with errors are tried again only on request.
    Image.fromarray(waves(40, 50)).save(pathlib.Path(source, BROKEN))
    assert ray_encode.run(source, out, OPTIONS, again=True) == 1
    assert [row["error"] is None for row in rows_of(out) if row["path"] == BROKEN].count(True) == 1


def test_a_folder_of_other_options_is_refused(cluster, folders):
    source, out = folders
    ray_encode.run(source, out, OPTIONS)
    with pytest.raises(SystemExit, match=json.dumps({"bytes": 300, "effort": 1})):
        ray_encode.run(source, out, OPTIONS | {"effort": 2})


def test_one_picture_is_divided_and_becomes_the_file_of_one_machine(cluster, tmp_path):
    options = {"bytes": 900, "effort": 1}
    path, out, marker = tmp_path / "in.ppm", tmp_path / "out" / "out.ssplat", tmp_path / "died"
    Image.fromarray(waves(200, 270)).save(path)
    here = ssplat.encode(path, tiles=128, **options)
    data = ray_encode.split(str(path), str(out), options, side=128, work=TileDiesOnce(str(marker)))
    assert data == here == out.read_bytes()
    assert marker.exists()


def test_a_divided_picture_is_gone_on_with_where_it_was_stopped(cluster, tmp_path):
    options = {"bytes": 900, "effort": 1}
    path, out, keep = tmp_path / "in.png", tmp_path / "out.ssplat", tmp_path / "answers"
    Image.fromarray(waves(200, 270)).save(path)

    def stop(stage, done):
        if stage == "finish":
            raise InterruptedError

    with pytest.raises(InterruptedError):
        ray_encode.split(str(path), str(out), options, side=128, keep=str(keep), progress=stop)
    assert not out.exists()
    before = {name: (keep / name).stat().st_mtime_ns for name in os.listdir(keep)}
    assert len(before) > 20
    ray_encode.split(str(path), str(out), options, side=128, keep=str(keep))
    assert out.read_bytes() == ssplat.encode(path, tiles=128, **options)
    assert all((keep / name).stat().st_mtime_ns == at for name, at in before.items())


def test_outputs_are_named_as_the_program_names_them():
    names = ray_encode.output_names(["a.png", "x/b.v2.png", "anim.gif", "anim.webp", "c.gif", "c.png", "c.gif.png"])
    assert names == {
        "a.png": "a.ssplat",
        "x/b.v2.png": "x/b.v2.ssplat",
        "anim.gif": "anim.gif.ssplat",
        "anim.webp": "anim.webp.ssplat",
        "c.gif": "c.gif.ssplat",
        "c.png": "c.png.ssplat",
        "c.gif.png": "c.gif.png.ssplat",
    }
