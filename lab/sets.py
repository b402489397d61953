#!/usr/bin/env python3
"""Compares encoders on whole sets of pictures: programs with each other, and with AVIF (tune=iq) at equal bytes.

    python lab/sets.py PICTURES old=target/old/ssplat new=target/release/ssplat
    python lab/sets.py PICTURES new=target/release/ssplat --sets clic --ratios 50,100 --half choose --options "--effort 3"
    python lab/sets.py PICTURES ssplat=target/release/ssplat --shares off,0.1,0.25,0.5,0.75 --table shares.txt

PICTURES contains one folder for each set in lab/sets.json. That file divides each set into a half for choosing constants of
the encoder and a half for evaluating them. A program may have its own options and environment variables: "wide=target/release/ssplat --detail 0.5", "slow=RATE=0.5 target/release/ssplat".

Pictures are first copied without their metadata, so that all codecs store only pixels. The programs encode each picture in turn, on
one thread. `compare` of the first program measures all files. Results are cached in --cache by the hash of the program, so that an
interrupted command can be continued. For each set and ratio, the command prints the means of every program, its gain over the first
program, and its lead in SSIMULACRA2 over the better of AVIF 4:2:0 and 4:4:4, interpolated to its bytes.

--shares encodes each picture with the first program at each of these values of --detail and with its own choice, and writes a table of
the results, from which the constants of src/encode/layer/divide.rs are chosen.
"""
import argparse, hashlib, json, math, os, pathlib, shlex, statistics, subprocess, sys, tempfile

root = pathlib.Path(__file__).resolve().parent.parent
MEASURES = ["psnr", "ssimulacra2", "butteraugli", "ms_ssim"]
AVIF_QUALITIES = [4, 8, 12, 16, 20, 25, 30, 36, 42, 48, 54, 60, 66, 72, 78, 84, 90, 95]
SUBSAMPLINGS = ["4:2:0", "4:4:4"]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pictures", type=pathlib.Path)
    parser.add_argument("programs", nargs="+", metavar="NAME=PROGRAM")
    parser.add_argument("--sets", default="kodak,cid22,graphics,clic")
    parser.add_argument("--half", choices=["choose", "judge", "all"], default="all")
    parser.add_argument("--only", default="", help="pictures whose names contain one of these words, separated by commas")
    parser.add_argument("--ratios", default="20,50,100,200")
    parser.add_argument("--options", default="", help="further options of every program's encode")
    parser.add_argument("--kind", choices=["rgb", "grey", "alpha", "16"], default="rgb", help="converts the pictures: to grey, to an oval on nothing, or to 16 bits per sample; without AVIF")
    parser.add_argument("--crop", type=int, default=0, help="encode only a square of this side in the middle of each picture")
    parser.add_argument("--no-avif", action="store_true")
    parser.add_argument("--avif-speed", type=int, default=6)
    parser.add_argument("--cache", type=pathlib.Path, default=root / "target/sets")
    parser.add_argument("--repeat", type=int, default=1, help="number of encodes of each file; the time is that of the fastest")
    parser.add_argument("--each", action="store_true", help="print every picture")
    parser.add_argument("--shares", default="", help="values of --detail to try, separated by commas")
    parser.add_argument("--table", type=pathlib.Path, help="file to which the table of shares is written")
    args = parser.parse_args()
    # The AVIF files of `avif` are RGB with 8 bits.
    args.no_avif |= args.kind != "rgb"
    return args


