#!/usr/bin/env python3
"""Measures files of the rates at which other Gaussian codecs publish a PSNR, and sets them beside the published figures.

    python lab/published.py target/release/ssplat KODAK
    python lab/published.py target/release/ssplat KODAK --rates .1,.2,.5
    python lab/published.py target/release/ssplat KODAK --page
    python lab/published.py --benchmarks --page

KODAK is a folder with pictures of the Kodak suite. Each picture is encoded with `--tune psnr` and the largest number of bytes
that the rate allows, so that every picture has the same rate, as with a fixed number of Gaussians. A rate is in bits per pixel
and counts the whole file. PSNR is that of the decoded pictures of 8 bits: the squared error is averaged over the pixels and
the red, green and blue samples of a picture, and the PSNR over the pictures, as the programs of GaussianImage do it.

docs/methods/published.csv lists the published points. The command measures their rates, or those of --rates. --page writes the
tables of docs/methods/published.md. Encodes are cached by the hash of the program, so that an interrupted command can be
continued.

--benchmarks encodes nothing. It takes the files of `--tune psnr` in docs/benchmarks.csv, and interpolates the PSNR of each
picture to the rate, with a cubic over the logarithm of the rate through its four nearest files. Needs numpy and Pillow.
"""
import argparse, csv, math, pathlib, shlex, tempfile

import numpy
from PIL import Image

from other_codecs import Cache, mean, programs, run
from report import commit_of, measured_when, number, signed, table, write_tables

root = pathlib.Path(__file__).resolve().parent.parent


def psnr(original, made):
    """Returns the PSNR of two pictures over red, green and blue, in dB."""
    one, other = (numpy.asarray(Image.open(path).convert("RGB"), numpy.float64) for path in (original, made))
    return float(10 * numpy.log10(255**2 / numpy.mean((one - other) ** 2)))


class Encodes:
    """Means over files that the program writes."""

    def __init__(self, args):
        self.cache, self.options = Cache(args.cache), shlex.split(args.options)
        (self.program, self.own, self.variables, self.build), = programs([f"program={args.program}"]).values()
        self.pictures = sorted(args.pictures.glob("kodim*.png"))
        if not self.pictures:
            raise SystemExit(f"no kodim*.png in {args.pictures}")

    def file(self, picture, rate):
        """Returns the bytes and the PSNR of a file of at most this rate, and the CPU seconds of encoding it."""
        def work():
            with Image.open(picture) as image, tempfile.TemporaryDirectory() as folder:
                size = int(rate * image.width * image.height / 8)
                pixels, file, back = (pathlib.Path(folder, name) for name in ("pixels.png", "file.ssplat", "back.png"))
                # Without metadata, which would count towards the size.
                Image.fromarray(numpy.asarray(image.convert("RGB"))).save(pixels)
                encode = [self.program, "--threads", "1", "encode", pixels, file, "--bytes", size, "--tune", "psnr", "--quiet"]
                seconds = run([*encode, *self.own, *self.options], self.variables)[1]
                run([self.program, "decode", file, back, "--quiet"])
                written = file.stat().st_size
                assert written <= size, f"{picture.name}: {written} bytes instead of {size}"
                return {"bytes": written, "rate": written * 8 / (image.width * image.height), "psnr": psnr(pixels, back), "seconds": seconds}
        return self.cache.kept(f"{self.build} {self.own} {self.variables} {picture.name} {rate} {self.options}", work)

    def means(self, rate):
        """Returns the mean rate, PSNR and CPU seconds of the pictures."""
        files = [self.file(picture, rate) for picture in self.pictures]
        return {key: mean(file[key] for file in files) for key in ("rate", "psnr", "seconds")}


