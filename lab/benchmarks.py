#!/usr/bin/env python3
"""Compares the codec with others and writes the tables of docs/BENCHMARKS.md, docs/benchmarks.csv, docs/quality.svg
and docs/speed.svg.

    cargo build --release
    python lab/benchmarks.py target/release/ssplat KODAK [--large PICTURE...] [--jobs N]
        [--only codecs,quality,efforts,speeds,tiny,large,decoders,lossless] [--screens PICTURE...]

It needs Pillow 12 or newer for JPEG, WebP and AVIF (tune=iq), and the package pillow-jxl-plugin for JPEG XL. The rows
of VVC come from docs/kodak-modern.csv, because its encoder cannot be installed from a package registry. KODAK is a
folder with kodim01.png to kodim23.png, of which the odd-numbered ones are measured. All files are measured by
`ssplat compare`. The table of decoders (`--only decoders`) needs `cargo build --release -p ssplat-lab --example
decode_speed`, and the programs cwebp, dwebp, avifenc and avifdec. It crops the first picture of --large to 12
megapixels, and the second to 24. The table of decoders of files without loss (`--only lossless`) needs that example
and cwebp; it measures the pictures of --screens, repeated or cropped to 4 megapixels, and three photographs. Results are cached in target/benchmarks, so that an interrupted run can be continued. Seconds are CPU
seconds of one thread.
"""
import argparse, concurrent.futures, csv, dataclasses, hashlib, os, pathlib, sys, tempfile

from other_codecs import JPEG_XL, MEASURES, WEBP, Cache, Codec, at, avif, mean, measured
from other_codecs import run as run_with
from report import commit_of, measured_when, number, svg, table, write_tables

root = pathlib.Path(__file__).resolve().parent.parent
page, rows_file = root / "docs/BENCHMARKS.md", root / "docs/benchmarks.csv"
chart, speed_chart = root / "docs/quality.svg", root / "docs/speed.svg"
RATIOS = [20, 50, 100, 200, 500]
# Quality settings of the other codecs, from small files to large ones.
OTHERS = {
    "jpeg": Codec("jpeg", "progressive", {"optimize": True, "progressive": True}, (4, 8, 14, 35, 55, 88)),
    "webp": dataclasses.replace(WEBP[0], qualities=(0, 5, 15, 50, 70, 93)),
    "avif": dataclasses.replace(avif(3)[0], qualities=(0, 4, 10, 18, 40, 66, 80, 88, 94)),
    "jxl": dataclasses.replace(JPEG_XL[0], qualities=(1, 4, 10, 20, 50, 65, 90, 95)),
}
# Quality settings of AVIF around a ratio of 50, for each of the four pictures of the tables of efforts and speeds, and
# the speeds of aom. Speeds 0 to 2 take up to four times as long as 3, and gain at most 0.2 points.
AROUND_50 = {5: (26, 31, 36), 13: (21, 27, 34), 15: (40, 48, 57), 23: (50, 58, 67)}
AVIF_SPEEDS = (10, 8, 6, 5, 4, 3)

args = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
args.add_argument("program", type=pathlib.Path)
args.add_argument("kodak", type=pathlib.Path)
args.add_argument("--large", type=pathlib.Path, nargs="*", default=[])
args.add_argument("--screens", type=pathlib.Path, nargs="*", default=[])
args.add_argument("--jobs", type=int, default=2)
args.add_argument("--only", default="quality,efforts,speeds,tiny,large")
args = args.parse_args()
args.program = args.program.resolve()
only = args.only.split(",")
cache = root / "target/benchmarks"
kept = Cache(cache).kept
build = hashlib.sha256(args.program.read_bytes()).hexdigest()[:16]
commit = commit_of(root)
pictures = [args.kodak / f"kodim{k:02}.png" for k in range(1, 24, 2)]


def run(command):
    return run_with(command, {"RAYON_NUM_THREADS": "1"})


def compared(original, made):
    return measured(args.program, original, made)


