#!/usr/bin/env python3
"""Measures the effect of other values of a fitted constant of the encoder, which is one of those in src/constants.

    python lab/constants.py detail::MIXED_COST 1.0 1.15 1.3 --pictures shared/images/kodak/kodim0*.png --ratio 50
    python lab/constants.py fit::FIT_FACTORS "[1.0, 1.3, 1.0, 0.8]" --pictures shared/images --sets kodak,cid22 --half choose --ratio 20,50
    python lab/constants.py quality::MAX_TRIMMED_POINTS 0.5 4 --pictures small/*.png --ratio q50
    python lab/constants.py --list [WORD]

--pictures names pictures, or a folder with one folder for each set of lab/sets.json; --sets then chooses the sets, and --half
and --only the pictures, as in lab/sets.py. For each value, the command copies the repository as it is now to a
temporary folder, replaces the constant there, and builds the program. It then encodes every picture at every ratio with each of the
programs, on one thread, and prints a table for each ratio or quality: means over all pictures, and the gain over the present value,
whose row is marked. The present value is always measured. All builds use one temporary target folder, so that only the first
one compiles everything; --target keeps it for the next command. Nothing else stays. Needs Pillow.

--list prints all constants, or those whose path or documentation contains a word. The command exits with status 1 if there is no such
constant, if a value does not have its type, or if a build or an encode fails.
"""
import argparse, ast, dataclasses, difflib, os, pathlib, re, shutil, signal, subprocess, sys, tempfile, textwrap

root = pathlib.Path(__file__).resolve().parent.parent
FOLDER = pathlib.Path("src/constants")
CONSTANT = re.compile(r"^pub\(crate\) const (\w+): (.+?) =\s+(.+?);$", re.M | re.S)
# The number of bits of an integer type, and whether it has a sign.
INTEGERS = {f"{sign}{bits}": (bits, sign == "i") for sign in "ui" for bits in (8, 16, 32, 64)} | {"usize": (64, False), "isize": (64, True)}


@dataclasses.dataclass(frozen=True)
class Constant:
    path: str
    type: str
    value: str
    section: str
    documentation: str
    # The file, and where the value is in its text.
    file: str
    span: tuple


def constants_of(part, text):
    """Returns the constants in the text of a file of src/constants, in their order."""
    found, section, at = [], "", 0
    for match in CONSTANT.finditer(text):
        before = text[at:match.start()]
        # A comment that is not documentation is the title of a section.
        title = [line[3:] for line in before.splitlines() if line.startswith("// ")]
        section = " ".join(title) if title else section
        lines = re.search(r"(?:^///[^\n]*\n|^#\[[^\n]*\n)*\Z", before, re.M)[0].splitlines()
        documentation = " ".join(line[3:].strip() for line in lines if line.startswith("///"))
        value = " ".join(match[3].split())
        found.append(Constant(f"{part}::{match[1]}", match[2], value, section, documentation, f"{part}.rs", match.span(3)))
        at = match.end()
    return found


def all_constants(folder):
    return [constant for file in sorted(folder.glob("*.rs")) for constant in constants_of(file.stem, file.read_text())]


def split(text):
    """Splits text at the commas outside brackets."""
    parts, depth = [""], 0
    for letter in text:
        depth += (letter in "[(") - (letter in "])")
        if letter == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return [part.strip() for part in parts if part.strip()]


