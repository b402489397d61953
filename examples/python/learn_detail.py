"""Learns the initial states of the detail layer's models (spec §11.3), and writes the tables of the crate and the
specification.

    python3 examples/python/learn_detail.py target/release/ssplat PICTURES... --work FOLDER

Each picture is encoded at three ratios with both presets: unchanged, at half its size, and in grey. Pictures of more
than 2 megapixels are also cropped to their middle. Needs Pillow. docs/studies/detail-layer.md names the pictures.
"""
import argparse
import os
import pathlib
import subprocess

from PIL import Image

MIDDLE = (768, 512)
LARGEST = 1400


def variants(path):
    picture = Image.open(path)
    if picture.mode not in ("RGB", "RGBA", "L"):
        picture = picture.convert("RGB")
    if picture.width * picture.height > 2_000_000:
        left, top = ((side - cut) // 2 for side, cut in zip(picture.size, MIDDLE))
        yield "middle", picture.crop((left, top, left + MIDDLE[0], top + MIDDLE[1]))
        scale = LARGEST / max(picture.size)
        picture = picture.resize([round(side * scale) for side in picture.size], Image.Resampling.LANCZOS)
    yield "whole", picture
    yield "half", picture.resize([max(1, side // 2) for side in picture.size], Image.Resampling.LANCZOS)
    yield "grey", picture.convert("L")
    if path.stem.endswith("9"):
        # Some pictures get a vignette as alpha.
        alpha = Image.radial_gradient("L").resize(picture.size).point(lambda v: 255 - v)
        cut = picture.convert("RGB")
        cut.putalpha(alpha)
        yield "alpha", cut


def main():
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("program")
    arguments.add_argument("pictures", nargs="+", type=pathlib.Path)
    arguments.add_argument("--work", type=pathlib.Path, required=True)
    arguments = arguments.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    files = []
    for path in arguments.pictures:
        for name, picture in variants(path):
            source = arguments.work / f"{path.stem}-{name}.png"
            picture.save(source)
            for ratio, tune in ((20, "psnr"), (45, "iq"), (70, "psnr")):
                file = source.with_suffix(f".{ratio}-{tune}.ssplat")
                options = ["--ratio", str(ratio), "--tune", tune, "--effort", "1", "--detail", "0.3", "--quiet"]
                is_there = file.exists() or subprocess.run([arguments.program, "encode", source, file, *options]).returncode == 0
                if is_there:
                    files.append(str(file))
    learn = ["cargo", "test", "--release", "--lib", "learn_where_models_begin", "--", "--ignored"]
    subprocess.run(learn, env={**os.environ, "SSPLAT_LEARN": " ".join(files)}, check=True)


if __name__ == "__main__":
    main()