def ours(picture, options, decodes=0):
    def work():
        with tempfile.TemporaryDirectory() as folder:
            file, out = pathlib.Path(folder, "a.ssplat"), pathlib.Path(folder, "a.ppm")
            _, seconds, memory = run([args.program, "encode", picture, file, "--quiet", *options])
            row = {"bytes": file.stat().st_size, "encode_s": seconds, "encode_mb": memory} | compared(picture, file)
            if decodes:
                row["decode_s"] = min(run([args.program, "decode", file, out, "--quiet"])[1] for _ in range(decodes))
                out.unlink()
                row["decode_mb"] = run([args.program, "decode", file, out, "--quiet"])[2]
            return row
    return kept(f"{build} {picture.name} {options} {decodes}", work)


def others(picture, name, quality, speed=3):
    codec = avif(speed)[0] if name == "avif" else OTHERS[name]

    def work():
        with tempfile.TemporaryDirectory() as folder:
            file, back = pathlib.Path(folder, f"a.{name}"), pathlib.Path(folder, "a.png")
            seconds = codec.timed(picture, quality, file, back)
            return {"bytes": file.stat().st_size} | seconds | compared(picture, back)
    return kept(f"{codec.key(picture, quality)} in its own process", work)


def each(jobs):
    with concurrent.futures.ThreadPoolExecutor(args.jobs) as pool:
        return list(pool.map(lambda job: job(), jobs))


tables, all_rows = {}, []


def modern():
    found = {}
    with open(root / "docs/kodak-modern.csv") as file:
        for row in csv.DictReader(file):
            # Some codecs do not reach some sizes.
            if not row["bytes"].isdigit():
                continue
            point = {"bytes": int(row["bytes"]), "psnr": float(row["psnr"]), "ms_ssim": float(row["msssim"]), "ssimulacra2": float(row["ssimulacra2"]), "butteraugli": float(row["butteraugli"])}
            point["encode_s"] = float(row["enc_cpu_s"])
            found.setdefault((row["codec"], row["image"], int(row["target_cr"])), point)
            if row["ss2_at_target"]:
                point["psnr_at"], point["ms_ssim_at"], point["ssimulacra2_at"] = (float(row[k]) if row[k] not in ("", "N/A") else float("nan") for k in ("psnr_at_target", "msssim_at_target", "ss2_at_target"))
    return found


