#!/usr/bin/env python3
"""Measures what a directional filter in the decoder would bring against ringing.

    python lab/deringing.py target/release/ssplat PICTURE.png … --ratios 50,100

Each picture is encoded, and decoded by spec/decode.py without rounding. Then the luma of the detail layer is filtered as AV1's
CDEF filters a frame: the direction of each 8 × 8 block, two taps on either side along it and across, and differences that
count less the larger they are. The strength is a part of the quantizer step of the superblock. `layer` filters the additions of
the detail layer alone, in integers, as a decoder could do it tile by tile; `picture` filters Gaussians and layer together. With
`block`, each block with levels is filtered or not, whichever has the smaller squared error, and the flags' entropy is printed.

Prints for each filter the changes of SSIMULACRA2 and of the squared error of luma, and the percentile of lab/ringing.py. Needs
numpy, opencv-python-headless and Pillow.
"""
import argparse, importlib.util, math, pathlib, sys, tempfile

import numpy
from PIL import Image

from other_codecs import mean, measured, run
from ringing import ringing

root = pathlib.Path(__file__).resolve().parent.parent
# Factors of the step by class (spec §11.5).
CLASSES = numpy.array([38, 54, 76, 108, 152, 215, 304, 430]) / 64
# The first and second tap of each direction, rows and columns.
TAPS = [((-1, 1), (-2, 2)), ((0, 1), (-1, 2)), ((0, 1), (0, 2)), ((0, 1), (1, 2)), ((1, 1), (2, 2)), ((1, 0), (2, 1)), ((1, 0), (2, 0)), ((1, 0), (2, -1))]


