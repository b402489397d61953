"""The tables and the chart of whole sets of pictures in docs/BENCHMARKS.md, from the measurements of lab/sets.py."""
import math

from other_codecs import JPEG_XL, MEASURES, WEBP, avif, mean
from report import commit_of, measured_when, multiples, number, signed, table, write_tables

NAMES = {"kodak": "Kodak", "cid22": "CID22", "graphics": "Graphics", "clic": "CLIC", "large": "Large pictures"}
CHART = ["kodak", "cid22", "clic", "graphics"]
RATIOS = dict.fromkeys(CHART, ["5", "10", "15", "20", "50", "100", "200"]) | {"large": ["20", "50", "100", "200"]}
# Ratios at which AVIF has a file of every picture in the chart.
CHART_RATIOS = ["20", "50", "100"]
# Measures and their digits, in the order of the columns.
COLUMNS = {"ssimulacra2": 1, "butteraugli": 2, "ms_ssim": 4, "psnr": 2}
HEAD = ["SSIMULACRA2", "Butteraugli", "MS-SSIM", "PSNR, dB"]
EFFORT_RATIOS, DEFAULT_EFFORT = ["50", "200"], "5"
# Speeds of AVIF in the table of efforts; speed 3 takes minutes for a picture of CLIC.
EFFORT_SPEEDS = dict.fromkeys(RATIOS, [6, 3]) | {"clic": [6], "large": [6]}


def codecs_of(set_name, ratio):
    slow = {"AVIF, speed 3": avif(3)} if set_name == "kodak" and float(ratio) >= 20 else {}
    return {"AVIF": avif(6)} | slow | {"JPEG XL": JPEG_XL, "WebP": WEBP}


def stem_of(picture):
    """The name of a picture without that of its set."""
    return picture.stem.split("-", 1)[1]


def leads(found):
    """Returns by how much each file is above the other codec's, by name, where that codec has a file of its size. A
    measure that is not known for pictures of that size stays None."""
    return [(stem, {key: None if None in (ours[key], other[key]) else ours[key] - other[key] for key in MEASURES}) for stem, ours, other in found if other]


def measured_set(lab, name, set_name, ratio):
    """Returns the file of each picture, and what each other codec reaches in its bytes: None if it has no file of that size,
    unless its largest file is smaller and better."""
    def reached(picture, ours, codecs):
        found = lab.files.best(picture, codecs, ours["bytes"])
        largest = None if found else lab.files.best_below(picture, codecs, ours["bytes"])
        return largest if largest and largest["ssimulacra2"] > ours["ssimulacra2"] else found
    rows = []
    for picture in lab.pictures(set_name):
        ours = lab.ours(name, picture, ratio)
        others = {label: reached(picture, ours, codecs) for label, codecs in codecs_of(set_name, ratio).items()}
        rows.append((stem_of(picture), picture, ours, others))
    return rows


def set_table(found):
    lines = []
    for ratio, rows in found.items():
        of = [ours for _, _, ours, _ in rows]
        values = [number(mean(made[key] for made in of), digits) for key, digits in COLUMNS.items()]
        lines.append([ratio, "ssplat", *values, "", "", number(mean(made["seconds"] for made in of), 1)])
        for label in rows[0][3]:
            over = leads([(stem, ours, others[label]) for stem, _, ours, others in rows])
            if not over:
                lines.append([ratio, f"− {label}", "no file", "", "", "", f"– of {len(rows)}", "", ""])
                continue
            means = [signed(mean(lead[key] for _, lead in over), digits) for key, digits in COLUMNS.items()]
            ahead, (stem, worst) = sum(lead["ssimulacra2"] > 0 for _, lead in over), min(over, key=lambda lead: lead[1]["ssimulacra2"])
            lines.append([ratio, f"− {label}", *means, f"{ahead} of {len(over)}", f"{stem} {signed(worst['ssimulacra2'], 1)}", ""])
    return table(["ratio", "", *HEAD, "pictures ahead", "worst picture", "CPU s"], lines, 2)


def panel(set_name, found):
    """The title and the curves of a set: means over the pictures that AVIF covers at each of `CHART_RATIOS`, drawn where
    a codec has a file of that size for all of them."""
    covered = set.intersection(*({stem for stem, *_, others in found[ratio] if others["AVIF"]} for ratio in CHART_RATIOS if ratio in found))
    lines = {"ssplat": []}
    for rows in found.values():
        of = [row for row in rows if row[0] in covered]
        x = mean(8 * ours["bytes"] / pixels_of(picture) for _, picture, ours, _ in of)
        lines["ssplat"].append((x, mean(ours["ssimulacra2"] for *_, ours, _ in of)))
        for label, drawn in (("AVIF", "AVIF tune=iq"), ("JPEG XL", "JPEG XL"), ("WebP", "WebP")):
            reached = [others[label] for *_, others in of]
            if all(reached):
                lines.setdefault(drawn, []).append((x, mean(made["ssimulacra2"] for made in reached)))
    return f"{NAMES[set_name]}, {len(covered)} of {len(rows)} pictures", lines