def quality():
    jobs = []
    for picture in pictures:
        for ratio in RATIOS:
            for tune in ("iq", "psnr"):
                jobs.append((("ssplat" if tune == "iq" else "ssplat --tune psnr", picture, ratio), lambda p=picture, r=ratio, t=tune: ours(p, ["--ratio", str(r), "--tune", t], 5 if t == "iq" else 0)))
        for codec in OTHERS:
            for q in OTHERS[codec].qualities:
                jobs.append(((codec, picture, q), lambda p=picture, c=codec, q=q: others(p, c, q)))
    results = dict(zip([key for key, _ in jobs], each([job for _, job in jobs])))
    for (codec, picture, setting), row in results.items():
        all_rows.append({"image": picture.name, "codec": codec, "setting": setting} | row)
    today = modern()
    rows = []
    for ratio in RATIOS:
        base = [results["ssplat", p, ratio] for p in pictures]
        for name in ("ssplat", "ssplat --tune psnr"):
            of = [results[name, p, ratio] for p in pictures]
            rows.append([str(ratio), name, f"{mean(r['bytes'] for r in of):.0f}", *(number(mean(r[k] for r in of), d) for k, d in zip(MEASURES, (2, 4, 1, 2))), number(mean(r["encode_s"] for r in of), 1), ""])
        for name, label in (("jpeg", "JPEG"), ("webp", "WebP"), ("jxl", "JPEG XL"), ("avif", "AVIF tune=iq")):
            sizes = [r["bytes"] for r in base]
            points = [[results[name, p, q] for q in OTHERS[name].qualities] for p in pictures]
            found = {k: [at(ps, s, k) for ps, s in zip(points, sizes)] for k in MEASURES}
            if any(v is None for v in found["psnr"]):
                rows.append([str(ratio), label, "no files of that size", "", "", "", "", "", ""])
                continue
            ahead = sum(b["ssimulacra2"] > v for b, v in zip(base, found["ssimulacra2"]))
            rows.append([str(ratio), label, "as ssplat", *(number(mean(found[k]), d) for k, d in zip(MEASURES, (2, 4, 1, 2))), number(mean(r["encode_s"] for ps in points for r in ps), 2), f"{ahead} of 12"])
        for name, label in (("vvc-medium", "VVC, vvenc medium"),):
            of = [today.get((name, p.name, ratio)) for p in pictures]
            if any(r is None for r in of):
                continue
            at_size = [r.get("ssimulacra2_at", r["ssimulacra2"]) for r in of]
            ahead = sum(b["ssimulacra2"] > v for b, v in zip(base, at_size))
            rows.append([str(ratio), label, f"{mean(r['bytes'] for r in of):.0f}", number(mean(r.get("psnr_at", r["psnr"]) for r in of), 2), number(mean(r.get("ms_ssim_at", r["ms_ssim"]) for r in of), 4), number(mean(at_size), 1), number(mean(r["butteraugli"] for r in of), 2), number(mean(r["encode_s"] for r in of), 1), f"{ahead} of 12"])
    head = ["ratio", "codec", "bytes", "PSNR dB", "MS-SSIM", "SSIMULACRA2", "Butteraugli", "encode, CPU s", "pictures where ssplat's SSIMULACRA2 is higher"]
    tables["quality"] = table(head, rows, 2)
    # One line per codec: the measure against bits per pixel, each averaged over the pictures.
    lines = {}
    pixels = 768 * 512
    for name in ("ssplat",):
        lines[name] = [(8 * mean(results[name, p, r]["bytes"] for p in pictures) / pixels, mean(results[name, p, r]["ssimulacra2"] for p in pictures)) for r in RATIOS]
    for name, label in (("jpeg", "JPEG"), ("webp", "WebP"), ("avif", "AVIF tune=iq"), ("jxl", "JPEG XL")):
        lines[label] = [(8 * mean(results[name, p, q]["bytes"] for p in pictures) / pixels, mean(results[name, p, q]["ssimulacra2"] for p in pictures)) for q in OTHERS[name].qualities]
    for name, label in (("vvc-medium", "VVC"),):
        found = [[today.get((name, p.name, r)) for p in pictures] for r in RATIOS]
        lines[label] = [(8 * mean(r["bytes"] for r in of) / pixels, mean(r["ssimulacra2"] for r in of)) for of in found if all(of)]
    chart.write_text(svg(lines, (0.04, 2.0, (0.05, 0.1, 0.2, 0.5, 1, 2), "bits a pixel (24 over the ratio)"), (-30, 90, 20)))
    ratio_rows = []
    for ratio in RATIOS:
        of = [results["ssplat", p, ratio] for p in pictures]
        ratio_rows.append([str(ratio), *(number(1000 * mean(r["decode_s"] for r in of), 1),), number(max(r["decode_mb"] for r in of), 0), number(max(r["encode_mb"] for r in of), 0)])
    tables["decode"] = table(["ratio", "`ssplat decode` of 768 × 512, CPU ms, the program's start included", "MB at the peak", "MB at the peak of the encode"], ratio_rows, 0)


def codecs():
    """Measures the other codecs alone, which do not depend on the program."""
    each([lambda p=p, c=c, q=q: others(p, c, q) for p in pictures for c, codec in OTHERS.items() for q in codec.qualities])


def efforts():
    four = [args.kodak / f"kodim{k:02}.png" for k in (5, 13, 15, 23)]
    settings = [(ratio, effort) for ratio in (20, 50, 200) for effort in (1, 2, 3, 5, 7)]
    keys = [(p, r, e) for p in four for r, e in settings]
    results = dict(zip(keys, each([lambda p=p, r=r, e=e: ours(p, ["--ratio", str(r), "--effort", str(e)]) for p, r, e in keys])))
    rows = []
    for ratio, effort in settings:
        of = [results[p, ratio, effort] for p in four]
        rows.append([str(ratio), str(effort), *(number(mean(r[k] for r in of), d) for k, d in (("encode_s", 2), ("psnr", 2), ("ms_ssim", 4), ("ssimulacra2", 1), ("butteraugli", 2)))])
    tables["efforts"] = table(["ratio", "effort", "CPU s", "PSNR dB", "MS-SSIM", "SSIMULACRA2", "Butteraugli"], rows, 0)


