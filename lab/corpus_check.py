#!/usr/bin/env python3
"""Decodes every picture of a folder with ssplat and with Pillow, and lists what differs, what is refused, and what is slow.

    python lab/corpus_check.py FOLDER --program target/release/ssplat

FOLDER may be a checkout of test pictures of other projects, such as imazen/codec-corpus. `ssplat compare` measures the
samples that ssplat reads against those that Pillow reads, both upright; `ssplat encode` shows the exit status, the notes
and the time. With the packages pillow-jxl-plugin and pillow-heif, Pillow reads JPEG XL and HEIC as well. Without FOLDER, the
script makes pictures of every kind that Pillow writes.
"""

import argparse
import collections
import contextlib
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import time
import warnings

from PIL import Image, ImageOps

try:
    import numpy
except ImportError:
    sys.exit("corpus_check.py needs numpy")
try:
    import pillow_jxl  # noqa: F401
except ImportError:
    print("without pillow-jxl-plugin, JPEG XL is decoded but not compared", file=sys.stderr)

# PSNR in dB below which two decoders of a lossy or of a deep format differ: Pillow rounds 16 bits to 8.
CLOSE = 45.0
MEANINGS = {2: "usage", 3: "input or output", 4: "broken", 5: "unsupported", 6: "limit"}
warnings.simplefilter("ignore")
Image.MAX_IMAGE_PIXELS = 1 << 28


