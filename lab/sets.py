#!/usr/bin/env python3
"""Compares encoders on whole sets of pictures: programs with each other, and with AVIF (tune=iq), JPEG XL and WebP at
equal bytes.

    python lab/sets.py PICTURES old=target/old/ssplat new=target/release/ssplat
    python lab/sets.py PICTURES new=target/release/ssplat --sets clic --ratios 50,100 --half choose --options "--effort 3"
    python lab/sets.py PICTURES ssplat=target/release/ssplat --shares off,0.1,0.25,0.5,0.75 --table shares.txt
    python lab/sets.py PICTURES ssplat=target/release/ssplat --half judge --page --efforts 1,2,3,5,7
    python lab/sets.py PICTURES ssplat=target/release/ssplat --half judge --page --sets large --crop 2048 --ratios 50,200
    python lab/sets.py PICTURES "7=target/release/ssplat --tune psnr --effort 7" --half judge --sets kodak --no-avif --vvc

PICTURES contains one folder for each set in lab/sets.json. That file divides each set into a half for choosing constants of
the encoder and a half for evaluating them. A program may have its own options and environment variables: "wide=target/release/ssplat --detail 0.5", "slow=RATE=0.5 target/release/ssplat".

Pictures are first copied without their metadata, so that all codecs store only pixels. The programs encode each picture in turn, on
one thread. `compare` of the first program measures all files. Results are cached in --cache by the hash of the program, so that an
interrupted command can be continued. For each set and ratio, the command prints the means of every program, its gain over the first
program, and its lead in SSIMULACRA2 over the better of AVIF 4:2:0 and 4:4:4, interpolated to its bytes. With --vvc, it
also prints the lead in PSNR over vvenc (medium), interpolated to its bytes from docs/kodak-modern.csv.

--shares encodes each picture with the first program at each of these values of --detail and with its own choice, and writes a table of
the results. lab/fit_division.py fits the constants of src/constants/allocation.rs.

--page writes a table of each set into docs/BENCHMARKS.md and the chart docs/sets.svg: the first program beside AVIF, JPEG
XL (effort 7) and WebP (method 6). The chart is written if all four of its sets are measured. --efforts writes the table of
encoding times, alone or with --page, and fails if another effort, or a mixture of two others, gives more for the time of one. Both need Pillow 12 or newer and the package pillow-jxl-plugin.
"""
import argparse, csv, json, os, pathlib, shlex, sys, tempfile

import set_tables
from other_codecs import MEASURES, Cache, Files, at, avif, mean, measured, programs, run
from set_tables import leads, stem_of

root = pathlib.Path(__file__).resolve().parent.parent


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pictures", type=pathlib.Path)
    parser.add_argument("programs", nargs="+", metavar="NAME=PROGRAM")
    parser.add_argument("--sets", default=",".join(set_tables.CHART), help="kodak, cid22, graphics, clic, large or screens, separated by commas; by default all but large")
    parser.add_argument("--half", choices=["choose", "judge", "all"], default="all")
    parser.add_argument("--only", default="", help="pictures whose names contain one of these words, separated by commas")
    parser.add_argument("--ratios", help="ratios, or qualities such as q70; by default 20,50,100,200, and those of lab/set_tables.py with --page")
    parser.add_argument("--options", default="", help="further options of every program's encode")
    parser.add_argument("--kind", choices=["rgb", "grey", "alpha", "16"], default="rgb", help="converts the pictures: to grey, to an oval on nothing, or to 16 bits per sample; without AVIF")
    parser.add_argument("--crop", type=int, default=0, help="encode only a square of this side in the middle of each picture")
    parser.add_argument("--no-avif", action="store_true")
    parser.add_argument("--vvc", action="store_true", help="compare the PSNR with VVC; only for kodak")
    parser.add_argument("--avif-speed", type=int, default=6)
    parser.add_argument("--cache", type=pathlib.Path, default=root / "target/sets")
    parser.add_argument("--repeat", type=int, default=1, help="number of encodes of each file; the time is that of the fastest")
    parser.add_argument("--each", action="store_true", help="print every picture")
    parser.add_argument("--shares", default="", help="values of --detail to try, separated by commas")
    parser.add_argument("--table", type=pathlib.Path, help="file to which the table of shares is written")
    parser.add_argument("--page", action="store_true", help="write the tables of the first program into docs/BENCHMARKS.md, and docs/sets.svg")
    parser.add_argument("--efforts", default="", help="write the table of encoding times at these efforts, separated by commas, into docs/BENCHMARKS.md")
    parser.add_argument("--commit", help="with --page or --efforts: the commit of the program; by default that of this folder")
    args = parser.parse_args()
    if not args.page:
        args.ratios = args.ratios or "20,50,100,200"
    # The AVIF files of `avif` are RGB with 8 bits.
    args.no_avif |= args.kind != "rgb"
    return args


