"""Makes a contact sheet for visual comparison with AVIF.

    python side_by_side.py PROGRAM PICTURE... --ratio 50 --sheet OUT.webp

Each row shows the same part of a picture four times: the original; PROGRAM's file for the best PSNR (`--tune psnr`);
its file for the best perceptual quality (`--tune iq`, the default); and the largest AVIF file that is not larger, by
libavif's tune=iq at speed 3. The part is the one with the median amount of detail, and is chosen from the original
alone. Needs NumPy, and Pillow 12 or later with AVIF.
"""

import argparse
import io
import pathlib
import subprocess
import tempfile

import numpy as np
from PIL import Image, ImageDraw

#: Width and height of the parts shown, and the height of the titles, pixels.
PART, TITLES = (240, 180), 14
COLUMNS = ["original", "--tune psnr", "--tune iq", "AVIF tune=iq"]


def part_of(picture):
    """Returns the corner of the part with the median amount of detail."""
    luma = np.asarray(picture.convert("L"), float)
    (width, height), corners = PART, {}
    for y in range(0, luma.shape[0] - height + 1, height // 2):
        for x in range(0, luma.shape[1] - width + 1, width // 2):
            part = luma[y : y + height, x : x + width]
            corners[x, y] = abs(np.diff(part, axis=0)).mean() + abs(np.diff(part, axis=1)).mean()
    ordered = sorted(corners, key=lambda corner: (corners[corner], corner))
    return ordered[len(ordered) // 2]


def avif(picture, most):
    """Encodes the largest AVIF file of at most `most` bytes; returns the decoded picture and the size."""
    best = None
    low, high = 0, 100
    while low <= high:
        quality, file = (low + high) // 2, io.BytesIO()
        picture.save(file, "AVIF", quality=quality, speed=3, max_threads=1, advanced={"tune": "iq"})
        if file.tell() <= most:
            best, low = file, quality + 1
        else:
            high = quality - 1
    return (Image.open(best).convert("RGB"), best.tell()) if best else (Image.new("RGB", picture.size), 0)


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
    parser.add_argument("--sheet", type=pathlib.Path, required=True)
    given = parser.parse_args()
    (width, height), rows = PART, len(given.pictures)
    sheet = Image.new("RGB", (width * len(COLUMNS), (height + TITLES) * rows), "white")
    pen = ImageDraw.Draw(sheet)
    with tempfile.TemporaryDirectory() as folder:
        for row, source in enumerate(given.pictures):
            picture = Image.open(source).convert("RGB")
            shown = [(picture, 0)]
            shown += [ours(given.program, source, tune, given.ratio, folder) for tune in ("psnr", "iq")]
            shown.append(avif(picture, shown[-1][1]))
            x, y = part_of(picture)
            top = row * (height + TITLES)
            for column, (title, (seen, size)) in enumerate(zip(COLUMNS, shown)):
                pen.text((column * width + 2, top + 1), f"{title}, {size} bytes" if size else f"{source.stem}: {title}", "black")
                sheet.paste(seen.crop((x, y, x + width, y + height)), (column * width, top + TITLES))
            print(source.stem, *(size for _, size in shown[1:]), flush=True)
    sheet.save(given.sheet, quality=82, method=6)


if __name__ == "__main__":
    main()
