#!/usr/bin/env python3
"""Measures ringing: the error on flat ground beside edges, of programs and of AVIF (tune=iq) in the same number of bytes.

    python lab/ringing.py PICTURES old=target/old/ssplat new=target/release/ssplat
    python lab/ringing.py PICTURES new=target/release/ssplat --sets kodak,cid22 --ratios 50 --half choose --each

Ground is flat where the range of luma in 9 × 9 pixels is at most 6 code values. It is beside an edge within 16 pixels of a
change of luma by 30 or more in 3 × 3 pixels. The error is high-passed (minus a Gaussian blur of σ = 2), and averaged over the
channels. Of each picture, the 99th percentile over this ground counts. SSIMULACRA2 hardly sees such errors; people see dots and
streaks in a dark sky. Pictures with fewer than 2000 pixels of such ground are left out of the percentile, but not of the other
measures.

PICTURES contains one folder for each set in lab/sets.json; sets that are not in that file are used whole. A program may have its
own options and environment variables, as in lab/sets.py. Results are cached in --cache. For each set and ratio, the command
prints the means of every program, and its gains over the first. Needs numpy, opencv-python-headless and Pillow 12 or newer.
"""
import argparse, io, json, os, pathlib, shlex, tempfile

import cv2
import numpy
from PIL import Image

from other_codecs import Cache, mean, measured, programs, run

root = pathlib.Path(__file__).resolve().parent.parent
# Pixels of flat ground below which a picture has no percentile.
MIN_GROUND = 2000


def ground(pixels):
    """Returns which pixels lie on flat ground beside an edge."""
    luma = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY).astype(numpy.float32)

    def spread(side):
        window = numpy.ones((side, side), numpy.uint8)
        return cv2.dilate(luma, window) - cv2.erode(luma, window)
    edges = (spread(3) >= 30).astype(numpy.uint8)
    return (spread(9) <= 6) & (cv2.dilate(edges, numpy.ones((33, 33), numpy.uint8)) > 0)


def high_passed(pixels):
    return pixels.astype(numpy.float32) - cv2.GaussianBlur(pixels.astype(numpy.float32), (0, 0), 2)


def ringing(original, made):
    """Returns the mean and the 99th percentile of the high-passed error on flat ground beside edges, in code values; nothing if
    there is too little such ground."""
    where = ground(original)
    if where.sum() < MIN_GROUND:
        return {"mean": None, "p99": None}
    errors = abs(high_passed(made) - high_passed(original)).mean(2)[where]
    return {"mean": float(errors.mean()), "p99": float(numpy.percentile(errors, 99))}


