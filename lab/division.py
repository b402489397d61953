#!/usr/bin/env python3
"""Measures what the encoder loses by its division of the bytes between the Gaussians and the layers.

    python lab/division.py target/release/ssplat shared/images/kodak/*.png shared/images/clic/*.png
    python lab/division.py target/release/ssplat PICTURES... --half judge --ratios 50,200 --table division.txt
    python lab/division.py target/release/ssplat PICTURES... --thumbnail 128 --sizes 300,600,1200,2500,4000

Each picture is encoded at each ratio with `--detail auto` and with each of --shares. The loss of `auto` is the distance of its
SSIMULACRA2 from the best of them; a negative loss is a gain. Pictures in the same folder are a set, for which the command
prints the mean and the largest loss, and how often each share is the best. --sizes takes bytes instead of ratios, for
small files. --thumbnail reduces each picture to that many pixels along its longer side, and --crop cuts a square out of its
middle. With --half, only the pictures of that half in lab/sets.json are used.

--shares-of names an earlier program whose encodes with --shares are used, if only the choice of `auto` has changed since.
The summaries also contain the CPU seconds of `auto`.

Encodes are cached by the hash of the program, so that an interrupted command can be continued.
"""
import argparse, collections, json, os, pathlib, shlex, tempfile

from PIL import Image

from other_codecs import Cache, mean, measured, programs, run

root = pathlib.Path(__file__).resolve().parent.parent
# Side below which pictures have no SSIMULACRA2; PSNR counts instead.
LEAST_SIDE = 8


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", help="the program, which may have its own options and environment variables, as in lab/sets.py")
    parser.add_argument("pictures", type=pathlib.Path, nargs="+")
    parser.add_argument("--ratios", default="20,50,100,200")
    parser.add_argument("--sizes", help="sizes of files in bytes, instead of ratios")
    parser.add_argument("--shares", default="off,0.05,0.1,0.2,0.3,0.5,0.7")
    parser.add_argument("--shares-of", help="another program, which encodes with the shares")
    parser.add_argument("--half", choices=["choose", "judge"])
    parser.add_argument("--thumbnail", type=int, default=0)
    parser.add_argument("--crop", type=int, default=0)
    parser.add_argument("--options", default="", help="further options of every encode")
    parser.add_argument("--measure", choices=["ssimulacra2", "psnr"], default="ssimulacra2")
    parser.add_argument("--cache", type=pathlib.Path, default=root / "target/division")
    parser.add_argument("--table", type=pathlib.Path, help="file to which the results are written as well")
    return parser.parse_args()


class Lab:
    def __init__(self, args):
        self.args, self.cache = args, Cache(args.cache)
        both = programs([f"auto={args.program}", f"shares={args.shares_of or args.program}"])
        self.auto, self.shares = both["auto"], both["shares"]
        (args.cache / "pixels").mkdir(exist_ok=True)

    def sets(self):
        """Returns the pictures by the name of their folder."""
        halves, found = json.loads((root / "lab/sets.json").read_text()), collections.defaultdict(list)
        for path in sorted(self.args.pictures):
            name = path.parent.name
            if self.args.half is None or path.name in halves.get(name, {}).get(self.args.half, []):
                found[name].append(path)
        return found

    def pixels(self, path):
        """Returns a copy of the picture without metadata, reduced and cropped."""
        thumbnail, crop = self.args.thumbnail, self.args.crop
        copy = self.args.cache / "pixels" / f"{path.parent.name}-{path.stem}-{thumbnail}-{crop}.png"
        if not copy.exists():
            image = Image.open(path).convert("RGB")
            if crop:
                left, top = max(0, (image.width - crop) // 2), max(0, (image.height - crop) // 2)
                image = image.crop((left, top, min(image.width, left + crop), min(image.height, top + crop)))
            if thumbnail:
                image.thumbnail((thumbnail, thumbnail), Image.Resampling.LANCZOS)
            image.info.clear()
            part = copy.with_suffix(f".{os.getpid()}.png")
            image.save(part)
            part.rename(copy)
        return copy

    def made(self, picture, size, share):
        """Encodes a picture with a value of --detail and returns the measures of the file."""
        program, own, variables, build = self.auto if share == "auto" else self.shares
        options = [*size, *own, *shlex.split(self.args.options), "--detail", share]

        def work():
            with tempfile.TemporaryDirectory() as folder:
                file = pathlib.Path(folder, "a.ssplat")
                command = [program, "--threads", "1", "encode", picture, file, "--quiet", "--force", *options]
                seconds = run(command, variables)[1]
                return {"bytes": file.stat().st_size, "seconds": seconds} | measured(program, picture, file)
        return self.cache.kept(f"{build} {variables or ''} {picture.name} {options}", work)


def main():
    lab = Lab(arguments())
    args, lines = lab.args, []

    def write(line):
        lines.append(line)
        print(line, flush=True)
        if args.table:
            args.table.write_text("\n".join(lines) + "\n")
    sizes = [("--bytes", size) for size in args.sizes.split(",")] if args.sizes else [("--ratio", ratio) for ratio in args.ratios.split(",")]
    for name, pictures in lab.sets().items():
        for size in sizes:
            losses, seconds, best = [], [], collections.Counter()
            for path in pictures:
                picture = lab.pixels(path)
                with Image.open(picture) as image:
                    measure = args.measure if min(image.size) >= LEAST_SIDE else "psnr"
                made = {share: lab.made(picture, size, share) for share in ["auto", *args.shares.split(",")]}
                found = {share: of[measure] for share, of in made.items()}
                seconds.append(made["auto"]["seconds"])
                most = max((share for share in found if share != "auto"), key=found.get)
                losses.append((found[most] - found["auto"], path.stem))
                best[most] += 1
                text = " ".join(f"{share} {value:.1f}" for share, value in found.items())
                write(f"{name} {size[1]} {path.stem[-24:]:24} {text} | {most} is {losses[-1][0]:+.1f}")
            counts = ", ".join(f"{share} {count}" for share, count in best.most_common())
            write(f"{name} {size[1]}: {len(losses)} pictures, mean loss {mean([loss for loss, _ in losses]):.2f}, largest {max(losses)[0]:.2f} ({max(losses)[1]}), {mean(seconds):.2f} s; best: {counts}")


if __name__ == "__main__":
    main()
