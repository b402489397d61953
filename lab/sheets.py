#!/usr/bin/env python3
"""Makes sheets of crops for a blind comparison with AVIF (tune=iq), and counts the verdicts.

    python lab/sheets.py PICTURES target/release/ssplat SHEETS
    python lab/sheets.py PICTURES target/release/ssplat SHEETS --only kodim,clic --ratios 50 --zoom 3
    python lab/sheets.py --reveal VERDICTS.csv SHEETS/key.json [--page docs/studies/eye.md]
    python lab/sheets.py --layers PICTURES target/release/ssplat SHEETS
    python lab/sheets.py --store OUT.webp SHEETS/key.json NAMES...

PICTURES contains one folder for each set. lab/crops.json lists the crops, which were chosen from the originals alone, and for
each group of them the ratios and the speed of AVIF. Each picture is encoded whole, with the default of the program and with
AVIF in at most the bytes of the ratio, 4:2:0 or 4:4:4, whichever has the higher SSIMULACRA2 at speed 8. SHEETS gets a PNG for
each crop and ratio: the original, the left and the right codec, enlarged by --zoom if the crop is narrower than 384 pixels. A number of
--seed and the name of the sheet decide which codec is left. SHEETS/key.json says which it is, with bytes and measures. Crops
of a file that is equal to the picture get no sheet; neither do those of which AVIF has no file that is small enough.

VERDICTS has the columns sheet, better (left, right or equal), left_faults and right_faults (words of FAULTS, separated by
semicolons) and why (a sentence in which the words left and right mean the codecs). --reveal prints the verdicts with the names
of the codecs, and counts them by subject, ratio and fault. --page writes these tables into a document. Without --reveal, the
command prints no measures.

--store puts some sheets below each other, as original, ssplat and AVIF, or as --layers wrote them.

--layers shows where a fault comes from, after the verdicts: sheets of the original, the file and its Gaussians alone, and a
table of the share of the bytes that are Gaussians, and the errors of colour of the file, of its Gaussians alone and of AVIF:
the mean absolute error of the means of Cb and Cr over 8 × 8 pixels of the crop, in code values. "Flat cells" is the share of
the cells of 4 × 4 pixels in which the range of luma is below that which the encoder takes for flat ground, in the original and
in a copy blurred with σ = 1.5.

Files and measures of AVIF are cached in --cache. It needs Pillow 12 or newer.
"""
import argparse, collections, csv, dataclasses, json, math, pathlib, random, re, sys, tempfile

from PIL import Image, ImageFilter

from other_codecs import Cache, Files, avif, measured, programs, run
from report import number, table, write_tables

root = pathlib.Path(__file__).resolve().parent.parent
FAULTS = ("blur", "missing texture", "ringing", "stains", "blocking", "banding", "jagged edges", "colour loss", "noise", "false texture")
CODECS = ("ssplat", "AVIF")
# Speed of AVIF at which the quality is searched.
SEARCH = 8
GAP = 8
# Difference in SSIMULACRA2 by which the verdicts are divided.
LEAD = 5
# Range of luma below which the encoder takes a cell for flat ground (src/encode/detail/flat_cells.rs).
FLAT_RANGE = 4


def crops(args):
    """Yields the group, the settings of the group and the crop, of those that were asked for."""
    words = [word for word in args.only.split(",") if word]
    for group, settings in json.loads((root / "lab/crops.json").read_text()).items():
        if not args.group or group == args.group:
            for crop in settings["crops"]:
                if not words or any(word in crop["picture"] for word in words):
                    yield group, settings, crop


def name_of(crop, ratio):
    x, y, *_ = crop["crop"]
    return f"{pathlib.Path(crop['picture']).stem[:24]}-{x}-{y}-{ratio}"


def left_of(seed, name):
    """Returns which codec is on the left of a sheet."""
    return random.Random(f"{seed} {name}").choice(CODECS)