def rust(value, kind):
    """Returns a value as it is written in Rust. Raises `ValueError` if it does not have the type. Only values of numbers, and
    of arrays, tuples and ranges of them, are checked here; the compiler checks those of other types."""
    value = value.strip()
    wrong = ValueError(f"{value} is not a value of the type {kind}")
    if kind in ("f32", "f64"):
        if not re.fullmatch(r"-?[\d_]+(\.[\d_]*)?([eE][-+]?\d+)?", value) or not re.search(r"\d", value):
            raise wrong
        return value if re.search(r"[.eE]", value) else f"{value}.0"
    if kind in INTEGERS:
        bits, signed = INTEGERS[kind]
        if not re.fullmatch(r"-?\d[\d_]*", value):
            raise wrong
        if not -signed << (bits - 1) <= int(value) < 1 << (bits - signed):
            raise wrong
        return value
    if array := re.fullmatch(r"\[(.+); (\d+)\]", kind):
        inner = re.fullmatch(r"\[(.*)\]", value, re.S)
        parts = split(inner[1]) if inner else []
        if len(parts) != int(array[2]):
            raise wrong
        return f"[{', '.join(rust(part, array[1]) for part in parts)}]"
    if kinds := re.fullmatch(r"\((.+)\)", kind):
        inner = re.fullmatch(r"\((.*)\)", value, re.S)
        parts = split(inner[1]) if inner else []
        if len(parts) != len(split(kinds[1])):
            raise wrong
        return f"({', '.join(rust(part, each) for part, each in zip(parts, split(kinds[1])))})"
    if ends := re.fullmatch(r"RangeInclusive<(\w+)>", kind):
        if value.count("..=") != 1:
            raise wrong
        return "..=".join(rust(end, ends[1]) for end in value.split("..="))
    return value


def same(a, b):
    """Whether two values in Rust are equal, as far as they are literals."""
    try:
        literals = [ast.literal_eval(re.sub(r"(?<=\d)\.\.=(?=[\d-])", ",", text)) for text in (a, b)]
        return literals[0] == literals[1]
    except (ValueError, SyntaxError):
        return "".join(a.split()) == "".join(b.split())


def replaced(text, constant, value):
    """Returns the text of the constant's file with another value."""
    return text[:constant.span[0]] + value + text[constant.span[1]:]


def copy_of_repository(folder):
    """Copies the files of the repository as they are now, without those that git ignores. Their times are those of the
    copy, so that cargo takes no file for one of an earlier build in the same target folder."""
    listed = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=root, capture_output=True, check=True).stdout
    for name in listed.decode().split("\0"):
        if name and ((root / name).is_file() or (root / name).is_symlink()):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(root / name, folder / name, follow_symlinks=False)


