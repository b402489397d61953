#!/usr/bin/env python3
"""Runs a decoder over the conformance vectors: python3 check.py [--reduced] [--partial] [--unsupported STATUS] [COMMAND...]

COMMAND is called with two more arguments, a .ssplat file and the picture to write (PAM, or PGM or PPM with raw samples).
It shall write the picture and exit with 0, or write nothing and exit with another status. With --reduced, it is also asked
for pictures of other sizes, which decoders need not offer: by `--width W --height H` behind the two; with --partial, for what
is left of damaged files: by `--partial` behind the two. Without COMMAND, decode.py
beside this file is checked, with both. With --unsupported, COMMAND is a decoder of a part of the format: it exits with STATUS for
files that it does not support, and these are counted as skipped rather than as failures. All others have to be right. `check.py --control` checks the checker: decoders that are wrong on purpose shall fail.

Each vector is a folder with file.ssplat, case.txt (what it shows, its SHA-256, what to expect) and, where a picture is
expected, picture.pam.
"""

import contextlib
import hashlib
import io
import pathlib
import re
import subprocess
import sys
import tempfile

import numpy as np

import decode

HERE = pathlib.Path(__file__).resolve().parent
SECONDS = 60


def read_picture(path):
    """Returns the samples, rows × columns × channels, and the largest code value of a PAM, PGM or PPM."""
    data = path.read_bytes()
    if data[:2] == b"P7":
        head, body = data.split(b"ENDHDR\n", 1)
        fields = dict(line.split(b" ", 1) for line in head.split(b"\n")[1:] if b" " in line)
        width, height, channels, top = (int(fields[k]) for k in (b"WIDTH", b"HEIGHT", b"DEPTH", b"MAXVAL"))
    else:
        kind, width, height, top = re.match(rb"(P[56])\s+(\d+)\s+(\d+)\s+(\d+)\s", data).groups()
        channels, width, height, top = {b"P5": 1, b"P6": 3}[kind], int(width), int(height), int(top)
        body = data[len(data) - width * height * channels * (2 if top > 255 else 1) :]
    samples = np.frombuffer(body, ">u2" if top > 255 else "u1").astype(int)
    return samples.reshape(height, width, channels), top


def worst_of(got, want, top, reduced):
    """Returns the largest difference. In a reduced picture, colours have less weight where alpha is below 1/16 (§5.5)."""
    off = abs(got - want).astype(float)
    if reduced and want.shape[2] in (2, 4):
        off[..., :-1] *= np.minimum(1, 16 * want[..., -1:] / top)
    return off.max()


class Unsupported(Exception):
    """The decoder says that it does not support the file."""


def problem_of(run, case, folder, out, unsupported=None):
    """Returns a description of the decoder's mistake, or None. Raises Unsupported for an exit status of `unsupported`."""
    width, height = case.get("size", " ").split(" ")
    options = ["--width", width, "--height", height] if width else ["--partial"] if "partial" in case else []
    status = run(folder / "file.ssplat", out, *options)
    if status is None:
        return f"took more than {SECONDS} s"
    if status < 0 or status >= 128:
        return f"crashed with status {status}"
    if status == unsupported and not out.exists():
        raise Unsupported
    if case["expect"] == "error":
        if status == 0:
            return "accepted the file"
        return "wrote a picture for a file that it refused" if out.exists() else None
    if status != 0:
        return f"refused the file with status {status}"
    if not out.exists():
        return "wrote no picture"
    (got, top), (want, right_top) = read_picture(out), read_picture(folder / "picture.pam")
    if (got.shape, top) != (want.shape, right_top):
        return f"wrote {got.shape} up to {top} in place of {want.shape} up to {right_top}"
    worst = worst_of(got, want, top, bool(width))
    return f"differs by {worst:g}" if worst > int(case["tolerance"]) else None


def check(run, optional=("reduced", "partial"), show=True, unsupported=None):
    """Runs the vectors. Returns their number, the failures, and those that the decoder does not support."""
    folders = sorted(p.parent for p in (HERE / "vectors").glob("*/*/case.txt"))
    folders = [f for f in folders if f.parent.name in ("valid", "invalid", "limits", *optional)]
    problems, skipped = [], []
    with tempfile.TemporaryDirectory() as temporary:
        for folder in folders:
            name = f"{folder.parent.name}/{folder.name}"
            case = dict(line.split(": ", 1) for line in (folder / "case.txt").read_text().splitlines())
            if hashlib.sha256((folder / "file.ssplat").read_bytes()).hexdigest() != case["sha256"]:
                problem = "the vector's file is not the one that its case names"
            else:
                out = pathlib.Path(temporary) / "out.pam"
                out.unlink(missing_ok=True)
                try:
                    problem = problem_of(run, case, folder, out, unsupported)
                except Unsupported:
                    skipped.append(name)
                    continue
            if problem:
                problems.append(name)
                if show:
                    print(f"{name}: {problem} ({case['shows']})")
    return len(folders), problems, skipped