def speeds():
    """Measures SSIMULACRA2 against CPU seconds at a ratio of 50: for the efforts of ssplat, and for the speeds of aom at
    the file size of effort 5."""
    four = {k: args.kodak / f"kodim{k:02}.png" for k in AROUND_50}
    efforts = (1, 2, 3, 4, 5, 6, 7, 9)
    made = dict(zip([(k, e) for k in four for e in efforts], each([lambda p=p, e=e: ours(p, ["--ratio", "50", "--effort", str(e)]) for p in four.values() for e in efforts])))
    keys = [(k, s, q) for k in four for s in AVIF_SPEEDS for q in AROUND_50[k]]
    found = dict(zip(keys, each([lambda k=k, s=s, q=q: others(four[k], "avif", q, s) for k, s, q in keys])))
    rows, lines = [], {"ssplat": [], "AVIF tune=iq": []}
    for effort in efforts:
        of = [made[k, effort] for k in four]
        values = [mean(r[key] for r in of) for key in ("encode_s", "ssimulacra2", "butteraugli", "ms_ssim")]
        lines["ssplat"].append(values[:2])
        rows.append([f"ssplat, effort {effort}", *(number(v, d) for v, d in zip(values, (2, 1, 2, 4)))])
    for speed in AVIF_SPEEDS:
        values = [mean(r["encode_s"] for key, r in found.items() if key[1] == speed)]
        for key in ("ssimulacra2", "butteraugli", "ms_ssim"):
            of = [at([found[k, speed, q] for q in AROUND_50[k]], made[k, 5]["bytes"], key) for k in four]
            if None in of:
                sys.exit(f"AVIF at speed {speed}: the qualities of AROUND_50 are not on both sides of the size, {of}")
            values.append(mean(of))
        lines["AVIF tune=iq"].append(values[:2])
        rows.append([f"AVIF tune=iq, speed {speed}", *(number(v, d) for v, d in zip(values, (2, 1, 2, 4)))])
    tables["speeds"] = table(["encoder", "CPU s", "SSIMULACRA2", "Butteraugli", "MS-SSIM"], rows)
    every = [y for line in lines.values() for _, y in line]
    speed_chart.write_text(svg(lines, (0.05, 100.0, (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100), "CPU seconds of an encode, one thread"), (min(every) // 5 * 5, max(every) // 5 * 5 + 5, 5)))


def tiny():
    rows = []
    for size in (40, 100, 300, 1000):
        of = each([lambda p=p, s=size: ours(p, ["--bytes", str(s)]) for p in pictures])
        rows.append([str(size), *(number(mean(r[k] for r in of), d) for k, d in (("psnr", 2), ("ssimulacra2", 1), ("encode_s", 2)))])
    tables["tiny"] = table(["bytes", "PSNR dB", "SSIMULACRA2", "CPU s"], rows, 0)


def large():
    rows = []
    for picture in args.large:
        for ratio in (50, 200):
            row = ours(picture, ["--ratio", str(ratio), "--effort", "3"], 2)
            rows.append([picture.stem, str(ratio), str(row["bytes"]), *(number(row[k] if row[k] is not None else float("nan"), d) for k, d in (("psnr", 2), ("ms_ssim", 4), ("ssimulacra2", 1), ("encode_s", 0), ("encode_mb", 0))), number(1000 * row["decode_s"], 0)])
    tables["large"] = table(["picture", "ratio", "bytes", "PSNR dB", "MS-SSIM", "SSIMULACRA2", "encode, CPU s", "MB at the peak", "decode, CPU ms"], rows)


DECODERS = ["ssplat", "ssplat, reused", "ssplat, reading alone", "ssplat, 1024² region", "ssplat, 256 wide", "ssplat decode", "zune-jpeg", "zune-jpeg, reused", "image-webp", "dwebp", "avifdec"]


def cropped(picture, megapixels):
    """Returns the middle of a picture, with that many megapixels at most and sides of 3 to 2."""
    from PIL import Image

    height = int((megapixels * 1e6 / 1.5) ** 0.5) // 8 * 8
    width = height * 3 // 2
    path = cache / f"{picture.stem}-{megapixels}mp.png"
    if not path.exists():
        image = Image.open(picture).convert("RGB")
        left, top = max(0, (image.width - width) // 2), max(0, (image.height - height) // 2)
        image.crop((left, top, min(left + width, image.width), min(top + height, image.height))).save(path, compress_level=1)
    return path


def decoders():
    """Times decoders on files of equal bytes, all in one run of the example `decode_speed`."""
    example = args.program.parent / "examples/decode_speed"
    # The ssplat files depend on the build.
    files = cache / f"decoders-{build}"
    of = [(p, r) for p in (pictures[2], pictures[11]) for r in (20, 50)]
    of += [(cropped(p, size), r) for p, size in zip(args.large, (12, 24)) for r in (50, 100, 200)]
    rows = []
    for picture, ratio in of:
        only = ",".join(sorted({name.split(",")[0] for name in DECODERS}))
        output = run([example, picture, "--ratio", str(ratio), "--effort", "1", "--repeat", "15", "--keep", files, "--only", only])[0]
        found = {cells[2].strip(): cells for cells in (line.split("|") for line in output.splitlines()) if len(cells) == 9}
        cpu = {name: float(found[name][4]) for name in DECODERS}
        rows.append([picture.stem, str(ratio), *(number(cpu[name], 1) for name in DECODERS), number(cpu["ssplat"] / cpu["zune-jpeg"], 2), number(cpu["ssplat"] / cpu["dwebp"], 2)])
        print(rows[-1], flush=True)
    head = ["picture", "ratio", *DECODERS, "ssplat ÷ zune-jpeg", "ssplat ÷ dwebp"]
    tables["decoders"] = table(head, rows) + f"\n\nCPU milliseconds with commit {commit}, one thread."


def screen(picture, megapixels=4):
    """Returns a picture, repeated and cropped to that many megapixels."""
    from PIL import Image

    path = cache / f"{picture.stem}-{megapixels}mp-screen.png"
    if not path.exists():
        image = Image.open(picture).convert("RGB")
        width = max(image.width, 2400) if image.width * image.height < megapixels * 1e6 else image.width
        height = int(megapixels * 1e6 / width)
        made = Image.new("RGB", (width, height))
        for y in range(0, height, image.height):
            for x in range(0, width, image.width):
                made.paste(image, (x, y))
        made.save(path, compress_level=1)
    return path


def lossless():
    """Times decoders on files without loss, all in one run of the example `decode_speed` with one thread."""
    example = args.program.parent / "examples/decode_speed"
    of = [*map(screen, args.screens), *(pictures[k] for k in (1, 2, 6))]
    output = run([example, *of, "--lossless", "--keep", cache / f"lossless-{build}"])[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in output.splitlines() if line.count("|") == 8]
    made = {}
    for picture, decoder, size, _, each, _, _ in rows[2:]:
        made.setdefault(picture, {})[decoder] = size, float(each)
    columns = ["ssplat", "ssplat, reused", "ssplat, reading alone", "image-webp", "image-webp, reused", "png (image)"]
    head = ["picture", "bytes", "bytes of WebP", *columns, "ssplat ÷ image-webp"]
    body = [[name, d["ssplat"][0], d["image-webp"][0], *(number(d[c][1], 1) for c in columns), number(d["ssplat"][1] / d["image-webp"][1], 1)] for name, d in made.items()]
    tables["lossless"] = table(head, body) + f"\n\nNanoseconds of CPU time a pixel with commit {commit}, one thread."


for name, measure in (("codecs", codecs), ("quality", quality), ("efforts", efforts), ("speeds", speeds), ("tiny", tiny), ("large", large), ("decoders", decoders), ("lossless", lossless)):
    if name in only and (name != "large" or args.large):
        measure()
        print(name, "done", flush=True)
if not tables:
    sys.exit()
if not set(only) <= {"decoders", "lossless"}:
    tables["when"] = measured_when(commit)
write_tables(page, tables)
if all_rows:
    with open(rows_file, "w", newline="") as file:
        writer = csv.DictWriter(file, ["image", "codec", "setting", "bytes", *MEASURES, "encode_s", "decode_s", "encode_mb", "decode_mb"])
        writer.writeheader()
        for row in all_rows:
            writer.writerow({k: round(v, 5) if isinstance(v, float) else v for k, v in row.items()})
