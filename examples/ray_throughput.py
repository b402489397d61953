#!/usr/bin/env python3
"""Compares the speed of `ray_encode.py` on this machine with the program under `xargs -P`, on the same pictures.

    cargo build --release
    python examples/ray_throughput.py photos/ --times 4 --rounds 3

Both encode at the same effort and ratio, with one thread per picture and one picture per core. `ray_encode.py` also
decodes every file and measures PSNR and MS-SSIM for its manifest; with `--compare`, xargs does the same. Each round runs
both, in alternating order. The time for starting the cluster is not included, because it is negligible for many
pictures. The time for loading the package in each worker is included.
"""

import argparse
import os
import pathlib
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

import ray_encode


def with_xargs(program, pictures, out, options, cores, compare):
    """Returns the seconds of the program, started once for each picture."""
    script = f'"{program}" encode "$1" "$2/${{1##*/}}.ssplat" --threads 1 --quiet {options}'
    if compare:
        script += f' && "{program}" compare "$1" "$2/${{1##*/}}.ssplat" --threads 1 >/dev/null'
    os.makedirs(out)
    names = "\0".join(str(path) for path in pictures).encode()
    start = time.perf_counter()
    command = ["xargs", "-0", f"-P{cores}", "-I{}", "sh", "-c", script, "sh", "{}", out]
    subprocess.run(command, input=names, check=True)
    return time.perf_counter() - start


def with_ray(source, out, options):
    """Returns the seconds of the example."""
    start = time.perf_counter()
    ray_encode.run(str(source), out, options)
    return time.perf_counter() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pictures", type=pathlib.Path)
    parser.add_argument("--program", default="target/release/ssplat")
    parser.add_argument("--effort", type=int, default=1)
    parser.add_argument("--ratio", type=float, default=50)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--times", type=int, default=1, help="number of copies of each picture")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--compare", action="store_true", help="xargs measures the pictures too")
    a = parser.parse_args()
    import ray

    program = shutil.which(a.program) or sys.exit(f"{a.program}: build it first")
    os.environ["PYTHONPATH"] = os.path.dirname(os.path.abspath(__file__))
    ray.init(num_cpus=a.cores, include_dashboard=False, logging_level="error")
    ray.data.DataContext.get_current().enable_progress_bars = False
    options = {"ratio": a.ratio, "effort": a.effort}
    ratios, seconds = [], ([], [])
    with tempfile.TemporaryDirectory() as folder:
        source = pathlib.Path(folder, "in")
        source.mkdir()
        for path in sorted(a.pictures.glob("*.png")):
            for k in range(a.times):
                shutil.copy(path, source / f"{k}-{path.name}")
        pictures = sorted(source.iterdir())
        for k in range(a.rounds):
            runs = [
                lambda: with_xargs(
                    os.path.abspath(program),
                    pictures,
                    f"{folder}/xargs{k}",
                    f"--ratio {a.ratio} --effort {a.effort}",
                    a.cores,
                    a.compare,
                ),
                lambda: with_ray(source, f"{folder}/ray{k}", options),
            ]
            order = [0, 1] if k % 2 == 0 else [1, 0]
            took = {i: runs[i]() for i in order}
            same = all(
                pathlib.Path(folder, f"ray{k}", f"{path.name}.ssplat").read_bytes()
                == pathlib.Path(folder, f"xargs{k}", f"{path.name}.ssplat").read_bytes()
                for path in pictures
            )
            ratios.append(took[0] / took[1])
            for i in order:
                seconds[i].append(took[i])
            print(
                f"round {k + 1}: {len(pictures)} pictures; xargs {took[0]:.1f} s, Ray {took[1]:.1f} s, "
                f"throughput {ratios[-1]:.3f} of xargs'; files {'equal' if same else 'differ'}",
                flush=True,
            )
    print(f"all: {sum(seconds[0]) / sum(seconds[1]):.3f} of xargs' throughput, median {statistics.median(ratios):.3f}")


if __name__ == "__main__":
    main()