def by_command(command):
    def run(file, out, *options):
        try:
            return subprocess.run([*command, file, out, *options], capture_output=True, timeout=SECONDS).returncode
        except subprocess.TimeoutExpired:
            return None

    return run


def by_decode(file, out, *options):
    with contextlib.redirect_stderr(io.StringIO()):
        return decode.main([str(file), str(out), *options])


# Parts of the detail layer that a decoder might lack: their code, and its replacement without them.
LEFT_OUT_FROM = {
    "the detail layer": (decode, "additions"),
    "lapping": (decode, "lap"),
    "slopes": (decode.DetailHead, "steps"),
}
LEFT_OUT = {
    "the detail layer": lambda header, tiles, size: np.zeros((size[1], size[0], header.channels)),
    "lapping": lambda plane, sizes: None,
    "slopes": lambda head, plane, step_class, size: np.full((4 << size, 4 << size), max(1, head.step * head.ratio[plane] // 16)),
}


def control():
    """Returns decoders with one fault each, and the vectors that must detect them."""

    def off_by(amount):
        def run(file, out, *options):
            status = by_decode(file, out, *options)
            if status == 0:
                data = bytearray(out.read_bytes())
                data[-1] = (data[-1] + amount) % 256
                out.write_bytes(data)
            return status

        return run

    def accepts_all(file, out, *options):
        status = by_decode(file, out, *options)
        if status != 0:
            out.write_bytes(b"P5 1 1 255 \0")
        return 0

    def crashes(file, out, *options):
        return by_decode(file, out, *options) and -11

    def leaves_half(file, out, *options):
        status = by_decode(file, out, *options)
        out.touch()
        return status

    def cuts_a_row(file, out, *options):
        status = by_decode(file, out, *options)
        if status == 0:
            samples, top = read_picture(out)
            head = f"P7\nWIDTH {samples.shape[1]}\nHEIGHT {samples.shape[0] - 1}\nDEPTH {samples.shape[2]}\nMAXVAL {top}\nENDHDR\n"
            out.write_bytes(head.encode() + samples[1:].astype(">u2" if top > 255 else "u1").tobytes())
        return status

    def without(name, put):
        def run(file, out, *options):
            there = getattr(*LEFT_OUT_FROM[name])
            setattr(*LEFT_OUT_FROM[name], put)
            try:
                return by_decode(file, out, *options)
            finally:
                setattr(*LEFT_OUT_FROM[name], there)

        return run

    expected = {"off by 100": off_by(100), "accepts all": accepts_all, "crashes": crashes}
    expected |= {"ignores the size": lambda file, out, *options: by_decode(file, out), "refuses all": lambda file, out, *options: 1, "leaves half a file": leaves_half, "cuts a row": cuts_a_row}
    expected |= {f"leaves out {name}": without(name, put) for name, put in LEFT_OUT.items()}
    unseen = 0
    for name, run in expected.items():
        count, problems, _ = check(run, show=False)
        print(f"a decoder that {name}: {len(problems)} of {count} vectors fail")
        unseen += not problems

    def packed_only(status):
        """A partial decoder, which refuses all layouts but the packed one with `status`."""

        def run(file, out, *options):
            flags = file.read_bytes()[5:6]
            return status if flags and flags[0] & 3 else by_decode(file, out, *options)

        return run

    # A partial decoder passes if it says so by the agreed status, and fails if it does so by another.
    count, problems, skipped = check(packed_only(5), ("reduced",), show=False, unsupported=5)
    print(f"a decoder of the packed layout: {len(problems)} of {count} vectors fail, {len(skipped)} are skipped")
    unseen += bool(problems) or not 0 < len(skipped) < count
    unseen += not check(packed_only(4), ("reduced",), show=False, unsupported=5)[1]
    return unseen


def main(arguments):
    if arguments == ["--control"]:
        return 1 if control() else 0
    command, optional, unsupported = list(arguments), [], None
    while command and command[0] in ("--reduced", "--partial", "--unsupported"):
        option = command.pop(0)[2:]
        if option != "unsupported":
            optional.append(option)
        elif command and command[0].isdecimal() and 1 <= int(command[0]) < 128:
            unsupported = int(command.pop(0))
        else:
            sys.exit("check.py: --unsupported needs an exit status, 1 to 127")
    count, problems, skipped = check(by_command(command), optional, unsupported=unsupported) if command else check(by_decode)
    passed = count - len(problems) - len(skipped)
    print(f"{passed} of {count} vectors pass" + (f", {len(skipped)} are not supported" if skipped else ""))
    return 1 if problems or passed == 0 else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