def run(program, *args, seconds):
    """Returns the exit status, the output, and the seconds of a command; the status is None after `seconds`."""
    start = time.monotonic()
    try:
        done = subprocess.run([program, *map(str, args)], capture_output=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        return None, "", seconds
    text = (done.stdout + done.stderr).decode(errors="replace")
    return done.returncode, text, time.monotonic() - start


def by_pillow(path, out):
    """Writes the first frame of a picture as a PNG, upright. Returns why not, if it cannot."""
    try:
        with Image.open(path) as picture:
            picture.load()
            picture = ImageOps.exif_transpose(picture)
            mode = picture.mode
            if mode == "P":
                picture = picture.convert("RGBA" if "transparency" in picture.info else "RGB")
            elif mode == "PA":
                picture = picture.convert("RGBA")
            elif mode in ("L", "RGB") and "transparency" in picture.info:
                picture = picture.convert("LA" if mode == "L" else "RGBA")
            elif mode.startswith("I;16"):
                picture = Image.fromarray(numpy.asarray(picture).astype(numpy.uint16))
            elif mode == "I":
                picture = Image.fromarray(numpy.asarray(picture).clip(0, 65535).astype(numpy.uint16))
            elif mode == "F":
                samples = numpy.nan_to_num(numpy.asarray(picture)).clip(0, 1) * 65535 + 0.5
                picture = Image.fromarray(samples.astype(numpy.uint16))
            elif mode in ("CMYK", "YCbCr", "RGBX", "HSV", "LAB"):
                picture = picture.convert("RGB")
            picture.info.clear()
            picture.save(out, "PNG", compress_level=1)
    except Exception as e:  # noqa: BLE001  # decoders raise all kinds of exceptions
        return f"{type(e).__name__}: {e}"[:120]
    return None


def made(folder):
    """Writes pictures of all kinds that Pillow writes."""
    y, x = numpy.mgrid[0:40, 0:56]
    rgb = numpy.stack([x * 4, y * 6, (x * y) % 256], -1).astype(numpy.uint8)
    alpha = ((x + y) * 2).astype(numpy.uint8)
    color = Image.fromarray(rgb)
    pictures = {
        "rgb": color,
        "rgba": Image.fromarray(numpy.dstack([rgb, alpha])),
        "grey": color.convert("L"),
        "grey-alpha": Image.merge("LA", [color.convert("L"), Image.fromarray(alpha)]),
        "palette": color.quantize(64),
        "bilevel": color.convert("1"),
        "deep": Image.fromarray((x * 1000 + y * 7).astype(numpy.uint16)),
        "float": Image.fromarray((x / 56).astype(numpy.float32)),
        "cmyk": color.convert("CMYK"),
        "premultiplied": Image.fromarray(numpy.dstack([rgb, alpha])).convert("RGBa"),
    }
    kinds = [("png", {}), ("tif", {}), ("tif", {"compression": "tiff_lzw"}), ("tif", {"compression": "jpeg"})]
    kinds += [("tif", {"compression": "tiff_adobe_deflate"}), ("tif", {"compression": "packbits"})]
    kinds += [("jpg", {"quality": 90}), ("jpg", {"progressive": True}), ("jpg", {"subsampling": 0}), ("gif", {})]
    kinds += [("webp", {"lossless": True}), ("webp", {}), ("bmp", {}), ("tga", {}), ("ppm", {}), ("jxl", {}), ("avif", {})]
    for name, picture in pictures.items():
        for k, (extension, options) in enumerate(kinds):
            try:
                picture.save(folder / f"{name}-{k}.{extension}", **options)
            except Exception:  # noqa: BLE001  # not every format has every kind
                (folder / f"{name}-{k}.{extension}").unlink(missing_ok=True)


def check(args, folder):
    found = collections.Counter()
    differ, refused, slow, told = [], [], [], collections.Counter()
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    # The results so far are printed if the script is ended.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.suppress(KeyboardInterrupt), tempfile.TemporaryDirectory() as place:
        out, png = pathlib.Path(place, "o.ssplat"), pathlib.Path(place, "p.png")
        for path in files:
            if args.extensions and path.suffix.lower().lstrip(".") not in args.extensions:
                continue
            name = path.relative_to(folder)
            encode = ["encode", path, out, "--force", "--effort", "1", "--max-side", args.max_side, "--metadata", "none"]
            status, text, seconds = run(args.program, *encode, seconds=args.seconds)
            why = by_pillow(path, png)
            found["exit " + str(status)] += 1
            if status is None or seconds > args.slow:
                slow.append((name, seconds))
            if status is not None and (status > 6 or status < 0 or status == 1):
                differ.append((name, f"ends with {status}: {text.strip()[:200]}"))
                continue
            if status != 0:
                text = text.strip().split("\n")[-1].replace(str(path), "")
                reads = "Pillow reads it" if why is None else f"so does Pillow ({why})"
                refused.append((name, f"{MEANINGS.get(status, status)}{text.removeprefix('ssplat')[:200]}; {reads}"))
                continue
            for line in text.split("\n"):
                if line.startswith(f"ssplat: {path}: "):
                    told[re.sub(r"[0-9]+(\.[0-9]+)?", "N", line.removeprefix(f"ssplat: {path}: "))] += 1
            if why is not None:
                found["not read by Pillow"] += 1
                continue
            status, text, _ = run(args.program, "compare", path, png, seconds=args.seconds)
            line = next((line for line in text.split("\n") if line.startswith("PSNR")), "")
            if "identical" in line:
                found["identical"] += 1
            elif line and float(line.split()[1]) >= CLOSE:
                found[f"above {CLOSE:.0f} dB"] += 1
            else:
                found["different"] += 1
                differ.append((name, line or text.strip()[-200:]))
    print(", ".join(f"{count} {what}" for what, count in sorted(found.items())))
    for title, rows in [("differ", differ), ("refused", refused), ("slow", slow)]:
        print(f"\n{title}: {len(rows)}")
        for name, what in rows:
            print(f"  {name}: {what if isinstance(what, str) else f'{what:.1f} s'}")
    print("\nnotes")
    for note, count in told.most_common():
        print(f"  {count:4} {note[:160]}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=pathlib.Path)
    parser.add_argument("--program", default="target/release/ssplat")
    parser.add_argument("--seconds", type=float, default=60, help="limit for each command")
    parser.add_argument("--slow", type=float, default=10, help="seconds from which a file is slow")
    parser.add_argument("--max-side", type=int, default=256, help="side to which pictures are downscaled for encoding")
    parser.add_argument("--extensions", type=lambda text: set(text.split(",")), help="only files with these")
    args = parser.parse_args()
    if args.folder:
        check(args, args.folder)
        return
    with tempfile.TemporaryDirectory() as place:
        made(pathlib.Path(place))
        check(args, pathlib.Path(place))


if __name__ == "__main__":
    main()