def run(command, variables={}):
    """Runs a command and returns its output and CPU seconds."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        child = subprocess.Popen([str(part) for part in command], stdout=out, stderr=err, env=os.environ | variables)
        _, status, used = os.wait4(child.pid, 0)
        out.seek(0), err.seek(0)
        if status:
            sys.exit(f"{' '.join(map(str, command))}: {err.read().decode()}")
        return out.read().decode(), used.ru_utime + used.ru_stime


class Lab:
    def __init__(self, args):
        self.args = args
        self.programs = {}
        for text in args.programs:
            name, _, command = text.partition("=")
            words = shlex.split(command)
            variables = dict(word.split("=", 1) for word in words if "=" in word.split("/")[0])
            path, *options = words[len(variables):]
            program = pathlib.Path(path).resolve()
            self.programs[name] = (program, options, variables, hashlib.sha256(program.read_bytes()).hexdigest()[:16])
        self.measure = next(iter(self.programs.values()))[0]
        args.cache.mkdir(parents=True, exist_ok=True)
        (args.cache / "pixels").mkdir(exist_ok=True)

    def kept(self, name, work):
        """Returns the result of `work`, from the cache if it is there."""
        path = self.args.cache / (hashlib.sha256(name.encode()).hexdigest()[:24] + ".json")
        if not path.exists():
            made = work()
            part = path.with_suffix(f".{os.getpid()}")
            part.write_text(json.dumps(made))
            part.rename(path)
        return json.loads(path.read_text())

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

    def compared(self, original, made):
        found = json.loads(run([self.measure, "--threads", "1", "compare", original, made, "--json"])[0])
        return {key: found[key] for key in MEASURES}

    def ours(self, name, picture, ratio, more=()):
        program, own, variables, build = self.programs[name]
        options = ["--ratio", str(ratio), *own, *shlex.split(self.args.options), *more]

        def work():
            with tempfile.TemporaryDirectory() as folder:
                file = pathlib.Path(folder, "a.ssplat")
                command = [program, "--threads", "1", "encode", picture, file, "--quiet", "--force", *options]
                seconds = min(run(command, variables)[1] for _ in range(self.args.repeat))
                return {"bytes": file.stat().st_size, "seconds": seconds} | self.compared(picture, file)
        return self.kept(f"{build} {variables or ''} {picture.name} {options}", work)

    def avif(self, picture, ratios):
        """Returns AVIF files with sizes around these ratios, by subsampling."""
        from PIL import Image
        speed = self.args.avif_speed
        image = Image.open(picture)
        raw = image.width * image.height * 3
        found = {}
        for subsampling in SUBSAMPLINGS:
            def encode(quality, file):
                options = {"speed": speed, "max_threads": 1, "subsampling": subsampling, "advanced": {"tune": "iq"}}
                image.save(file, "AVIF", quality=quality, **options)

            def sizes():
                with tempfile.TemporaryDirectory() as folder:
                    file, sizes = pathlib.Path(folder, "a.avif"), {}
                    for quality in AVIF_QUALITIES:
                        encode(quality, file)
                        sizes[quality] = file.stat().st_size
                        if sizes[quality] > raw / 15:
                            break
                    return sizes
            key = f"avif {picture.name} {subsampling} {speed}"
            ladder = sorted((size, int(quality)) for quality, size in self.kept(key + " sizes", sizes).items())
            wanted = set()
            for ratio in ratios:
                size = raw / ratio
                wanted |= {max((p for p in ladder if p[0] <= size), default=ladder[0]), min((p for p in ladder if p[0] >= size), default=ladder[-1])}
                # The files of ssplat are slightly smaller than the ratio allows.
                wanted |= {max((p for p in ladder if p[0] <= .97 * size), default=ladder[0])}
            points = []
            for _, quality in sorted(wanted):
                def point():
                    with tempfile.TemporaryDirectory() as folder:
                        file, back = pathlib.Path(folder, "a.avif"), pathlib.Path(folder, "a.png")
                        encode(quality, file)
                        Image.open(file).convert("RGB").save(back, compress_level=1)
                        return {"bytes": file.stat().st_size} | self.compared(picture, back)
                points.append(self.kept(f"{key} {quality}", point))
            found[subsampling] = points
        return found


def at(points, size, key):
    """Interpolates a measure at a size between the two nearest files, over the logarithm of the size. Returns `None` outside."""
    points = sorted(points, key=lambda p: p["bytes"])
    for a, b in zip(points, points[1:]):
        if a["bytes"] <= size <= b["bytes"]:
            t = math.log(size / a["bytes"]) / math.log(b["bytes"] / a["bytes"]) if b["bytes"] > a["bytes"] else 0
            return a[key] + t * (b[key] - a[key])
    return None


def best_avif(avif, size):
    """Returns the measures of the better of both subsamplings at a size."""
    found = [{key: at(points, size, key) for key in MEASURES} for points in avif.values()]
    found = [f for f in found if f["ssimulacra2"] is not None]
    return max(found, key=lambda f: f["ssimulacra2"], default=None)


def mean(values):
    return statistics.fmean(values) if values else float("nan")


def compare(lab):
    args = lab.args
    names = list(lab.programs)
    print("set ratio n | program bytes PSNR SSIMULACRA2 Butteraugli MS-SSIM CPU-s | gain over the first: PSNR SSIMULACRA2 (worst picture) Butteraugli time | lead over AVIF in SSIMULACRA2 (n, ahead, worst), Butteraugli, MS-SSIM")
    for set_name in args.sets.split(","):
        for ratio in args.ratios.split(","):
            rows = []
            for picture in lab.pictures(set_name):
                row = {name: lab.ours(name, picture, ratio) for name in names}
                avif = None if args.no_avif else lab.avif(picture, [float(ratio)])
                rows.append((picture.stem.split("-", 1)[1], row, avif))
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
                    leads = []
                    for stem, row, avif in rows:
                        best = best_avif(avif, row[name]["bytes"])
                        if best:
                            leads.append((row[name]["ssimulacra2"] - best["ssimulacra2"], stem, row[name]["butteraugli"] - best["butteraugli"], row[name]["ms_ssim"] - best["ms_ssim"]))
                    if leads:
                        line += f" | AVIF {mean([l[0] for l in leads]):+.2f} ({len(leads)}, {sum(l[0] > 0 for l in leads)} ahead, {min(leads)[0]:+.1f} {min(leads)[1][:14]}) {mean([l[2] for l in leads]):+.3f} {mean([l[3] for l in leads]):+.4f}"
                print(line, flush=True)
            if args.each:
                for stem, row, avif in rows:
                    text = [f"{name} {row[name]['psnr']:.2f}/{row[name]['ssimulacra2']:.1f}" for name in names]
                    best = None if args.no_avif else best_avif(avif, row[names[-1]]["bytes"])
                    text += [f"AVIF {best['psnr']:.2f}/{best['ssimulacra2']:.1f}"] if best else []
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
                lines.append(f"{set_name} {ratio} {picture.stem.split('-', 1)[1][:18]:18} {text} | best {best} {short[-1]:+.1f}")
                print(lines[-1], flush=True)
            lines.append(f"{set_name} {ratio} mean: the best share has {mean(short):+.2f} over auto, {max(short):+.1f} at most")
            print(lines[-1], flush=True)
    if args.table:
        args.table.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    lab = Lab(arguments())
    shares(lab) if lab.args.shares else compare(lab)