class Lab:
    def __init__(self, args):
        self.args, self.cache = args, Cache(args.cache)
        (self.program, _, _, self.build), = programs([f"ssplat={args.program}"]).values()
        self.files = Files(self.cache, self.program)
        for folder in ("pixels", "decoded"):
            (args.cache / folder).mkdir(exist_ok=True)

    def picture(self, name):
        """Returns a copy of a picture in RGB without metadata."""
        copy = (self.args.cache / "pixels" / name.replace("/", "-")).with_suffix(".png")
        if not copy.exists():
            image = Image.open(self.args.pictures / name).convert("RGB")
            image.info.clear()
            image.save(copy)
        return copy

    def encoded(self, key, picture, ratio, decoded, options, look):
        """Encodes a picture with the program and decodes the file to `decoded`. Returns what `look` says of the file."""
        def work():
            with tempfile.TemporaryDirectory() as folder:
                file = pathlib.Path(folder, "a.ssplat")
                run([self.program, "--threads", "1", "encode", picture, file, "--ratio", ratio, "--quiet", "--force"])
                run([self.program, "--threads", "1", "decode", file, decoded, "--quiet", *options])
                return look(file)
        return self.cache.kept(f"{key} {self.build} {picture.name} {ratio}", work)

    def ours(self, picture, ratio):
        """Returns the bytes, the measures and the decoded picture of the file of the program."""
        decoded = self.args.cache / "decoded" / f"{self.build}-{picture.stem}-{ratio}.png"
        look = lambda file: {"bytes": file.stat().st_size} | measured(self.program, picture, file)
        return self.encoded("sheet", picture, ratio, decoded, [], look), decoded

    def gaussians(self, picture, ratio):
        """Returns the share of the bytes of the file of the program that are Gaussians, and these alone."""
        decoded = self.args.cache / "decoded" / f"{self.build}-{picture.stem}-{ratio}-gaussians.png"
        look = lambda file: json.loads(run([self.program, "info", file, "--json"])[0])
        info = self.encoded("layers", picture, ratio, decoded, ["--layers", "gaussians"], look)
        return 1 - (info["detail"] or {"bytes": 0})["bytes"] / info["bytes"], Image.open(decoded).convert("RGB")

    def avif(self, picture, ratio, speed):
        """Returns the same of AVIF, or None if no file fits. The subsampling is the one with the higher SSIMULACRA2 at speed
        SEARCH, and the quality is searched from the sizes there."""
        room = math.prod(Image.open(picture).size) * 3 // ratio
        slow = dict(zip((codec.settings for codec in avif(SEARCH)), avif(speed)))
        found = []
        for codec in avif(SEARCH):
            # All qualities, because the file shall be as large as possible.
            codec = dataclasses.replace(codec, qualities=tuple(range(100)))
            found.append((self.files.point(picture, codec, self.files.around(picture, codec, [room + 1])[0])["ssimulacra2"], codec))
        _, quick = max(found, key=lambda made: made[0])
        codec, scale, tried = slow[quick.settings], 1.0, {}
        while True:
            quality = self.files.around(picture, quick, [(room + 1) / scale])[0]
            if quality in tried:
                break
            file = self.file(picture, codec, quality)
            tried[quality] = file.stat().st_size
            scale = tried[quality] / self.files.size(picture, quick, quality)
        fitting = [quality for quality in tried if tried[quality] <= room]
        if not fitting:
            return None, None
        file = self.file(picture, codec, max(fitting))
        decoded = Image.open(file).convert("RGB")

        def work():
            with tempfile.TemporaryDirectory() as folder:
                back = pathlib.Path(folder, "a.ppm")
                decoded.save(back)
                return {"bytes": file.stat().st_size, "settings": f"{codec.settings} quality {max(fitting)}"} | measured(self.program, picture, back)
        return self.cache.kept(f"sheet {file.name}", work), decoded

    def file(self, picture, codec, quality):
        """Returns an AVIF file, from the cache if it is there."""
        path = self.args.cache / "decoded" / f"{picture.stem}-{codec.settings.replace(':', '').replace(' ', '-')}-{quality}.avif"
        if not path.exists():
            part = path.with_suffix(".part")
            codec.encode(self.files.image(picture), quality, part)
            part.rename(path)
        return path

    def sheet(self, crop, pictures):
        x, y, width, height = crop["crop"]
        zoom = self.args.zoom if width < 384 else 1
        parts = [picture.crop((x, y, x + width, y + height)).resize((zoom * width, zoom * height), Image.Resampling.LANCZOS) for picture in pictures]
        sheet = Image.new("RGB", (len(parts) * (zoom * width + GAP) - GAP, zoom * height), "white")
        for at, part in enumerate(parts):
            sheet.paste(part, (at * (zoom * width + GAP), 0))
        return sheet


