#!/usr/bin/env python3
"""Fits the constants with which the encoder divides the bytes of a file between the Gaussians and the detail layer.

    cargo build --release && cargo build --release -p ssplat-lab --example texture
    python lab/fit_division.py PICTURES target/release/ssplat
    python lab/fit_division.py PICTURES target/release/ssplat --sets kodak --ratios 100 --table division.txt

PICTURES contains one folder for each set in lab/sets.json. Each picture is encoded at each ratio without a layer and
with several sizes of the base: factors on the size that the rule gives to a picture without fine texture. The scores
(SSIMULACRA2) between these factors are interpolated. The command then finds the values of FINE_BASE_FINENESS,
FINE_BASE_SLOPE and MIN_FINE_BASE_FACTOR in src/constants/allocation.rs with which the photographs of the halves for choosing lose least
against the best of what was tried (without the minimum share of large, busy photographs), and prints them beside the
present ones, with the loss on both halves. --table writes what each picture would have had. Encodes are cached, so
that an interrupted command can be continued. The default needs about 1200 encodes.
"""
import argparse, itertools, json, math, pathlib, re, subprocess, sys

import sets
from other_codecs import mean

root = pathlib.Path(__file__).resolve().parent.parent
FACTORS = [0.35, 0.5, 0.7, 1.0, 1.4]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pictures", type=pathlib.Path)
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("--texture", type=pathlib.Path, help="the example `texture`; by default beside the program")
    parser.add_argument("--sets", default="kodak,cid22,graphics,clic")
    parser.add_argument("--ratios", default="50,100,200")
    parser.add_argument("--cache", type=pathlib.Path, default=root / "target/sets")
    parser.add_argument("--table", type=pathlib.Path, help="file to which the table is written")
    return parser.parse_args()


def constants():
    """Returns the constants of the rule, by name."""
    text = (root / "src/constants/allocation.rs").read_text()
    found = re.findall(r"const (\w+): (?:f64|\[f64; \d\]) = \[?([\d_., ]+)\]?;", text)
    values = {name: [float(v) for v in value.replace("_", "").split(",")] for name, value in found}
    return {name: value[0] if len(value) == 1 else value for name, value in values.items()}


def usual_bytes(pixels, ratio, c):
    """Returns the bytes of the base of a picture without fine texture: `bytes_of_base` in allocation.rs."""
    return c["REFERENCE_BASE_BYTES"] * (pixels / c["REFERENCE_PIXELS"]) ** c["BASE_SIZE_EXPONENT"] * (min(ratio, 100) / 50) ** -c["BASE_RATIO_EXPONENT"]


def factor_of(fineness, ratio, c):
    """Returns the factor on these bytes for a photograph: `base_factor` in allocation.rs."""
    low, high = c["FINE_BASE_RATIOS"]
    strength = min(1, max(0, math.log(ratio / low) / math.log(high / low)))
    factor = min(1, max(c["MIN_FINE_BASE_FACTOR"], 1 - c["FINE_BASE_SLOPE"] * (fineness - c["FINE_BASE_FINENESS"])))
    return 1 - strength * (1 - factor)


def score_at(tried, factor):
    """Returns the score at a factor, interpolated over its logarithm."""
    points = sorted((f, score) for f, score in tried.items() if f != "off")
    factor = min(points[-1][0], max(points[0][0], factor))
    for (a, low), (b, high) in zip(points, points[1:]):
        if a <= factor <= b:
            return low + (high - low) * math.log(factor / a) / math.log(b / a)
    return points[-1][1]


def losses(rows, c):
    """Returns by how many points each row is below the best that was tried."""
    return [max(row["tried"].values()) - score_at(row["tried"], factor_of(row["fineness"], row["ratio"], c)) for row in rows]


def loss(rows, c):
    """Returns the mean loss of the sets."""
    by_set = {}
    for row, lost in zip(rows, losses(rows, c)):
        by_set.setdefault(row["set"], []).append(lost)
    return mean([mean(of) for of in by_set.values()])


def measured(args, c):
    """Encodes the pictures and returns a row for each picture and ratio."""
    sys.argv = ["sets.py", str(args.pictures), f"ssplat={args.program}", "--sets", args.sets, "--no-avif", "--cache", str(args.cache)]
    lab = sets.Lab(sets.arguments())
    example = args.texture or args.program.parent / "examples/texture"
    rows = []
    for set_name, half in itertools.product(args.sets.split(","), ["choose", "judge"]):
        lab.args.half = half
        for picture in lab.pictures(set_name):
            texture = json.loads(subprocess.run([example, picture], capture_output=True, text=True, check=True).stdout)
            pixels = texture["width"] * texture["height"]
            for ratio in map(float, args.ratios.split(",")):
                shares = {f: round(min(c["MAX_BASE_SHARE"], f * usual_bytes(pixels, ratio, c) * ratio / (3 * pixels)), 4) for f in FACTORS}
                tried = {f: lab.ours("ssplat", picture, f"{ratio:g}", ["--detail", str(share)])["ssimulacra2"] for f, share in shares.items()}
                tried["off"] = lab.ours("ssplat", picture, f"{ratio:g}", ["--detail", "off"])["ssimulacra2"]
                rows.append({"set": set_name, "half": half, "picture": picture.stem, "ratio": ratio, "tried": tried} | texture)
                print(f"{set_name} {picture.stem} at {ratio:g}", file=sys.stderr)
    return rows


def main():
    args = arguments()
    present = constants()
    rows = measured(args, present)
    # Drawings have a rule of their own.
    photographs = [row for row in rows if row["flat"] <= present["DRAWING_FLAT_SHARE"]]
    chosen_on = [row for row in photographs if row["half"] == "choose"]
    names = ["FINE_BASE_FINENESS", "FINE_BASE_SLOPE", "MIN_FINE_BASE_FACTOR"]
    grid = itertools.product([k / 20 for k in range(4, 25)], [k / 10 for k in range(1, 31)], [k / 20 for k in range(7, 20)])
    fitted = present | dict(zip(names, min(grid, key=lambda values: loss(chosen_on, present | dict(zip(names, values))))))
    lines = []
    for name, c in [("present", present), ("fitted", fitted)]:
        lines.append(f"{name}: " + ", ".join(f"{n} = {c[n]:g}" for n in names))
        for set_name, half, ratio in itertools.product(args.sets.split(","), ["choose", "judge"], map(float, args.ratios.split(","))):
            of = [row for row in photographs if (row["set"], row["half"], row["ratio"]) == (set_name, half, ratio)]
            if of:
                lost = losses(of, c)
                lines.append(f"  {set_name}, {half}, at {ratio:g}: {mean(lost):.2f} points below the best in the mean, {max(lost):.1f} at most")
    print("\n".join(lines))
    if args.table:
        for row in rows:
            tried = " ".join(f"{f}:{score:.1f}" for f, score in row["tried"].items())
            at = factor_of(row["fineness"], row["ratio"], fitted)
            lines.append(f"{row['set']} {row['half']} {row['ratio']:g} {row['picture']} fineness {row['fineness']:.2f} flat {row['flat']:.2f} | {tried} | fitted factor {at:.2f}: {score_at(row['tried'], at):.1f}")
        args.table.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