class Lab:
    def __init__(self, args):
        self.args = args
        self.programs = programs(args.programs)
        self.measure = next(iter(self.programs.values()))[0]
        self.cache = Cache(args.cache)
        (args.cache / "pixels").mkdir(exist_ok=True)
        self.files = Files(self.cache, self.measure)

    def pictures(self, name):
        """Returns the pictures of a set, without metadata."""
        halves = json.loads((root / "lab/sets.json").read_text())[name]
        words = [word for word in self.args.only.split(",") if word]
        for file in sorted(sum((halves[half] for half in halves if self.args.half in (half, "all")), [])):
            if not words or any(word in file for word in words):
                yield self.pixels(self.args.pictures / name / file)

    def pixels(self, picture):
        side, kind = self.args.crop, self.args.kind
        name = f"{picture.parent.name}-{picture.stem}{f'-{side}' if side else ''}{'' if kind == 'rgb' else '-' + kind}"
        copy = self.args.cache / "pixels" / f"{name}.{'ppm' if kind == '16' else 'png'}"
        if not copy.exists():
            from PIL import Image, ImageDraw
            Image.MAX_IMAGE_PIXELS = None
            image = Image.open(picture).convert("RGB")
            if side:
                left, top = max(0, (image.width - side) // 2), max(0, (image.height - side) // 2)
                image = image.crop((left, top, min(image.width, left + side), min(image.height, top + side)))
            image.info.clear()
            part = copy.with_suffix(f".{os.getpid()}{copy.suffix}")
            if kind == "16":
                # 257 v is the 16-bit value of the 8-bit value v: the same byte twice.
                samples = image.tobytes()
                part.write_bytes(b"P6 %d %d 65535\n" % image.size + bytes(b for v in samples for b in (v, v)))
            else:
                if kind == "grey":
                    image = image.convert("L")
                if kind == "alpha":
                    # Four times as large and reduced, so that its edge is smooth.
                    oval = Image.new("L", (4 * image.width, 4 * image.height))
                    ImageDraw.Draw(oval).ellipse((oval.width // 20, oval.height // 20, oval.width * 19 // 20, oval.height * 19 // 20), 255)
                    image.putalpha(oval.resize(image.size, Image.Resampling.BOX))
                image.save(part)
            part.rename(copy)
        return copy

    def ours(self, name, picture, ratio, more=()):
        program, own, variables, build = self.programs[name]
        target = ["--quality", ratio[1:]] if str(ratio).startswith("q") else ["--ratio", str(ratio)]
        options = [*target, *own, *shlex.split(self.args.options), *more]

        def work():
            with tempfile.TemporaryDirectory() as folder:
                file = pathlib.Path(folder, "a.ssplat")
                command = [program, "--threads", "1", "encode", picture, file, "--quiet", "--force", *options]
                seconds = min(run(command, variables)[1] for _ in range(self.args.repeat))
                return {"bytes": file.stat().st_size, "seconds": seconds} | measured(self.measure, picture, file)
        return self.cache.kept(f"{build} {variables or ''} {picture.name} {options}", work)


def vvc_points():
    """Returns the bytes and PSNR of VVC's files, and of the exact ratios between them, by the name of the picture."""
    points = {}
    with (root / "docs/kodak-modern.csv").open() as file:
        for row in csv.DictReader(file):
            if row["codec"] == "vvc-medium":
                exact = 768 * 512 * 3 / float(row["target_cr"])
                pairs = ((row["bytes"], row["psnr"]), (exact, row["psnr_at_target"]))
                points.setdefault(row["image"].removesuffix(".png"), []).extend({"bytes": float(size), "psnr": float(psnr)} for size, psnr in pairs)
    return points


def compare(lab):
    args = lab.args
    vvc = vvc_points() if args.vvc else {}
    names = list(lab.programs)
    print("set ratio n | program bytes PSNR SSIMULACRA2 Butteraugli MS-SSIM CPU-s | gain over the first: PSNR SSIMULACRA2 (worst picture) Butteraugli time | lead over AVIF in SSIMULACRA2 (n, ahead, worst), Butteraugli, MS-SSIM")
    for set_name in args.sets.split(","):
        for ratio in args.ratios.split(","):
            rows = []
            for picture in lab.pictures(set_name):
                row = {name: lab.ours(name, picture, ratio) for name in names}
                best = {} if args.no_avif else {name: lab.files.best(picture, avif(args.avif_speed), row[name]["bytes"]) for name in names}
                rows.append((stem_of(picture), row, best))
            for name in names:
                of = [row[name] for _, row, _ in rows]
                means = {key: mean([r[key] for r in of]) for key in ["bytes", *MEASURES, "seconds"]}
                line = f"{set_name} {ratio} {len(rows)} | {name} {means['bytes']:.0f} {means['psnr']:.2f} {means['ssimulacra2']:.2f} {means['butteraugli']:.3f} {means['ms_ssim']:.4f} {means['seconds']:.2f}"
                if name != names[0]:
                    gains = [(row[name]["ssimulacra2"] - row[names[0]]["ssimulacra2"], stem) for stem, row, _ in rows]
                    first = {key: mean([row[names[0]][key] for _, row, _ in rows]) for key in [*MEASURES, "seconds"]}
                    worst = min(gains)
                    line += f" | {means['psnr'] - first['psnr']:+.3f} {mean([g for g, _ in gains]):+.2f} ({worst[0]:+.1f} {worst[1][:14]}) {means['butteraugli'] - first['butteraugli']:+.3f} {means['seconds'] / first['seconds']:.2f}"
                if not args.no_avif:
                    ahead = leads([(stem, row[name], best[name]) for stem, row, best in rows])
                    if ahead:
                        over = {key: mean([lead[key] for _, lead in ahead]) for key in MEASURES}
                        worst = min(ahead, key=lambda lead: lead[1]["ssimulacra2"])
                        line += f" | AVIF {over['ssimulacra2']:+.2f} ({len(ahead)}, {sum(lead['ssimulacra2'] > 0 for _, lead in ahead)} ahead, {worst[1]['ssimulacra2']:+.1f} {worst[0][:14]}) {over['butteraugli']:+.3f} {over['ms_ssim']:+.4f}"
                if vvc:
                    over = [(row[name]["psnr"] - at(vvc[stem], row[name]["bytes"], "psnr"), stem) for stem, row, _ in rows]
                    line += f" | VVC {mean([lead for lead, _ in over]):+.3f} dB ({min(over)[0]:+.2f} {min(over)[1]})"
                print(line, flush=True)
            if args.each:
                for stem, row, best in rows:
                    text = [f"{name} {row[name]['psnr']:.2f}/{row[name]['ssimulacra2']:.1f}" for name in names]
                    last = best.get(names[-1])
                    text += [f"AVIF {last['psnr']:.2f}/{last['ssimulacra2']:.1f}"] if last else []
                    print(f"    {stem[:18]:18} " + "  ".join(text), flush=True)


def shares(lab):
    args, name = lab.args, next(iter(lab.programs))
    lines = []
    for set_name in args.sets.split(","):
        for ratio in args.ratios.split(","):
            short = []
            for picture in lab.pictures(set_name):
                auto = lab.ours(name, picture, ratio)
                tried = {share: lab.ours(name, picture, ratio, ["--detail", share]) for share in args.shares.split(",")}
                best = max(tried, key=lambda share: tried[share]["ssimulacra2"])
                short.append(tried[best]["ssimulacra2"] - auto["ssimulacra2"])
                text = " ".join(f"{share}:{made['psnr']:.2f}/{made['ssimulacra2']:.1f}" for share, made in {"auto": auto, **tried}.items())
                lines.append(f"{set_name} {ratio} {stem_of(picture)[:18]:18} {text} | best {best} {short[-1]:+.1f}")
                print(lines[-1], flush=True)
            lines.append(f"{set_name} {ratio} mean: the best share has {mean(short):+.2f} over auto, {max(short):+.1f} at most")
            print(lines[-1], flush=True)
    if args.table:
        args.table.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    lab = Lab(arguments())
    if lab.args.page or lab.args.efforts:
        sys.exit(1 if set_tables.write(lab, root) else 0)
    elif lab.args.shares:
        shares(lab)
    else:
        compare(lab)
