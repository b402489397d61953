"""Encodes the test pictures of other projects, to test how the program reads input pictures:

    python lab/test_pictures.py SSPLAT FOLDER_OR_ARCHIVE...

Archives are tar files: Pillow's source distribution from PyPI (`pip download --no-binary pillow --no-deps pillow`, with setuptools
and pybind11), and `git archive` of the `image` crate. Each file is encoded with the shortest fit, in an address space of 6 GB. The run
fails if the program panics, is killed, hangs for a minute, exits with a status that bad pictures do not have, or uses more than
`MOST_RESIDENT` bytes of memory. Prints the number of files by outcome.
"""

import collections
import os
import resource
import signal
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

ADDRESS_SPACE = 6_000_000_000
#: Maximum resident memory, bytes. The test pictures are small, although some declare large sizes.
MOST_RESIDENT = 1 << 30
SECONDS = 60
#: Meanings of the program's exit statuses.
STATUSES = {0: "decoded", 3: "not readable", 4: "broken", 5: "unsupported", 6: "over the limits"}


def run(program: str, path: Path) -> tuple[str, str, int]:
    """Returns the outcome for a file, the messages, and the peak resident memory in bytes."""

    def bounded() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))

    options = ["--effort", "1", "--bytes", "4000", "--time", "0.001", "--metadata", "none"]
    command = [program, "encode", *options, "--force", str(path), os.devnull]
    with tempfile.TemporaryFile() as said:
        child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=said, preexec_fn=bounded)
        signal.alarm(SECONDS)
        try:
            _, status, usage = os.wait4(child.pid, 0)
        except TimeoutError:
            child.kill()
            os.wait4(child.pid, 0)
            return "HANG", "", 0
        finally:
            signal.alarm(0)
        child.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        text = said.read().decode(errors="replace").strip()
    outcome = STATUSES.get(child.returncode, f"STATUS {child.returncode}")
    if "panicked" in text or "a bug of ssplat" in text:
        outcome = "PANIC"
    elif "its decoder failed unexpectedly" in text:
        outcome = "broken, by a panic of its decoder"
    elif usage.ru_maxrss * 1024 > MOST_RESIDENT:
        outcome = "MEMORY"
    return outcome, text, usage.ru_maxrss * 1024


def files(paths: list[str], folder: str) -> list[Path]:
    """All files below folders named `images` in folders and archives, which are unpacked into `folder`."""
    found: list[Path] = []
    for path in paths:
        if not os.path.isdir(path):
            target = Path(folder, Path(path).name)
            with tarfile.open(path) as archive:
                archive.extractall(target, filter="data")
            path = str(target)
        found += sorted(p for p in Path(path).rglob("*") if p.is_file() and "images" in p.parts)
    return found


def on_alarm(*_: object) -> None:
    raise TimeoutError


def main() -> None:
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    signal.signal(signal.SIGALRM, on_alarm)
    counts: collections.Counter[str] = collections.Counter()
    most = 0
    with tempfile.TemporaryDirectory() as folder:
        for path in files(sys.argv[2:], folder):
            outcome, text, resident = run(sys.argv[1], path)
            counts[outcome] += 1
            most = max(most, resident)
            if outcome.isupper() or "panic" in outcome or "STATUS" in outcome:
                print(f"{path}: {outcome}: {text}")
    for outcome, count in counts.most_common():
        print(f"{count:6} {outcome}")
    print(f"most resident: {most / 2**20:.0f} MiB")
    sys.exit(any(word.split()[0].isupper() for word in counts))


if __name__ == "__main__":
    main()