class Lab:
    def __init__(self, args):
        self.args, self.cache, self.programs = args, Cache(args.cache), programs(args.programs)
        self.measure = next(iter(self.programs.values()))[0]
        (args.cache / "pixels").mkdir(exist_ok=True)

    def pictures(self, name):
        """Returns copies of the pictures of a set without metadata."""
        halves = json.loads((root / "lab/sets.json").read_text()).get(name)
        files = [path.name for path in (self.args.pictures / name).iterdir()] if halves is None else sum((halves[half] for half in halves if self.args.half in (half, "all")), [])
        words = [word for word in self.args.only.split(",") if word]
        for file in sorted(files):
            if not words or any(word in file for word in words):
                copy = self.args.cache / "pixels" / f"{name}-{pathlib.Path(file).stem}.png"
                if not copy.exists():
                    image = Image.open(self.args.pictures / name / file).convert("RGB")
                    image.info.clear()
                    part = copy.with_suffix(f".{os.getpid()}.png")
                    image.save(part)
                    part.rename(copy)
                yield copy

    def ours(self, name, picture, ratio):
        program, own, variables, build = self.programs[name]
        options = ["--ratio", str(ratio), *own, *shlex.split(self.args.options)]

        def work():
            with tempfile.TemporaryDirectory() as folder:
                file, back = pathlib.Path(folder, "a.ssplat"), pathlib.Path(folder, "a.png")
                seconds = run([program, "--threads", "1", "encode", picture, file, "--quiet", "--force", *options], variables)[1]
                run([program, "decode", file, back, "--quiet"])
                made = numpy.asarray(Image.open(back).convert("RGB"))
                found = ringing(numpy.asarray(Image.open(picture)), made)
                return {"bytes": file.stat().st_size, "seconds": seconds} | measured(self.measure, picture, file) | found
        return self.cache.kept(f"ours {build} {variables or ''} {picture.name} {options}", work)

    def avif(self, picture, ratio):
        """Returns the measures of the largest AVIF file of at most the bytes of the ratio."""
        def work():
            image = Image.open(picture)
            room = image.width * image.height * 3 / float(ratio)

            def encoded(quality):
                file = io.BytesIO()
                image.save(file, "AVIF", quality=quality, speed=self.args.avif_speed, max_threads=1, advanced={"tune": "iq"})
                return file.getvalue()
            low, high, best = 0, 96, encoded(0)
            while high - low > 1:
                middle = (low + high) // 2
                file = encoded(middle)
                low, high, best = (middle, high, file) if len(file) <= room else (low, middle, best)
            made = Image.open(io.BytesIO(best)).convert("RGB")
            return {"bytes": len(best)} | ringing(numpy.asarray(image), numpy.asarray(made))
        return self.cache.kept(f"avif {self.args.avif_speed} {picture.name} {ratio}", work)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pictures", type=pathlib.Path)
    parser.add_argument("programs", nargs="+", metavar="NAME=PROGRAM")
    parser.add_argument("--sets", default="kodak,cid22,clic")
    parser.add_argument("--ratios", default="50,100")
    parser.add_argument("--half", choices=["choose", "judge", "all"], default="all")
    parser.add_argument("--only", default="", help="pictures whose names contain one of these words, separated by commas")
    parser.add_argument("--options", default="", help="further options of every program's encode")
    parser.add_argument("--no-avif", action="store_true")
    parser.add_argument("--avif-speed", type=int, default=6)
    parser.add_argument("--cache", type=pathlib.Path, default=root / "target/ringing")
    parser.add_argument("--each", action="store_true", help="print every picture")
    lab = Lab(parser.parse_args())
    args, names = lab.args, list(lab.programs)
    for set_name in args.sets.split(","):
        for ratio in args.ratios.split(","):
            rows = []
            for picture in lab.pictures(set_name):
                other = {"mean": None, "p99": None} if args.no_avif else lab.avif(picture, ratio)
                rows.append((picture.stem, {name: lab.ours(name, picture, ratio) for name in names}, other))
            grounds = [row for row in rows if row[1][names[0]]["p99"] is not None]
            avif_p99 = mean([other["p99"] for *_, other in grounds])
            print(f"{set_name} {ratio}: {len(rows)} pictures, {len(grounds)} with flat ground; AVIF {avif_p99:.2f}")
            for name in names:
                of = {key: mean([row[name][key] for _, row, _ in rows]) for key in ["ssimulacra2", "butteraugli", "psnr", "seconds"]}
                p99 = mean([row[name]["p99"] for _, row, _ in grounds])
                line = f"    {name:10} p99 {p99:.2f} mean {mean([row[name]['mean'] for _, row, _ in grounds]):.3f}"
                if not args.no_avif:
                    worst = max((row[name]["p99"] / other["p99"], stem) for stem, row, other in grounds)
                    over = sum(row[name]["p99"] > 1.5 * other["p99"] for _, row, other in grounds)
                    line += f" = {p99 / avif_p99:.2f} x AVIF, at most {worst[0]:.2f} ({worst[1][-16:]}), {over} above 1.5"
                line += f" | SSIMULACRA2 {of['ssimulacra2']:.2f} Butteraugli {of['butteraugli']:.3f} PSNR {of['psnr']:.2f} CPU {of['seconds']:.2f} s"
                if name != names[0]:
                    gains = [(row[name]["ssimulacra2"] - row[names[0]]["ssimulacra2"], stem) for stem, row, _ in rows]
                    first = {key: mean([row[names[0]][key] for _, row, _ in rows]) for key in ["butteraugli", "seconds"]}
                    line += f" | {mean([gain for gain, _ in gains]):+.2f} (worst {min(gains)[0]:+.2f} {min(gains)[1][-12:]}) {of['butteraugli'] - first['butteraugli']:+.3f} x{of['seconds'] / first['seconds']:.2f}"
                print(line, flush=True)
            if args.each:
                for stem, row, other in grounds:
                    print(f"    {stem[-24:]:24} AVIF {other['p99'] or 0:.2f}  " + "  ".join(f"{name} {row[name]['p99']:.2f}/{row[name]['ssimulacra2']:.1f}" for name in names), flush=True)


if __name__ == "__main__":
    main()