def pixels_of(picture):
    from PIL import Image
    width, height = Image.open(picture).size
    return width * height


# Points of SSIMULACRA2 by which an effort may be below the hull of the others: scores scatter by 0.1 in the mean of a set.
BELOW_HULL = 0.2


def below_hull(efforts):
    """Returns the efforts, with (seconds, points), that lie below the upper hull of points over the logarithm of time."""
    def short(effort):
        seconds, points = efforts[effort]
        others = [(math.log(s), p) for other, (s, p) in efforts.items() if other != effort]
        faster, slower = [o for o in others if o[0] <= math.log(seconds)], [o for o in others if o[0] > math.log(seconds)]
        chords = [p + (q - p) * (math.log(seconds) - a) / (b - a) for a, p in faster for b, q in slower]
        return max([p for _, p in faster] + chords, default=points) - points
    return {effort: short(effort) for effort in efforts if short(effort) > BELOW_HULL}


def effort_rows(lab, name, set_name, ratio, efforts):
    """Returns the rows of a set: CPU seconds and quality of efforts, and of AVIF at the bytes of the default effort. Also
    returns the efforts that are not worth their time."""
    pictures = {picture: lab.ours(name, picture, ratio) for picture in lab.pictures(set_name)}
    speeds = {speed: {picture: lab.files.best(picture, avif(speed), ours["bytes"]) for picture, ours in pictures.items()} for speed in EFFORT_SPEEDS[set_name]}
    covered = [picture for picture in pictures if all(found[picture] for found in speeds.values())]

    def row(encoder, seconds, of):
        return [set_name, ratio, f"{len(covered)} of {len(pictures)}", encoder, number(mean(seconds), 2), *(number(mean(made[key] for made in of), COLUMNS[key]) for key in ("ssimulacra2", "butteraugli", "ms_ssim"))]
    rows, curve = [], {}
    for effort in efforts:
        of = [lab.ours(name, picture, ratio, [] if effort == DEFAULT_EFFORT else ["--effort", effort]) for picture in covered]
        rows.append(row(f"ssplat, effort {effort}", [made["seconds"] for made in of], of))
        curve[effort] = mean(made["seconds"] for made in of), mean(made["ssimulacra2"] for made in of)
    for speed, found in speeds.items():
        seconds = []
        for picture in covered:
            codec = found[picture]["codec"]
            qualities = lab.files.around(picture, codec, [pictures[picture]["bytes"]])
            seconds.append(mean(lab.files.seconds(picture, codec, quality, lab.args.repeat) for quality in qualities))
        rows.append(row(f"AVIF, speed {speed}", seconds, [found[picture] for picture in covered]))
    return rows, below_hull(curve)


def write(lab, root):
    """Measures the sets with the first program. With --page, writes their tables and the chart; with --efforts, the table
    of encoding times. Returns messages about efforts that are not worth their time."""
    args, name = lab.args, next(iter(lab.programs))
    tables, panels, rows, wasted = {}, {}, [], []
    when = measured_when(args.commit or commit_of(root))
    for set_name in args.sets.split(",") if args.page else []:
        found = {ratio: measured_set(lab, name, set_name, ratio) for ratio in (args.ratios.split(",") if args.ratios else RATIOS[set_name])}
        tables[f"set {set_name}"] = set_table(found)
        if set_name not in CHART:
            tables[f"set {set_name}"] += f"\n\n{when}"
        panels[set_name] = panel(set_name, found)
        print(f"{set_name}\n{tables[f'set {set_name}']}", flush=True)
    if any(set_name in panels for set_name in CHART):
        tables["sets when"] = when
    for set_name in args.sets.split(",") if args.efforts else []:
        for ratio in EFFORT_RATIOS:
            more, short = effort_rows(lab, name, set_name, ratio, args.efforts.split(","))
            rows += more
            wasted += [f"{set_name} at {ratio}: effort {effort} is {points:.1f} points below the hull of the others" for effort, points in short.items()]
            print(set_name, ratio, "efforts done", flush=True)
    if rows:
        tables["set efforts"] = table(["set", "ratio", "pictures", "encoder", "CPU s", *HEAD[:3]], rows, 4) + f"\n\n{when}"
        print(tables["set efforts"], flush=True)
    print(*wasted, sep="\n", flush=True)
    write_tables(root / "docs/BENCHMARKS.md", tables)
    if all(set_name in panels for set_name in CHART):
        chart = multiples(dict(panels[set_name] for set_name in CHART), (0.1, 5.0, (0.1, 0.2, 0.5, 1, 2, 5), "bits per pixel (24 divided by the ratio)"), (-20, 100, 20))
        (root / "docs/sets.svg").write_text(chart)
    return wasted
