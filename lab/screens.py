#!/usr/bin/env python3
"""Compares encodes of screens, pages and drawings at given ratios with AVIF (tune=iq).

    python lab/screens.py target/release/ssplat PICTURES...
    python lab/screens.py target/release/ssplat PICTURES... --ratios 100,200 --speed 4
    python lab/screens.py target/release/ssplat IMAGES/screens IMAGES/graphics shot.png --page

PICTURES are pictures or folders of pictures. For each picture and ratio, the command prints the bytes of the file, its
SSIMULACRA2 score (100 if it is equal to the picture), the largest score of AVIF files of 4:2:0 and 4:4:4 that fit into
the ratio, and the CPU seconds of the encode. The mean and the smallest lead over AVIF of each folder and ratio follow.
Pictures of which AVIF has no file that is small enough are not counted.

--page writes the table of screens into docs/BENCHMARKS.md, with the bytes of PNG (as Pillow optimizes it), lossless WebP
(method 6, quality 100), JPEG XL (effort 7) and ssplat without loss in columns of their own, and below the pictures of each
folder the mean of these bytes relative to the smaller of WebP and JPEG XL, and the mean and the smallest lead over AVIF.
It needs pillow-jxl-plugin.

Pictures are converted to 8 bits and to RGB, or RGBA if they have alpha. The command needs Pillow 12 or newer.
"""
import argparse, io, json, pathlib, subprocess, tempfile

from PIL import Image

from exact import found, losslessly, spent
from report import commit_of, measured_when, number, table, write_tables

root = pathlib.Path(__file__).resolve().parent.parent

# Qualities of AVIF; the highest stands for no loss, which tune=iq does not support.
QUALITIES = range(100)


def score(program, original, made):
    compare = subprocess.run([program, "compare", original, made, "--json"], check=True, capture_output=True, text=True)
    return json.loads(compare.stdout)["ssimulacra2"]


def best_avif(picture, subsampling, most, speed, encoded):
    """Returns the largest AVIF file of at most `most` bytes, or None."""
    def encode(quality):
        if quality not in encoded:
            out = io.BytesIO()
            picture.save(out, "AVIF", quality=quality, speed=speed, subsampling=subsampling, advanced={"tune": "iq"})
            encoded[quality] = out.getvalue()
        return encoded[quality]
    low, high = -1, len(QUALITIES)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if len(encode(middle)) <= most else (low, middle)
    return encode(low) if low >= 0 else None


def signed(points):
    return ("+" if points >= 0 else "") + number(points, 1)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("pictures", type=pathlib.Path, nargs="+")
    parser.add_argument("--ratios", default="20,50,100,200", help="ratios, separated by commas")
    parser.add_argument("--speed", type=int, default=6, help="speed of AVIF")
    parser.add_argument("--page", action="store_true", help="write the table of screens into docs/BENCHMARKS.md")
    args = parser.parse_args()
    sets, rows, relative = {}, {}, {}
    print("| picture | ratio | bytes of | bytes | SSIMULACRA2 | AVIF | encode, s |\n|---|--:|--:|--:|--:|--:|--:|")
    with tempfile.TemporaryDirectory() as folder:
        source, file, back = (pathlib.Path(folder) / name for name in ("source.png", "file.ssplat", "back.png"))
        for path in found(args.pictures):
            picture = Image.open(path)
            picture = picture.convert("RGBA" if picture.has_transparency_data else "RGB")
            picture.info.clear()
            picture.save(source)
            raw, files = picture.width * picture.height * len(picture.mode), {}
            row = [path.stem.split("-")[0] if len(path.stem) > 20 else path.stem]
            if args.page:
                spent([args.program, "encode", source, file, "--lossless", "--force", "--quiet"])
                sizes = [*map(len, losslessly(picture)), file.stat().st_size]
                relative.setdefault(path.parent.name, []).append([size / min(sizes[1:3]) for size in sizes])
                row += [f"{size:,}".replace(",", " ") for size in sizes]
            for ratio in map(int, args.ratios.split(",")):
                seconds = spent([args.program, "encode", source, file, "--ratio", ratio, "--force", "--quiet"])
                own, others = score(args.program, source, file), []
                for subsampling in ("4:2:0", "4:4:4"):
                    made = best_avif(picture, subsampling, raw // ratio, args.speed, files.setdefault(subsampling, {}))
                    if made:
                        Image.open(io.BytesIO(made)).convert(picture.mode).save(back)
                        others.append(score(args.program, source, back))
                name, other = f"{path.parent.name}/{path.stem}", f"{max(others):.1f}" if others else "too large"
                print(f"| {name} | {ratio} | {raw // ratio} | {file.stat().st_size} | {own:.1f} | {other} | {seconds:.1f} |", flush=True)
                if others:
                    sets.setdefault((path.parent.name, ratio), []).append(own - max(others))
                row.append(f"{number(own, 1)} / {number(max(others), 1) if others else '–'}")
            rows.setdefault(path.parent.name, []).append(row)
    for (name, ratio), leads in sets.items():
        print(f"{name} at {ratio}: {sum(leads) / len(leads):+.1f} in the mean, {min(leads):+.1f} at least, {len(leads)} pictures")
    if args.page:
        for name, own in rows.items():
            means = [f"{sum(column) / len(own):.2f}".lstrip("0") for column in zip(*relative[name])]
            leads = [sets.get((name, int(ratio)), []) for ratio in args.ratios.split(",")]
            own.append([f"**{name}**", *means, *(f"{signed(sum(lead) / len(lead))} ({signed(min(lead))})" if lead else "" for lead in leads)])
        rows = [row for own in rows.values() for row in own]
        head = ["picture", "PNG", "WebP", "JPEG XL", "ssplat", *(f"at {ratio}" for ratio in args.ratios.split(","))]
        write_tables(root / "docs/BENCHMARKS.md", {"set screens": f"{table(head, rows)}\n\n{measured_when(commit_of(root))}"})


if __name__ == "__main__":
    main()
