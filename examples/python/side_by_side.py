"""Makes a contact sheet for visual comparison with AVIF.

    python side_by_side.py PROGRAM PICTURE... --ratio 50 --sheet OUT.webp

Each row shows the same part of a picture four times: the original; PROGRAM's file for the best PSNR (`--tune psnr`);
its file for the best perceptual quality (`--tune iq`, the default); and the largest AVIF file that is not larger, by
libavif's tune=iq, with chroma of half or of full resolution, whichever has the higher SSIMULACRA2. The part is the one
with the median amount of detail, and is chosen from the original alone; `--parts` takes other quantiles of the detail,
for example 0.5,1 for a second row with the most detailed part. `--middle 2048x1536` encodes only that part of each
picture, from its middle. Needs NumPy, and Pillow 12 or later with AVIF.
"""

import argparse
import io
import json
import pathlib
import subprocess
import tempfile

import numpy as np
from PIL import Image, ImageDraw

#: Width and height of the parts shown, and the height of the titles, pixels; the number of parts in a row.
PART, TITLES, COLUMNS = (240, 180), 14, 4


def part_of(picture, quantile):
    """Returns the corner of the part at a quantile of the amount of detail."""
    luma = np.asarray(picture.convert("L"), float)
    (width, height), corners = PART, {}
    for y in range(0, luma.shape[0] - height + 1, height // 2):
        for x in range(0, luma.shape[1] - width + 1, width // 2):
            part = luma[y : y + height, x : x + width]
            corners[x, y] = abs(np.diff(part, axis=0)).mean() + abs(np.diff(part, axis=1)).mean()
    ordered = sorted(corners, key=lambda corner: (corners[corner], corner))
    return ordered[min(int(quantile * len(ordered)), len(ordered) - 1)]


def middle_of(picture, size):
    """Cuts out a part of `size` (or of the whole picture, where it is smaller) from the middle."""
    (width, height), (left, top) = size, ((whole - part) // 2 for whole, part in zip(picture.size, size))
    left, top = max(left, 0), max(top, 0)
    return picture.crop((left, top, min(left + width, picture.width), min(top + height, picture.height)))


def avif(picture, most, speed, subsampling):
    """Encodes the largest AVIF file of at most `most` bytes; returns the decoded picture and the size."""
    best = None
    low, high = 0, 100
    while low <= high:
        quality, file = (low + high) // 2, io.BytesIO()
        options = {"speed": speed, "subsampling": subsampling, "max_threads": 1, "advanced": {"tune": "iq"}}
        picture.save(file, "AVIF", quality=quality, **options)
        if file.tell() <= most:
            best, low = file, quality + 1
        else:
            high = quality - 1
    return (Image.open(best).convert("RGB"), best.tell()) if best else (Image.new("RGB", picture.size), 0)


def better_avif(program, picture, most, speed, folder):
    """Returns the better of both subsamplings by SSIMULACRA2, and its size."""
    original, made = pathlib.Path(folder, "original.ppm"), pathlib.Path(folder, "avif.ppm")
    picture.save(original)
    found = []
    for subsampling in ("4:2:0", "4:4:4"):
        decoded, size = avif(picture, most, speed, subsampling)
        decoded.save(made)
        output = subprocess.run([program, "compare", original, made, "--json"], check=True, capture_output=True).stdout
        found.append((json.loads(output)["ssimulacra2"] if size else float("-inf"), subsampling, decoded, size))
    _, subsampling, decoded, size = max(found, key=lambda made: made[0])
    return decoded, size, subsampling


def ours(program, source, tune, ratio, folder):
    """Encodes with a tune; returns the decoded picture and the size."""
    file, png = pathlib.Path(folder, "a.ssplat"), pathlib.Path(folder, "a.png")
    for old in (file, png):
        old.unlink(missing_ok=True)
    for words in (["encode", source, file, "--ratio", str(ratio), "--tune", tune], ["decode", file, png]):
        subprocess.run([program, *words], check=True, capture_output=True)
    return Image.open(png).convert("RGB"), file.stat().st_size


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program")
    parser.add_argument("pictures", nargs="+", type=pathlib.Path)
    parser.add_argument("--ratio", type=float, default=50)
    parser.add_argument("--parts", default="0.5", help="quantiles of the amount of detail, one row each [default: 0.5]")
    parser.add_argument("--middle", metavar="WIDTHxHEIGHT", help="encode only a part of this size from the middle")
    parser.add_argument("--speed", type=int, default=3, help="speed of AVIF's encoder [default: 3]")
    parser.add_argument("--quality", type=int, default=82, help="quality of the sheet's WebP file [default: 82]")
    parser.add_argument("--sheet", type=pathlib.Path, required=True)
    given = parser.parse_args()
    quantiles = [float(word) for word in given.parts.split(",")]
    middle = given.middle and tuple(int(word) for word in given.middle.split("x"))
    (width, height), rows = PART, len(given.pictures) * len(quantiles)
    sheet = Image.new("RGB", (width * COLUMNS, (height + TITLES) * rows), "white")
    pen = ImageDraw.Draw(sheet)
    with tempfile.TemporaryDirectory() as folder:
        for number, source in enumerate(given.pictures):
            picture, name = Image.open(source).convert("RGB"), source.stem
            if middle:
                picture, source = middle_of(picture, middle), pathlib.Path(folder, "middle.png")
                picture.info.clear()
                picture.save(source)
            shown = [(picture, f"{name}: original", 0)]
            for tune in ("psnr", "iq"):
                decoded, size = ours(given.program, source, tune, given.ratio, folder)
                shown.append((decoded, f"--tune {tune}, {size} bytes", size))
            decoded, size, subsampling = better_avif(given.program, picture, shown[-1][2], given.speed, folder)
            shown.append((decoded, f"AVIF {subsampling}, {size} bytes", size) if size else (decoded, "AVIF: no file of that size", 0))
            for row, quantile in enumerate(quantiles, number * len(quantiles)):
                x, y = part_of(picture, quantile)
                top = row * (height + TITLES)
                for column, (seen, title, _) in enumerate(shown):
                    pen.text((column * width + 2, top + 1), title, "black")
                    sheet.paste(seen.crop((x, y, x + width, y + height)), (column * width, top + TITLES))
            print(name, *(size for *_, size in shown[1:]), flush=True)
    sheet.save(given.sheet, quality=given.quality, method=6)


if __name__ == "__main__":
    main()