def decoder():
    spec = importlib.util.spec_from_file_location("decode", root / "spec/decode.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Decoded:
    """A file as planes: the Gaussians, the additions and their luma, and the step and the luma block of each pixel."""

    def __init__(self, file, original):
        spec, tiles = decoder(), []

        class Tile(spec.Tile):
            def additions(self):
                tiles.append(self)
                return super().additions()
        spec.Tile = Tile
        data = file.read_bytes()
        header = spec.Header(data)
        background, primitives, places, exact = spec.read(data, header, [])
        if header.detail is None or exact or header.channels != 3:
            sys.exit(f"{file}: a file of three channels with a detail layer and without an exact one is needed")
        width, height = header.size
        self.added, self.step = numpy.zeros((height, width, 3), numpy.int64), numpy.full((height, width), 1.0)
        self.block, blocks, tiles = numpy.zeros((height, width), int), 0, iter(tiles)
        for (x, y, across, down), added in places:
            if added is None:
                continue
            tile, part = next(tiles), numpy.s_[y : y + down, x : x + across]
            self.added[part] = added
            classes = CLASSES[tile.classes] if header.detail.classes > 1 else numpy.ones(tile.classes.shape)
            # The step in 1/16 of a code value, as luma.
            self.step[part] = (classes * header.detail.step / 4).repeat(32, 0).repeat(32, 1)[:down, :across]
            for plane, column, row, size, _, levels in tile.blocks:
                if plane == 0 and levels:
                    blocks, n = blocks + 1, 4 << size
                    self.block[y + 4 * row : min(y + 4 * row + n, y + down), x + 4 * column : min(x + 4 * column + n, x + across)] = blocks
        header.sixteen = True
        self.base = spec.draw(header, background, primitives, []) / 65535 * 255
        self.original = original
        red, green, blue = numpy.moveaxis(self.added, -1, 0)
        # The plane of luma again: the planes of chroma cancel (spec §11.5).
        self.luma = (red + 2 * green + blue) // 8
        self.wanted = luma(original.astype(float) - self.base) * 16

    def pixels(self, filtered):
        added = self.added + 2 * (numpy.floor(filtered + 0.5) - self.luma)[..., None]
        return numpy.floor(numpy.clip(self.base + added / 32, 0, 255) + 0.5).astype(numpy.uint8)


def luma(pixels):
    return (pixels[..., 0] + 2 * pixels[..., 1] + pixels[..., 2]) / 4


def moved(plane, down, across):
    height, width = plane.shape
    return numpy.pad(plane, 4, "edge")[4 + down : 4 + down + height, 4 + across : 4 + across + width]


def directions(plane):
    """Returns the direction of each pixel's 8 × 8 block: that along which the sums of lines have the largest squares."""
    height, width = plane.shape
    padded = numpy.pad(plane, ((0, -height % 8), (0, -width % 8)), "edge")
    blocks = padded.reshape(padded.shape[0] // 8, 8, padded.shape[1] // 8, 8).swapaxes(1, 2)
    blocks = blocks - blocks.mean((2, 3), keepdims=True)
    i, j = numpy.mgrid[:8, :8]
    squares = [
        sum((blocks * (lines == k)).sum((2, 3)) ** 2 / max(1, (lines == k).sum()) for k in range(lines.max() + 1))
        for lines in (i + j, i + j // 2, i, i - j // 2 + 3, 7 + i - j, 3 - i // 2 + j, j, i // 2 + j)
    ]
    return numpy.argmax(squares, 0).repeat(8, 0).repeat(8, 1)[:height, :width]


def filtered(plane, guide, strength):
    """Returns the plane after the filter; the guide has the directions and differences."""
    direction, total = directions(guide), numpy.zeros(plane.shape)

    def pair(taps, most):
        differences = [moved(guide, sign * taps[0], sign * taps[1]) - guide for sign in (1, -1)]
        return sum(numpy.sign(d) * numpy.minimum(abs(d), numpy.maximum(0, most - abs(d) / 4)) for d in differences)
    for k in range(8):
        along = sum(weight * pair(taps, strength) for taps, weight in zip(TAPS[k], (4, 2)))
        across = sum(weight * pair(taps, strength / 2) for other in (k + 2, k - 2) for taps, weight in zip(TAPS[other % 8], (2, 1)))
        total += (direction == k) * (along + across)
    return plane + total / 16


def entropy(share):
    return -sum(p * math.log2(p) for p in (share, 1 - share) if p > 0)


def variants(decoded):
    """Yields names and filtered lumas, with the bytes of flags."""
    plane = decoded.luma.astype(float)
    yield "none", plane, 0
    for name, guide in ("layer", plane), ("picture", plane + luma(decoded.base) * 16):
        for strength in (0.1, 0.15, 0.3):
            yield f"{name} {strength}", filtered(plane, guide, strength * decoded.step), 0
        after = filtered(plane, guide, 0.15 * decoded.step)
        gains = (plane - decoded.wanted) ** 2 - (after - decoded.wanted) ** 2
        chosen = numpy.bincount(decoded.block.ravel(), gains.ravel()) > 0
        chosen[0] = False
        share = chosen[1:].mean() if len(chosen) > 1 else 0
        yield f"{name} 0.15 block", numpy.where(chosen[decoded.block], after, plane), entropy(share) * (len(chosen) - 1) / 8


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("pictures", type=pathlib.Path, nargs="+")
    parser.add_argument("--ratios", default="50,100")
    args = parser.parse_args()
    for ratio in args.ratios.split(","):
        rows = {}
        for picture in args.pictures:
            with tempfile.TemporaryDirectory() as folder:
                folder = pathlib.Path(folder)
                source, file, made = (folder / name for name in ("source.png", "a.ssplat", "made.png"))
                image = Image.open(picture).convert("RGB")
                image.info.clear()
                image.save(source)
                run([args.program, "encode", source, file, "--quiet", "--ratio", ratio])
                decoded = Decoded(file, numpy.asarray(image))
                for name, plane, flags in variants(decoded):
                    pixels = decoded.pixels(plane)
                    Image.fromarray(pixels).save(made)
                    error = ((plane - decoded.wanted) ** 2).mean()
                    row = measured(args.program, source, made) | {"p99": ringing(decoded.original, pixels)["p99"], "error": error}
                    rows.setdefault(name, []).append(row | {"flags": 100 * flags / file.stat().st_size})
        print(f"{ratio}: {len(args.pictures)} pictures")
        for name, found in rows.items():
            points = [row["ssimulacra2"] - none["ssimulacra2"] for row, none in zip(found, rows["none"])]
            error = mean([row["error"] / none["error"] for row, none in zip(found, rows["none"])])
            print(f"    {name:20} SSIMULACRA2 {mean(points):+.2f}, at least {min(points):+.2f}; squared error {error:.3f}; p99 {mean([row['p99'] for row in found]):.2f}; Butteraugli {mean([row['butteraugli'] for row in found]):.3f}; flags {mean([row['flags'] for row in found]):.2f} % of the file")


if __name__ == "__main__":
    main()