def built(folder, target, constant, text, value, to):
    """Builds the program with a value of the constant in `text`, as the file `to`."""
    (folder / FOLDER / constant.file).write_text(replaced(text, constant, value))
    print(f"building with {constant.path} = {value}", file=sys.stderr, flush=True)
    command = ["cargo", "build", "--release", "-q", "-p", "ssplat-cli", "--manifest-path", folder / "Cargo.toml", "--target-dir", target]
    # A group of its own, so that the compilers end with cargo.
    cargo = subprocess.Popen(command, env=os.environ | {"CARGO_INCREMENTAL": "1"}, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        said = cargo.communicate()[1]
    except BaseException:
        os.killpg(cargo.pid, signal.SIGKILL)
        raise
    if cargo.returncode:
        raise SystemExit(f"{constant.path} = {value} does not build:\n{said}")
    shutil.copy2(target / "release/ssplat", to)


def measure(args, constant, values, temporary):
    """Returns the files of each value, by picture and ratio."""
    import sets
    folder, target = temporary / "repository", (args.target or temporary / "target").resolve()
    copy_of_repository(folder)
    text = (folder / FOLDER / constant.file).read_text()
    programs = []
    for i, value in enumerate(values):
        built(folder, target, constant, text, value, temporary / f"ssplat{i}")
        programs.append(f"{i}={temporary}/ssplat{i}")
    options = args.options + (f" --effort {args.effort}" if args.effort else "")
    lab = sets.Lab(argparse.Namespace(
        programs=programs, cache=temporary / "files", pictures=args.pictures[0], half=args.half, only=args.only, options=options, crop=0, kind="rgb", repeat=1))
    files = [picture for picture in args.pictures if picture.is_file()]
    pictures = [lab.pixels(picture) for picture in files] if files else [p for name in args.sets.split(",") for p in lab.pictures(name)]
    if not pictures:
        raise SystemExit("no pictures")
    return {ratio: [[lab.ours(str(i), picture, ratio) | {"name": picture.stem} for picture in pictures] for i in range(len(values))] for ratio in args.ratio.split(",")}


def table_of(values, present, files):
    """The table of a ratio: `files` has those of each value, one for each picture."""
    from other_codecs import mean
    from report import number, signed, table
    rows, of_present = [], files[present]
    for value, made in zip(values, files):
        of = lambda key: mean(file[key] for file in made)
        gain = lambda key: mean(None if None in (a[key], b[key]) else a[key] - b[key] for a, b in zip(made, of_present))
        worst = min(((a["ssimulacra2"] - b["ssimulacra2"], a["name"]) for a, b in zip(made, of_present)))
        row = [value, number(of("bytes"), 0), number(of("psnr"), 2), number(of("ssimulacra2"), 2), number(of("seconds"), 2)]
        if made is of_present:
            row = [f"{value} (present)", *row[1:], "", "", "", ""]
        else:
            seconds = of("seconds") / mean(file["seconds"] for file in of_present)
            row += [signed(gain("psnr"), 3), signed(gain("ssimulacra2"), 2), f"{signed(worst[0], 1)} {worst[1]}", number(seconds, 2)]
        rows.append(row)
    return table(["value", "bytes", "PSNR, dB", "SSIMULACRA2", "CPU s", "gain, dB", "gain, points", "worst picture", "time"], rows)


def named(ratio):
    return f"quality {ratio[1:]}" if ratio.startswith("q") else f"ratio {ratio}"


def print_list(constants, word):
    part, section = None, None
    for constant in constants:
        if word.lower() not in f"{constant.path} {constant.documentation}".lower():
            continue
        if constant.section != section:
            print(f"\n{constant.section}")
        part, section = constant.file, constant.section
        print(f"  {constant.path}: {constant.type} = {constant.value}")
        print(textwrap.fill(constant.documentation, 110, initial_indent="      ", subsequent_indent="      "))


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("constant", nargs="?", help="its path, such as detail::MIXED_COST; with --list, a word")
    parser.add_argument("values", nargs="*", help="values as in Rust")
    parser.add_argument("--list", action="store_true", help="print the constants")
    parser.add_argument("--self-test", action="store_true", help="test how constants and values are read")
    parser.add_argument("--pictures", nargs="+", type=pathlib.Path, metavar="PICTURE")
    parser.add_argument("--sets", default="kodak")
    parser.add_argument("--half", choices=["choose", "judge", "all"], default="choose")
    parser.add_argument("--only", default="", help="pictures of the sets whose names contain one of these words, separated by commas")
    parser.add_argument("--ratio", default="50", help="ratios, or qualities such as q70, separated by commas")
    parser.add_argument("--effort", type=int)
    parser.add_argument("--options", default="", help="further options of encode")
    parser.add_argument("--target", type=pathlib.Path, help="target folder of the builds, for this command alone; by default a temporary one")
    return parser.parse_args()


def main():
    args = arguments()
    if args.self_test:
        return self_test()
    constants = all_constants(root / FOLDER)
    if args.list:
        return print_list(constants, args.constant or "")
    constant = next((c for c in constants if c.path == args.constant), None)
    if not constant:
        similar = difflib.get_close_matches(args.constant or "", [c.path for c in constants], 3, 0.5)
        raise SystemExit(f"{args.constant} is not a constant of {FOLDER}" + (f"; did you mean {' or '.join(similar)}?" if similar else "; --list prints all"))
    try:
        values = [rust(value, constant.type) for value in args.values]
    except ValueError as error:
        raise SystemExit(f"{constant.path}: {error}") from None
    if not values:
        raise SystemExit(f"{constant.path} is {constant.value}; which other values?")
    if not args.pictures:
        raise SystemExit("--pictures is missing")
    if lost := [str(picture) for picture in args.pictures if not picture.exists()]:
        raise SystemExit(f"there is no {', '.join(lost)}")
    present = next((i for i, value in enumerate(values) if same(value, constant.value)), None)
    if present is None:
        values, present = [constant.value, *values], 0
    # The temporary folder is removed at a signal as well.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    with tempfile.TemporaryDirectory(prefix="ssplat-constants-") as temporary:
        found = measure(args, constant, values, pathlib.Path(temporary))
        for ratio, files in found.items():
            print(f"\n{constant.path}, {named(ratio)}, {len(files[0])} pictures\n\n{table_of(values, present, files)}")


def self_test():
    text = '''//! A part.

// First section,
// on two lines.

/// What it bounds, on
/// two lines.
pub(crate) const FACTOR: f64 = 1.5;
/// Gated.
#[cfg(feature = "quality-hook")]
pub(crate) const LIMITS: [f32; 2] = [FACTOR, 2.0];

// Second.

/// A table.
pub(crate) const ROWS: [[f64; 2]; 2] = [
    [0.5, 1.0], // a remark
    [1.5, -2.0],
];
/// Broken.
pub(crate) const KNOTS: &[Knot] =
    &[Knot { step: 1, slopes: [2, 3] }];
'''
    found = {constant.path: constant for constant in constants_of("part", text)}
    assert list(found) == ["part::FACTOR", "part::LIMITS", "part::ROWS", "part::KNOTS"], list(found)
    factor, limits, rows, knots = found.values()
    assert (factor.type, factor.value, factor.documentation) == ("f64", "1.5", "What it bounds, on two lines."), factor
    assert factor.section == limits.section == "First section, on two lines." and rows.section == "Second.", found
    assert (limits.type, limits.documentation) == ("[f32; 2]", "Gated."), limits
    assert knots.value == "&[Knot { step: 1, slopes: [2, 3] }]", knots
    assert replaced(text, factor, "2.5") == text.replace("FACTOR: f64 = 1.5;", "FACTOR: f64 = 2.5;")
    assert "KNOTS: &[Knot] =\n    &[];" in replaced(text, knots, "&[]")
    good = [("1", "f64", "1.0"), ("1e-3", "f32", "1e-3"), ("-0.5", "f32", "-0.5"), ("8_200.0", "f64", "8_200.0"), ("3", "u8", "3"), ("-3", "i16", "-3"), ("255", "u8", "255"),
            ("[1, 2.5]", "[f64; 2]", "[1.0, 2.5]"), ("[[1, 2], [3, 4]]", "[[u8; 2]; 2]", "[[1, 2], [3, 4]]"), ("(1, 2)", "(f32, usize)", "(1.0, 2)"), ("1..=2", "RangeInclusive<u64>", "1..=2"),
            ("&[]", "&[Knot]", "&[]")]
    for value, kind, wanted in good:
        assert rust(value, kind) == wanted, (value, kind, rust(value, kind))
    bad = [("a", "f64"), ("1.5", "u32"), ("-1", "u32"), ("256", "u8"), ("1.5f32", "f64"), ("[1, 2]", "f64"), ("1", "[f64; 2]"), ("[1, 2, 3]", "[f64; 2]"), ("[1, a]", "[f64; 2]"), ("", "f64"),
           ("_", "f64"), ("1.0; std::process::exit(0)", "f64"), ("(1)", "(f32, usize)"), ("1..2", "RangeInclusive<u64>")]
    for value, kind in bad:
        try:
            rust(value, kind)
        except ValueError as error:
            assert "is not a value of the type" in str(error)
        else:
            raise AssertionError(f"{value} is no {kind}")
    assert same("1.0", "1.00") and same("[1.0, 2.0]", "[1,2]") and same("8_200.0", "8200.0") and not same("1.0", "1.5")
    assert same("2.0 / 3.0", "2.0/3.0") and not same("2.0 / 3.0", "0.5")
    # The real files are read completely.
    for file in sorted((root / FOLDER).glob("*.rs")):
        read = constants_of(file.stem, file.read_text())
        assert len(read) == file.read_text().count("pub(crate) const "), file
        assert all(constant.documentation and (constant.section or constant.file == "mod.rs") for constant in read), [c.path for c in read if not c.documentation]
    assert len({constant.path for constant in all_constants(root / FOLDER)}) == len(all_constants(root / FOLDER)) > 300


if __name__ == "__main__":
    main()
