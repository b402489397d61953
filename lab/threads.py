#!/usr/bin/env python3
"""Measures what threads and time limits do to an encode.

    python lab/threads.py target/release/ssplat PICTURE... [--efforts 1,5] [--threads 1,2,4,8] [--ratio 50]
    python lab/threads.py target/release/ssplat PICTURE... --times 0.2,0.5,1,2

The first command prints the wall-clock and CPU seconds of an encode for each number of threads, then those of as many encodes with one
thread each that run at once, which shows what the machine itself loses when its cores are busy. The second prints the seconds, the
effort and the SSIMULACRA2 score of an encode with each time limit, and of each effort without one. It needs Linux or macOS.
"""
import argparse, json, pathlib, resource, subprocess, tempfile, time


def cpu():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measured(commands):
    """Runs commands at once. Returns their wall-clock seconds, their CPU seconds and the outputs."""
    before, start = cpu(), time.perf_counter()
    running = [subprocess.Popen(command, stdout=subprocess.PIPE) for command in commands]
    outputs = [process.communicate()[0] for process in running]
    if any(process.returncode for process in running):
        raise SystemExit(f"{commands[0]} failed")
    return time.perf_counter() - start, cpu() - before, outputs


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("pictures", type=pathlib.Path, nargs="+")
    parser.add_argument("--efforts", default="1,5")
    parser.add_argument("--threads", default="1,2,4,8", help="numbers of threads, separated by commas")
    parser.add_argument("--times", default="", help="time limits in seconds, separated by commas")
    parser.add_argument("--ratio", default="50")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        files = [f"{folder}/{i}.ssplat" for i in range(64)]

        def encode(picture, threads, options, file=files[0]):
            return [args.program, "--threads", threads, "encode", picture, file, "--backend", "cpu", "--ratio", args.ratio, "--json", *options]

        def score(picture):
            return json.loads(measured([[args.program, "compare", picture, files[0], "--json"]])[2][0])["ssimulacra2"]

        for picture in args.pictures:
            for effort in args.efforts.split(",") if not args.times else ():
                for threads in args.threads.split(","):
                    wall, used, _ = measured([encode(picture, threads, ["--effort", effort])])
                    each = measured([encode(picture, "1", ["--effort", effort], file) for file in files[: int(threads)]])[1] / int(threads)
                    print(f"{picture.stem} effort {effort}, {threads} threads: {wall:.2f} s, CPU {used:.2f} s; {threads} encodes at once: CPU {each:.2f} s each", flush=True)
            if not args.times:
                continue
            for options in [["--effort", effort] for effort in args.efforts.split(",")] + [["--time", limit] for limit in args.times.split(",")]:
                wall, used, [report] = measured([encode(picture, args.threads.split(",")[0], options)])
                print(f"{picture.stem} {' '.join(options)}: {wall:.2f} s, CPU {used:.2f} s, effort {json.loads(report)['effort']}, {score(picture):.1f} points", flush=True)


if __name__ == "__main__":
    main()
