#!/usr/bin/env python3
"""Compares files without loss with lossless WebP, JPEG XL and PNG.

    python lab/exact.py target/release/ssplat PICTURES...
    python lab/exact.py target/release/ssplat PICTURES... --no-times --crop 64

PICTURES are pictures or folders of pictures. For each picture, the command prints the bytes of its PNG (as Pillow
optimizes it), of lossless WebP (method 6, quality 100), of JPEG XL (effort 7) and of `ssplat encode --lossless`, the last
relative to the smaller of WebP and JPEG XL, and CPU times: seconds a megapixel of encoding with ssplat, and nanoseconds a pixel
of decoding with ssplat, including writing a TIFF file without compression, and with libwebp. The time that the program
takes to start is subtracted. Each file is decoded and
compared with the picture. The means of each folder follow.

Pictures are converted to 8 bits and to RGB, or RGBA if they have alpha. The command needs Pillow and pillow-jxl-plugin.
"""
import argparse, io, pathlib, random, resource, subprocess, sys, tempfile, time

try:
    import pillow_jxl  # noqa: F401, registers JPEG XL
except ImportError:
    pillow_jxl = None
from PIL import Image

KINDS = {".png", ".jpg", ".jpeg", ".webp", ".ppm", ".bmp", ".tif", ".tiff"}


def found(paths):
    for path in paths:
        yield from sorted(p for p in path.iterdir() if p.suffix.lower() in KINDS) if path.is_dir() else [path]


def crops(picture, side, count=4):
    """Yields squares at random places with more than four colours, if there are any."""
    places = random.Random(5)
    for _ in range(count):
        for _ in range(50):
            x, y = places.randrange(picture.width - side), places.randrange(picture.height - side)
            crop = picture.crop((x, y, x + side, y + side))
            if crop.getcolors(4) is None:
                break
        yield crop


def spent(command):
    """Runs a command. Returns its CPU seconds."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(list(map(str, command)), check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def stored(picture, kind, **options):
    out = io.BytesIO()
    picture.save(out, kind, **options)
    return out.getvalue()


def losslessly(picture):
    """Returns the picture as PNG, WebP and JPEG XL, without loss."""
    webp = stored(picture, "WEBP", lossless=True, method=6, quality=100, exact=True)
    return stored(picture, "PNG", optimize=True), webp, stored(picture, "JXL", lossless=True, effort=7)


def decode_seconds(data, repeat=3):
    start = time.process_time()
    for _ in range(repeat):
        Image.open(io.BytesIO(data)).load()
    return (time.process_time() - start) / repeat


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("pictures", type=pathlib.Path, nargs="+")
    parser.add_argument("--no-times", action="store_true", help="do not measure times")
    parser.add_argument("--crop", type=int, metavar="SIDE", help="only four squares of each picture, of SIDE pixels a side")
    args = parser.parse_args()
    sets = {}
    print("| picture | PNG | WebP | JPEG XL | ssplat | of the smaller | encode, s/MP | decode, ns/px | WebP, ns/px |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|")
    with tempfile.TemporaryDirectory() as folder:
        source, file, back = (pathlib.Path(folder) / name for name in ("source.png", "file.ssplat", "back.tiff"))
        idle = min(spent([args.program, "--version"]) for _ in range(3))
        for path in found(args.pictures):
            picture = Image.open(path)
            has_alpha = "A" in picture.getbands() or "transparency" in picture.info
            picture = picture.convert("RGBA" if has_alpha else "RGB")
            for picture in crops(picture, args.crop) if args.crop else [picture]:
                picture.save(source)
                pixels = picture.width * picture.height
                png, webp, jxl = losslessly(picture)
                encode = spent([args.program, "encode", source, file, "--lossless", "--keep-hidden", "--force", "--quiet"]) - idle
                decode = spent([args.program, "decode", file, back, "--quiet"]) - idle
                if Image.open(back).convert(picture.mode).tobytes() != picture.tobytes():
                    sys.exit(f"{path}: the decoded picture differs")
                size = file.stat().st_size
                ratio = size / min(len(webp), len(jxl))
                times = "| | |" if args.no_times else (
                    f"{encode / pixels * 1e6:.2f} | {decode / pixels * 1e9:.0f} | {decode_seconds(webp) / pixels * 1e9:.0f} |"
                )
                print(f"| {path.parent.name}/{path.stem} | {len(png)} | {len(webp)} | {len(jxl)} | {size} | {ratio:.3f} | {times}", flush=True)
                sets.setdefault(path.parent.name, []).append(ratio)
    for name, ratios in sets.items():
        print(f"{name}: mean of the smaller {sum(ratios) / len(ratios):.3f}, worst {max(ratios):.3f}, {len(ratios)} pictures")


if __name__ == "__main__":
    main()
