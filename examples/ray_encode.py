#!/usr/bin/env python3
"""Encodes a folder of pictures, or any fsspec URL, on a Ray cluster, and writes a manifest in Parquet.

    pip install 'ssplat[ray]'        # not published yet; instead, in a checkout, in 4 minutes with Rust 1.89:
                                     # pip install maturin && maturin build --release -m python/Cargo.toml
                                     # pip install "$(ls python/target/wheels/ssplat-*.whl)[ray]"
    python examples/ray_encode.py photos/ encoded/ --ratio 50
    python examples/ray_encode.py s3://bucket/photos s3://bucket/encoded --address auto

Files are named as by `ssplat encode --out-dir`: photo.jpg becomes photo.ssplat, or photo.jpg.ssplat if there is also a
photo.png. Each picture is one row of OUT/manifest/*.parquet: path, output, bytes, psnr, ms_ssim, seconds, error. A
picture that cannot be read or encoded gets a row with its error and no output, and the other pictures are still
encoded. Pictures in the manifest are skipped, so the same command continues an interrupted run. `--again` retries
pictures with errors.

Tasks receive paths and read the pictures themselves, so that a broken file does not end the job. A task is a block of
pictures. It writes its rows at the end, under a name that is the same if Ray runs the task again after a worker died.
So every picture has one row, and at most the work of one block is repeated.

A single very large picture can be divided among the workers, tile by tile:

    python examples/ray_encode.py huge.ppm huge.ssplat --split --ratio 100

The file is the same as that of `ssplat encode --tiles`. A task contains the pixels of its tile, so workers do not need
access to the picture. A binary PNM is read in parts; other formats are loaded into this machine's memory. With
`--keep FOLDER`, results are stored there, and the same command continues an interrupted run.

With Dask, `client.map(functools.partial(encode_one, source=..., out=..., options=...), paths)` gives the same rows;
with Spark, `mapInPandas`.
"""

import argparse
import collections
import functools
import hashlib
import io
import json
import os
import posixpath
import re
import sys
import time

import fsspec
import pyarrow as pa
import pyarrow.dataset

SCHEMA = pa.schema(
    [
        ("path", pa.string()),
        ("output", pa.string()),
        ("bytes", pa.int64()),
        ("psnr", pa.float64()),
        ("ms_ssim", pa.float64()),
        ("seconds", pa.float64()),
        ("error", pa.string()),
        ("options", pa.string()),
    ]
)
MANIFEST = "manifest"


def output_names(paths):
    """Returns the output of each path: its extension is replaced, or kept before the new one if names would collide."""
    names = {path: posixpath.splitext(path)[0] + ".ssplat" for path in paths}
    while True:
        times = collections.Counter(names.values())
        longer = {path: path + ".ssplat" for path, name in names.items() if times[name] > 1}
        if longer.items() <= names.items():
            return names
        names |= longer


def encode_one(path, source, out, options, output=None):
    """Encodes the picture `path` under `source` to the file `output` under `out`, by default the path with another
    extension. Returns a row of the manifest, and never raises an exception."""
    import ssplat
    from PIL import Image

    row = dict.fromkeys(SCHEMA.names) | {"path": path, "options": json.dumps(options, sort_keys=True)}
    start = time.perf_counter()
    try:
        fs, root = fsspec.url_to_fs(source)
        with Image.open(io.BytesIO(fs.cat_file(posixpath.join(root, path)))) as image:
            data = ssplat.encode(image, threads=1, **options)
            stored = ssplat.decode(data, threads=1)
            row["psnr"] = ssplat.metrics.psnr(image, stored, threads=1)
            row["ms_ssim"] = ssplat.metrics.ms_ssim(image, stored, threads=1)
        output = output or output_names([path])[path]
        write_whole(out, output, data)
        row |= {"output": output, "bytes": len(data)}
    except Exception as e:
        row["error"] = f"{type(e).__name__}: {e}"
    row["seconds"] = time.perf_counter() - start
    return row


def write_whole(root, name, data):
    """Writes a file atomically. Object stores do so by themselves."""
    fs, root = fsspec.url_to_fs(root)
    path = posixpath.join(root, name)
    if "file" not in fs.protocol:
        fs.pipe_file(path, data)
        return
    os.makedirs(os.path.dirname(path), exist_ok=True)
    part = f"{path}.{os.getpid()}.part"
    with open(part, "wb") as file:
        file.write(data)
    os.replace(part, path)


def list_pictures(source):
    """Returns the paths below `source` of all files with an extension that Pillow supports."""
    from PIL import Image

    fs, root = fsspec.url_to_fs(source)
    known = {extension for extension, name in Image.registered_extensions().items() if name in Image.OPEN}
    names = (posixpath.relpath(path, root) for path in fs.find(root))
    return sorted(name for name in names if posixpath.splitext(name)[1].lower() in known)


def read_manifest(out):
    """Returns the existing rows."""
    fs, root = fsspec.url_to_fs(out)
    files = [path for path in fs.find(posixpath.join(root, MANIFEST)) if path.endswith(".parquet")]
    if not files:
        return SCHEMA.empty_table()
    return pyarrow.dataset.dataset(files, schema=SCHEMA, filesystem=fs, format="parquet").to_table()


