"""Measures the effect of the detail layer: the table of docs/studies/detail-layer.md.

    python3 examples/python/two_layers.py PICTURES... --program NAME=target/release/ssplat [--program NAME=OTHER]
        [--ratio 20 50 100 200]

Each picture is encoded by each program at each ratio, with the defaults and with --tune psnr, on one thread. For each
ratio and program, a row has the means of PSNR (dB) for both, and of SSIMULACRA2, MS-SSIM, Butteraugli and CPU seconds
for the defaults. A list of pictures follows on which the last program is worse than the first: by more than 0.05 dB with
--tune psnr, or 0.3 points of SSIMULACRA2 without. Each program measures its own files, because formats may differ.
"""
import argparse
import concurrent.futures
import os
import pathlib
import re
import statistics
import subprocess
import tempfile

MEASURES = ("PSNR", "MS-SSIM", "SSIMULACRA2", "Butteraugli")


def measured(program, picture, ratio, options, folder):
    """Encodes, and returns the measures of the same program's `compare`, the CPU seconds and the size."""
    handle, file = tempfile.mkstemp(".ssplat", dir=folder)
    os.close(handle)
    os.remove(file)
    file = pathlib.Path(file)
    environment = {**os.environ, "RAYON_NUM_THREADS": "1"}
    encode = subprocess.Popen([program, "encode", picture, file, "--ratio", str(ratio), "--quiet", *options], env=environment)
    _, status, used = os.wait4(encode.pid, 0)
    if status:
        raise SystemExit(f"{program} encode {picture} --ratio {ratio} failed")
    said = subprocess.run([program, "compare", picture, file], env=environment, capture_output=True, text=True, check=True).stdout
    found = {name: float(re.search(rf"(?:^|, ){name} (-?[\d.]+|inf)", said)[1]) for name in MEASURES}
    return {**found, "seconds": used.ru_utime + used.ru_stime, "bytes": file.stat().st_size}


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("pictures", nargs="+", type=pathlib.Path)
    arguments.add_argument("--program", action="append", required=True, metavar="NAME=PATH")
    arguments.add_argument("--ratio", type=float, nargs="+", default=[20, 50, 100, 200])
    arguments.add_argument("--jobs", type=int, default=2)
    arguments = arguments.parse_args()
    programs = [named.split("=", 1) for named in arguments.program]
    behind = []
    print("| ratio | | PSNR, `--tune psnr` | PSNR | SSIMULACRA2 | MS-SSIM | Butteraugli | CPU s | bytes |")
    print("|--:|---|--:|--:|--:|--:|--:|--:|--:|")
    with tempfile.TemporaryDirectory() as folder, concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        for ratio in arguments.ratio:
            rows = {}
            for name, program in programs:
                for tune, options in (("psnr", ["--tune", "psnr"]), ("default", [])):
                    work = lambda picture: measured(program, picture, ratio, options, pathlib.Path(folder))
                    rows[name, tune] = list(pool.map(work, arguments.pictures))
            for name, _ in programs:
                mean = lambda tune, measure: statistics.fmean(row[measure] for row in rows[name, tune])
                print(
                    f"| {ratio:g} | {name} | {mean('psnr', 'PSNR'):.2f} | {mean('default', 'PSNR'):.2f} | {mean('default', 'SSIMULACRA2'):.1f} "
                    f"| {mean('default', 'MS-SSIM'):.4f} | {mean('default', 'Butteraugli'):.2f} | {mean('default', 'seconds'):.2f} | {mean('default', 'bytes'):.0f} |",
                    flush=True,
                )
            first, last = programs[0][0], programs[-1][0]
            for tune, measure, allowed in (("psnr", "PSNR", 0.05), ("default", "SSIMULACRA2", 0.3)):
                for picture, a, b in zip(arguments.pictures, rows[first, tune], rows[last, tune]):
                    if b[measure] < a[measure] - allowed:
                        behind.append(f"{picture.stem} at {ratio:g}, {measure}: {b[measure]} instead of {a[measure]}")
    print("\nbehind:", "; ".join(behind) or "none")


main()
