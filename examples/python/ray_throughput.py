#!/usr/bin/env python3
"""Throughput of ray_encode.py beside the program under xargs, on the same pictures, by turns.

    python examples/python/ray_throughput.py PICTURES target/release/ssplat --rounds 3

Both use two processes of one thread each. Ray's rows also hold PSNR and MS-SSIM, for which every file is decoded again;
xargs measures nothing. The start of the cluster is told apart: it is paid once, whatever the number of pictures.
"""

import argparse
import os
import pathlib
import subprocess
import sys
import tempfile
import time

EXAMPLES = str(pathlib.Path(__file__).resolve().parents[1])
sys.path.insert(0, EXAMPLES)

import ray_encode


def by_xargs(program, pictures, source, out, options):
    for name in pictures:
        pathlib.Path(out, name).parent.mkdir(parents=True, exist_ok=True)
    words = [f"--{name}={value}" for name, value in options.items()]
    command = ["xargs", "-0", "-P2", "-I{}", program, "encode", f"{source}/{{}}", f"{out}/{{}}.ssplat", *words]
    environment = os.environ | {"RAYON_NUM_THREADS": "1"}
    start = time.perf_counter()
    subprocess.run(command, input="\0".join(pictures).encode(), env=environment, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pictures")
    parser.add_argument("program")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--ratio", type=float, default=50)
    parser.add_argument("--effort", type=int, default=1)
    parser.add_argument("--block", type=int, default=1)
    a = parser.parse_args()
    import ray

    source, program = os.path.abspath(a.pictures), os.path.abspath(a.program)
    options = {"effort": a.effort, "ratio": a.ratio}
    pictures = ray_encode.list_pictures(source)
    start = time.perf_counter()
    environment = {"env_vars": {"PYTHONPATH": EXAMPLES}}
    ray.init(num_cpus=2, include_dashboard=False, logging_level="error", runtime_env=environment)
    print(f"{len(pictures)} pictures; the cluster started in {time.perf_counter() - start:.1f} s")
    totals = [0.0, 0.0]
    for round_ in range(a.rounds):
        with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
            start = time.perf_counter()
            ray_encode.run(source, one, options, block=a.block)
            seconds = [time.perf_counter() - start, by_xargs(program, pictures, source, other, options)]
            for name in pictures:
                files = [pathlib.Path(folder, name + ".ssplat").read_bytes() for folder in (one, other)]
                assert files[0] == files[1], name
        totals = [t + s for t, s in zip(totals, seconds)]
        print(f"round {round_ + 1}: Ray {seconds[0]:.1f} s, xargs -P2 {seconds[1]:.1f} s")
    ratio = totals[1] / totals[0]
    print(f"throughput of Ray over that of xargs -P2: {ratio:.2f}; all files are equal")


if __name__ == "__main__":
    main()
