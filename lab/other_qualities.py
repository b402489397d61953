"""Prints which quality of ssplat corresponds to the qualities of JPEG, and to the defaults of AVIF and JPEG XL.

    python lab/other_qualities.py PROGRAM PICTURE... [--qualities 30,50,75,85,95]

JPEG is that of Pillow with its default subsampling of colours (4:2:0). `avifenc` and `cjxl` run with their defaults if
they are installed. `PROGRAM compare` measures SSIMULACRA2. With `--sizes`, each picture is also encoded by PROGRAM at its
default quality, for comparing the bytes.
"""

import argparse
import json
import shutil
import statistics
import subprocess
import tempfile
from pathlib import Path

from PIL import Image


def score(program: str, picture: Path, other: Path) -> float:
    """Returns the SSIMULACRA2 score of a file against a picture."""
    command = [program, "compare", picture, other, "--json"]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)["ssimulacra2"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", help="the program ssplat")
    parser.add_argument("pictures", nargs="+", type=Path)
    parser.add_argument("--qualities", default="30,50,60,75,80,85,90,95", help="qualities of JPEG, separated by commas")
    parser.add_argument("--sizes", action="store_true", help="also encode with the program at its default quality")
    args = parser.parse_args()
    found: dict[str, list[tuple[float, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        for picture in args.pictures:
            with Image.open(picture) as opened:
                image = opened.convert("RGB")
            source, decoded = home / "source.png", home / "decoded.png"
            image.save(source)
            files: dict[str, tuple[float, int]] = {}
            for quality in args.qualities.split(","):
                image.save(home / "a.jpg", quality=int(quality))
                with Image.open(home / "a.jpg") as jpeg:
                    jpeg.save(decoded)
                size = (home / "a.jpg").stat().st_size
                files[f"JPEG {quality}"] = score(args.program, source, decoded), size
            others = {
                "AVIF, avifenc's default": (["avifenc", source, home / "a.avif"], ["avifdec", home / "a.avif", decoded]),
                "JPEG XL, cjxl's default": (["cjxl", source, home / "a.jxl"], ["djxl", home / "a.jxl", decoded]),
            }
            for name, (encode, decode) in others.items():
                if shutil.which(encode[0]):
                    for command in encode, decode:
                        subprocess.run(command, check=True, capture_output=True)
                    files[name] = score(args.program, source, decoded), encode[2].stat().st_size
            if args.sizes:
                file = home / "a.ssplat"
                subprocess.run([args.program, "encode", source, file, "--quiet"], check=True)
                files["ssplat, its default"] = score(args.program, source, file), file.stat().st_size
            for name, (points, size) in files.items():
                found.setdefault(name, []).append((points, 8 * size / (image.width * image.height)))
    print("| | quality | standard deviation | bits per pixel |\n|---|--:|--:|--:|")
    for name, measured in found.items():
        scores, bits = zip(*measured, strict=True)
        spread = statistics.stdev(scores) if len(scores) > 1 else 0
        print(f"| {name} | {statistics.mean(scores):.0f} | {spread:.0f} | {statistics.mean(bits):.2f} |")


if __name__ == "__main__":
    main()