def make(args):
    lab = Lab(args)
    args.sheets.mkdir(parents=True, exist_ok=True)
    path = args.sheets / "key.json"
    key = json.loads(path.read_text()) if path.exists() else {}
    for group, settings, crop in crops(args):
        picture = lab.picture(crop["picture"])
        original = Image.open(picture)
        for ratio in [int(ratio) for ratio in args.ratios.split(",")] if args.ratios else settings["ratios"]:
            name = name_of(crop, ratio)
            own, decoded = lab.ours(picture, ratio)
            made = {"ssplat": Image.open(decoded).convert("RGB")}
            entry = crop | {"group": group, "ratio": ratio, "ssplat": own}
            if made["ssplat"].tobytes() == original.tobytes():
                key[name] = entry | {"left_out": "exact"}
            else:
                entry["AVIF"], made["AVIF"] = lab.avif(picture, ratio, settings["avif_speed"])
                if entry["AVIF"]:
                    left = left_of(args.seed, name)
                    order = CODECS if left == CODECS[0] else CODECS[::-1]
                    lab.sheet(crop, [original, *(made[codec] for codec in order)]).save(args.sheets / f"{name}.png")
                    key[name] = entry | {"left": left}
                else:
                    key[name] = entry | {"left_out": "no AVIF"}
            path.write_text(json.dumps(key, indent=1) + "\n")
            print(name, key[name].get("left_out", ""), flush=True)