def left_to_do(source, out, options, again=False):
    """Returns the pictures without a row; with `again`, also those whose last row is an error."""
    done, text = set(), json.dumps(options, sort_keys=True)
    for row in read_manifest(out).select(["path", "error", "options"]).to_pylist():
        if row["options"] != text:
            raise SystemExit(f"{out}: was encoded with {row['options']}, not {text}; give another folder")
        if not (again and row["error"]):
            done.add(row["path"])
    return [path for path in list_pictures(source) if path not in done]


def run(source, out, options, *, block=None, again=False, encode=encode_one):
    """Encodes the remaining pictures on the connected Ray cluster, and returns their number."""
    import ray

    paths = left_to_do(source, out, options, again)
    if not paths:
        return 0
    outputs = output_names(list_pictures(source))

    def encode_block(batch):
        rows = [encode(row["path"], source, out, options, row["output"]) for row in batch.to_pylist()]
        return pa.Table.from_pylist(rows, schema=SCHEMA)

    # Small tasks keep all workers busy until the end, and sixteen pictures make the overhead of a task small.
    cores = max(1, int(ray.cluster_resources().get("CPU", 1)))
    blocks = -(-len(paths) // (block or min(16, max(1, len(paths) // (8 * cores)))))
    items = [{"path": path, "output": outputs[path]} for path in paths]
    ray.data.from_items(items, override_num_blocks=blocks).map_batches(
        encode_block, batch_size=None, batch_format="pyarrow", num_cpus=1
    ).write_parquet(out.rstrip("/") + "/" + MANIFEST)
    return len(paths)


def open_whole(path):
    """Returns the input for `ssplat.encode`: a memory map of a binary PNM, otherwise the path."""
    import numpy as np
    from PIL import Image

    with open(path, "rb") as file:
        start = file.read(1 << 12)
    header = re.match(rb"P([56])(?:\s+#.*)*\s+(\d+)(?:\s+#.*)*\s+(\d+)(?:\s+#.*)*\s+255\s", start)
    if header:
        width, height = int(header[2]), int(header[3])
        shape = (height, width) if header[1] == b"5" else (height, width, 3)
        return np.memmap(path, np.uint8, "r", header.end(), shape)
    # The caller knows that the picture is large.
    Image.MAX_IMAGE_PIXELS = None
    return path


def work_on(task):
    """Processes the task of a tile."""
    import ssplat

    return ssplat.work_on_tile(task, threads=1)


def split(path, out, options, *, side=2048, at_once=None, keep=None, work=work_on, progress=None):
    """Encodes one picture on the connected Ray cluster, in tiles of `side` pixels; returns the file's bytes."""
    import ray
    import ssplat

    @ray.remote(num_cpus=1)
    def on_tile(task):
        return work(task)

    def start(task):
        if keep is None:
            return functools.partial(ray.get, on_tile.remote(task))
        # Equal tasks have equal results, so the name is a hash of the contents.
        name = hashlib.sha256(task).hexdigest()
        fs, root = fsspec.url_to_fs(keep)
        if fs.exists(posixpath.join(root, name)):
            return functools.partial(fs.cat_file, posixpath.join(root, name))
        answer = on_tile.remote(task)

        def wait():
            found = ray.get(answer)
            write_whole(keep, name, found)
            return found

        return wait

    # One task for each worker, and one in its queue.
    at_once = at_once or 2 * max(1, int(ray.cluster_resources().get("CPU", 1)))
    workers = {"start": start, "at_once": at_once}
    data = ssplat.encode(open_whole(path), tiles=side, research=workers, progress=progress, **options)
    folder, name = posixpath.split(out)
    write_whole(folder or ".", name, data)
    return data


def main(arguments=None):
    parser = argparse.ArgumentParser(description="Encodes pictures on a Ray cluster.")
    parser.add_argument("source", help="folder or fsspec URL of the pictures")
    parser.add_argument("out", help="folder or fsspec URL for the files and the manifest")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--ratio", type=float)
    size.add_argument("--bytes", type=int)
    size.add_argument("--psnr", type=float)
    parser.add_argument("--effort", type=int, default=5)
    parser.add_argument("--block", type=int, help="number of pictures per task (by default 1 to 16)")
    parser.add_argument("--again", action="store_true", help="try pictures with errors once more")
    parser.add_argument("--split", type=int, nargs="?", const=2048, metavar="SIDE", help="divide one picture in tiles")
    parser.add_argument("--keep", help="with --split: folder or fsspec URL for the results of tiles, from which an interrupted run continues")
    parser.add_argument("--address", help="address of the cluster; by default one is started on this machine")
    a = parser.parse_args(arguments)
    import ray

    options = {k: v for k in ("ratio", "bytes", "psnr", "effort") if (v := getattr(a, k)) is not None}
    # Ray's workers run in other folders.
    local = [p if "://" in p else os.path.abspath(p) for p in (a.source, a.out)]
    ray.init(address=a.address)
    start = time.perf_counter()
    if a.split:
        data = split(*local, options, side=a.split, keep=a.keep)
        print(f"{len(data)} bytes in {time.perf_counter() - start:.1f} s")
        return 0
    count = run(*local, options, block=a.block, again=a.again)
    seconds = time.perf_counter() - start
    table = read_manifest(local[1])
    failed = len(table) - table["error"].null_count
    print(f"{count} pictures in {seconds:.1f} s; the manifest has {len(table)}, {failed} of them with errors")
    return 0


if __name__ == "__main__":
    sys.exit(main())