class Benchmarks:
    """Means over curves through the files of docs/benchmarks.csv."""

    def __init__(self):
        self.curves = {}
        with open(root / "docs/benchmarks.csv", newline="") as file:
            for row in csv.DictReader(file):
                if row["codec"] == "ssplat --tune psnr":
                    point = math.log(int(row["bytes"]) * 8 / (768 * 512)), float(row["psnr"]), float(row["encode_s"])
                    self.curves.setdefault(row["image"], []).append(point)
        self.pictures = sorted(map(pathlib.Path, self.curves))

    def means(self, rate):
        """Returns the rate, and the mean PSNR and CPU seconds of the pictures there."""
        at, quality, seconds = math.log(rate), [], []
        for points in self.curves.values():
            if not min(points)[0] <= at <= max(points)[0]:
                raise SystemExit(f"docs/benchmarks.csv has no files around {rate} bpp")
            near = sorted(points, key=lambda point: abs(point[0] - at))[:4]
            quality.append(sum(point[1] * math.prod((at - other[0]) / (point[0] - other[0]) for other in near if other != point) for point in near))
            seconds.append(float(numpy.interp(at, *[[point[i] for point in sorted(points)] for i in (0, 2)])))
        return {"rate": rate, "psnr": mean(quality), "seconds": mean(seconds)}


def published():
    """Returns the rows of docs/methods/published.csv."""
    with open(root / "docs/methods/published.csv", newline="") as file:
        return list(csv.DictReader(file))


def beside(points, measured):
    """Returns the table of the published points on Kodak, with ours at their rates."""
    rows = [[row["method"], row["bpp"], row["psnr"], number(measured[float(row["bpp"])]["rate"], 3), number(measured[float(row["bpp"])]["psnr"], 2),
             signed(measured[float(row["bpp"])]["psnr"] - float(row["psnr"]), 1)] for row in points]
    return table(["method", "rate, bpp", "PSNR, dB", "ssplat: rate", "ssplat: PSNR", "ssplat over it"], rows)


def curve(measured):
    """Returns the table of our means, from small files to large ones."""
    rows = [[number(made["rate"], 3), number(made["psnr"], 2), number(made["seconds"], 1)] for _, made in sorted(measured.items())]
    return table(["rate, bpp", "PSNR, dB", "encode, CPU s"], rows, left=0)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", nargs="?", help="the program, which may have its own options and environment variables, as in lab/sets.py")
    parser.add_argument("pictures", nargs="?", type=pathlib.Path)
    parser.add_argument("--rates", help="bits per pixel, separated by commas, besides the published rates with --page and instead of them without")
    parser.add_argument("--options", default="", help="further options of every encode")
    parser.add_argument("--benchmarks", action="store_true", help="interpolate the files of docs/benchmarks.csv instead of encoding")
    parser.add_argument("--page", action="store_true", help="write the tables of docs/methods/published.md")
    parser.add_argument("--cache", type=pathlib.Path, default=root / "target/published")
    args = parser.parse_args()
    if not args.benchmarks and not args.pictures:
        parser.error("a program and a folder with pictures, or --benchmarks")
    ours = Benchmarks() if args.benchmarks else Encodes(args)
    points = [row for row in published() if row["set"] == "Kodak"]
    rates = set(map(float, args.rates.split(","))) if args.rates else set()
    if args.page or not rates:
        rates |= {float(row["bpp"]) for row in points}
    measured = {}
    for rate in sorted(rates):
        measured[rate] = ours.means(rate)
        print(f"{rate:.3f} bpp: {measured[rate]['rate']:.4f} bpp, {measured[rate]['psnr']:.3f} dB, {measured[rate]['seconds']:.1f} s", flush=True)
    if args.page:
        names = ", ".join(picture.stem.removeprefix("kodim") for picture in ours.pictures)
        note = "Interpolated between the files of [benchmarks.csv](../benchmarks.csv)." if args.benchmarks else measured_when(commit_of(root))
        write_tables(root / "docs/methods/published.md", {"kodak": beside(points, measured), "rates": f"{curve(measured)}\n\nPictures: kodim{names}.\n{note}"})


if __name__ == "__main__":
    main()