def color_error(original, made, crop):
    import numpy
    x, y, width, height = crop
    pixels = [numpy.asarray(image.crop((x, y, x + width, y + height)).convert("YCbCr"), numpy.float32)[..., 1:] for image in (original, made)]
    means = (pixels[0] - pixels[1]).reshape(height // 8, 8, width // 8, 8, 2).mean((1, 3))
    return float(abs(means).mean())


def flat_cells(image, crop):
    """Returns the share of the cells of 4 × 4 pixels that the encoder regards as flat, in this crop."""
    import numpy
    x, y, width, height = crop
    cells = numpy.asarray(image.convert("L").crop((x, y, x + width, y + height)), numpy.float32).reshape(height // 4, 4, width // 4, 4)
    return float((cells.max((1, 3)) - cells.min((1, 3)) < FLAT_RANGE).mean())


def layers(args):
    lab, rows = Lab(args), []
    args.sheets.mkdir(parents=True, exist_ok=True)
    for _, settings, crop in crops(args):
        picture = lab.picture(crop["picture"])
        original = Image.open(picture)
        for ratio in [int(ratio) for ratio in args.ratios.split(",")] if args.ratios else settings["ratios"]:
            made = Image.open(lab.ours(picture, ratio)[1]).convert("RGB")
            share, gaussians = lab.gaussians(picture, ratio)
            lab.sheet(crop, [original, made, gaussians]).save(args.sheets / f"{name_of(crop, ratio)}-layers.png")
            other = lab.avif(picture, ratio, settings["avif_speed"])[1]
            errors = [color_error(original, image, crop["crop"]) if image else float("nan") for image in (made, gaussians, other)]
            rows.append([pathlib.Path(crop["picture"]).stem + " " + ",".join(map(str, crop["crop"])), str(ratio), number(share, 2), *(number(error, 2) for error in errors), *(number(flat_cells(image, crop["crop"]), 2) for image in (original, original.filter(ImageFilter.GaussianBlur(1.5))))])
            print(*rows[-1], flush=True)
    print(table(["picture, crop", "ratio", "Gaussians, share", "colour, file", "colour, Gaussians alone", "colour, AVIF", "flat cells", "flat if smoothed"], rows))


def named(sentence, left):
    """Puts the names of the codecs in the place of the words left and right."""
    sides = {"left": left, "right": CODECS[left == CODECS[0]]}
    return re.sub(r"\b(on the )?(left|right)\b", lambda word: ("with " if word[1] else "") + sides[word[2].lower()], sentence, flags=re.IGNORECASE)


def verdicts(path, key):
    """Returns the verdicts with the names of the codecs."""
    found = []
    with open(path) as file:
        for row in csv.DictReader(file):
            entry = key[row["sheet"]]
            sides = {"left": entry["left"], "right": CODECS[entry["left"] == CODECS[0]]}
            faults = {codec: [fault.strip() for fault in row[f"{side}_faults"].split(";") if fault.strip()] for side, codec in sides.items()}
            unknown = {fault for list_ in faults.values() for fault in list_} - set(FAULTS)
            if unknown or row["better"] not in (*sides, "equal"):
                sys.exit(f"{row['sheet']}: {unknown or row['better']!r} is not known")
            found.append(entry | {"sheet": row["sheet"], "better": sides.get(row["better"], "equal"), "faults": faults, "why": named(row["why"], entry["left"])})
    missing = [name for name, entry in key.items() if "left" in entry and name not in {verdict["sheet"] for verdict in found}]
    if missing:
        print(f"without a verdict: {', '.join(missing)}", file=sys.stderr)
    return found


def counted(groups, columns):
    """Returns a table of how often each codec is better, by the groups of verdicts, in each of the columns."""
    rows = []
    for name, of in groups.items():
        row = [name]
        for column in columns:
            there = [verdict["better"] for verdict in of if verdict["ratio"] == column]
            row.append(" / ".join(str(there.count(better)) for better in (CODECS[0], "equal", CODECS[1])) if there else "–")
        rows.append(row)
    return rows


def reveal(args):
    key = json.loads(args.key.read_text())
    found, tables = verdicts(args.reveal, key), {}
    for group in dict.fromkeys(verdict["group"] for verdict in found):
        of = [verdict for verdict in found if verdict["group"] == group]
        ratios = sorted({verdict["ratio"] for verdict in of})
        rows = []
        for verdict in of:
            place = f"{pathlib.Path(verdict['picture']).stem} {','.join(map(str, verdict['crop']))}"
            points = " / ".join(number(verdict[codec]["ssimulacra2"], 1) for codec in CODECS)
            rows.append([place, verdict["subject"], str(verdict["ratio"]), verdict["better"], *(", ".join(verdict["faults"][codec]) or "none" for codec in CODECS), points, verdict["why"]])
        tables[f"verdicts {group}"] = table(["picture, crop", "subject", "ratio", "better", "faults of ssplat", "faults of AVIF", "SSIMULACRA2", "why"], rows, left=8)
        subjects = collections.defaultdict(list)
        for verdict in of:
            subjects[verdict["subject"]].append(verdict)
        leads = {name: [verdict for verdict in of if chosen(verdict["ssplat"]["ssimulacra2"] - verdict["AVIF"]["ssimulacra2"])] for name, chosen in (
            (f"SSIMULACRA2 of ssplat higher by {LEAD} or more", lambda lead: lead >= LEAD), ("by less, or lower", lambda lead: lead < LEAD))}
        counts = counted({"all": of, **leads, **dict(sorted(subjects.items()))}, ratios)
        tables[f"counts {group}"] = table(["subject", *(f"at {ratio}" for ratio in ratios)], counts)
        rows = []
        for fault in FAULTS:
            times = [[sum(fault in verdict["faults"][codec] for verdict in of if verdict["ratio"] == ratio) for codec in CODECS] for ratio in ratios]
            if any(map(any, times)):
                rows.append([fault, *(" / ".join(map(str, pair)) for pair in times)])
        tables[f"faults {group}"] = table(["fault", *(f"at {ratio}" for ratio in ratios)], rows)
        agree = [(verdict["ssplat"]["ssimulacra2"] > verdict["AVIF"]["ssimulacra2"]) == (verdict["better"] == "ssplat") for verdict in of if verdict["better"] != "equal"]
        bytes_ = [verdict["AVIF"]["bytes"] / verdict["ssplat"]["bytes"] for verdict in of]
        left_out = [f"{name} ({entry['left_out']})" for name, entry in key.items() if entry["group"] == group and "left_out" in entry]
        print(f"{group}: {len(of)} sheets; SSIMULACRA2 of the whole pictures prefers the same codec in {sum(agree)} of {len(agree)}; AVIF has {sum(bytes_) / len(bytes_):.3f} of the bytes of ssplat in the mean; left out: {', '.join(left_out) or 'none'}")
    if args.page:
        write_tables(args.page, tables)
    else:
        for name, text in tables.items():
            print(f"\n{name}\n\n{text}")


def store(args):
    key, *names = args.paths
    sheets, key = [], json.loads(key.read_text())
    for name in map(str, names):
        sheet = Image.open(args.paths[0].parent / f"{name}.png")
        if name in key and key[name]["left"] == CODECS[1]:
            width = (sheet.width - 2 * GAP) // 3
            sides = [sheet.crop((at * (width + GAP), 0, at * (width + GAP) + width, sheet.height)) for at in (1, 2)]
            sheet.paste(sides[1], (width + GAP, 0))
            sheet.paste(sides[0], (2 * (width + GAP), 0))
        sheets.append(sheet)
    whole = Image.new("RGB", (max(sheet.width for sheet in sheets), sum(sheet.height + GAP for sheet in sheets) - GAP), "white")
    top = 0
    for sheet in sheets:
        whole.paste(sheet, (0, top))
        top += sheet.height + GAP
    whole.save(args.store, quality=80, method=6)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reveal", type=pathlib.Path, metavar="VERDICTS", help="count the verdicts of this file; the only other path is that of the key")
    parser.add_argument("--store", type=pathlib.Path, metavar="WEBP", help="store sheets in this file; the paths are the key and the names of sheets")
    parser.add_argument("--layers", action="store_true", help="show the layers of the files of the program")
    parser.add_argument("paths", type=pathlib.Path, nargs="+", metavar="PATH", help="PICTURES PROGRAM SHEETS, KEY, or KEY and names")
    parser.add_argument("--group", help="only the crops of this group")
    parser.add_argument("--only", default="", help="pictures whose names contain one of these words, separated by commas")
    parser.add_argument("--ratios", help="by default those of lab/crops.json")
    parser.add_argument("--zoom", type=int, default=2)
    parser.add_argument("--seed", default="1")
    parser.add_argument("--cache", type=pathlib.Path, default=root / "target/sheets")
    parser.add_argument("--page", type=pathlib.Path, help="with --reveal: write the tables into this document")
    args = parser.parse_args()
    if args.store:
        store(args)
        return
    if len(args.paths) != (1 if args.reveal else 3):
        parser.error("PICTURES, PROGRAM and SHEETS are needed, or with --reveal the key alone")
    if args.reveal:
        args.key, = args.paths
        reveal(args)
    else:
        args.pictures, args.program, args.sheets = args.paths
        (layers if args.layers else make)(args)


if __name__ == "__main__":
    main()
