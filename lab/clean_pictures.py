#!/usr/bin/env python3
"""Draws clean pictures of two megapixels, to measure how the encoder divides the bytes of pictures without noise.

    python lab/clean_pictures.py FOLDER
    python lab/division.py target/release/ssplat FOLDER/clean/*.png --ratios 20,50,100,200

Two folders, `clean` and `clean-judge`, get the same kinds of pictures with different random numbers: dark silhouettes with
antialiased edges before a smooth sky (branches, a skyline, hills with grass, ferns before a blurred ground), renderings of
shaded voxels (a terrain and a castle), spheres on a plane with soft shadows, and waves of flat colours. No picture has noise.
"""
import argparse, math, pathlib

import numpy
from PIL import Image, ImageDraw, ImageFilter

SIZE = (1920, 1080)
#: Factor of the size at which shapes are drawn before they are reduced, so that their edges are antialiased.
FINER = 3


def gradient(stops, angle=0.0, curve=1.0):
    """Returns a picture whose colour changes from one stop to the next."""
    width, height = SIZE
    y, x = numpy.mgrid[0:height, 0:width]
    at = (y / height * math.cos(angle) + x / width * math.sin(angle)).clip(0, 1) ** curve * (len(stops) - 1)
    low = numpy.minimum(at.astype(int), len(stops) - 2)
    part = (at - low)[..., None]
    stops = numpy.array(stops, float)
    return stops[low] * (1 - part) + stops[low + 1] * part


def glow(pixels, center, radius, color, strength):
    y, x = numpy.mgrid[0:SIZE[1], 0:SIZE[0]]
    near = numpy.exp(-((x - center[0]) ** 2 + (y - center[1]) ** 2) / (2 * radius ** 2))[..., None]
    return pixels + strength * near * (numpy.array(color) - pixels)


def mask(draw_shapes):
    """Returns the cover of shapes, from 0 to 1. `draw_shapes` draws them at a larger size."""
    image = Image.new("L", (SIZE[0] * FINER, SIZE[1] * FINER))
    draw_shapes(ImageDraw.Draw(image))
    return numpy.asarray(image.resize(SIZE, Image.Resampling.BOX), float)[..., None] / 255


def picture(pixels):
    return Image.fromarray((pixels + 0.5).clip(0, 255).astype(numpy.uint8))


def sky(rng):
    skies = [
        [(28, 40, 84), (120, 96, 140), (240, 150, 90), (255, 214, 140)],
        [(90, 140, 205), (150, 190, 230), (222, 234, 240)],
        [(10, 14, 38), (30, 44, 90), (84, 96, 150)],
        [(196, 204, 210), (226, 228, 226), (206, 200, 190)],
    ]
    pixels = gradient(skies[rng.integers(len(skies))], rng.uniform(-0.3, 0.3), rng.uniform(0.8, 1.4))
    center = (rng.uniform(0.2, 0.8) * SIZE[0], rng.uniform(0.5, 0.9) * SIZE[1])
    return glow(pixels, center, rng.uniform(150, 400), (255, 240, 200), 0.7)


def before(pixels, cover, color):
    return pixels * (1 - cover) + numpy.array(color) * cover


def branches(rng):
    def shapes(draw):
        def branch(x, y, angle, length, width):
            bend = rng.uniform(-0.1, 0.1)
            for _ in range(8):
                ahead = (x + math.cos(angle) * length / 8, y + math.sin(angle) * length / 8)
                draw.line([(x, y), ahead], fill=255, width=max(1, round(width)))
                draw.ellipse([ahead[0] - width / 2, ahead[1] - width / 2, ahead[0] + width / 2, ahead[1] + width / 2], fill=255)
                (x, y), angle, width = ahead, angle + bend / 3, width * 0.965
            if width > 2.5 and length > 30:
                for _ in range(rng.integers(2, 4)):
                    branch(x, y, angle + rng.normal(0, 0.55), length * rng.uniform(0.62, 0.85), width * rng.uniform(0.55, 0.75))
        for _ in range(rng.integers(1, 3)):
            branch(rng.uniform(0.2, 0.8) * SIZE[0] * FINER, SIZE[1] * FINER * 1.05, -math.pi / 2 + rng.normal(0, 0.15), 700, 130)
    return before(sky(rng), mask(shapes), (12, 10, 14))


def skyline(rng):
    def shapes(draw):
        x = 0
        while x < SIZE[0] * FINER:
            width, top = rng.uniform(80, 420), rng.uniform(0.45, 0.85) * SIZE[1] * FINER
            draw.rectangle([x, top, x + width, SIZE[1] * FINER], fill=255)
            if rng.random() < 0.4:
                middle, up = x + width / 2, rng.uniform(60, 400)
                draw.polygon([(middle - 9, top), (middle, top - up), (middle + 9, top)], fill=255)
            if rng.random() < 0.3:
                draw.polygon([(x, top), (x + width / 2, top - width / 2), (x + width, top)], fill=255)
            x += width
        draw.line([(0, 900), (SIZE[0] * FINER, 1300)], fill=255, width=4)
    pixels = before(sky(rng), mask(shapes), (16, 18, 26))
    for _ in range(260):
        x, y = int(rng.integers(SIZE[0] - 8)), int(rng.uniform(0.86, 0.99) * SIZE[1])
        pixels[y:y + 5, x:x + 4] = (230, 190, 110)
    return pixels


def hills(rng):
    pixels = sky(rng)
    far = pixels[int(0.6 * SIZE[1])].mean(axis=0)
    for layer in range(4):
        waves = [(rng.uniform(1, 9), rng.uniform(0, 7), rng.uniform(0.2, 1)) for _ in range(6)]
        at = [sum(a / f * math.sin(f * x / 900 + p) for f, p, a in waves) for x in range(0, SIZE[0] * FINER + 12, 12)]
        base = (0.5 + 0.12 * layer) * SIZE[1] * FINER
        line = [(12 * k, base + 150 * y) for k, y in enumerate(at)]

        def shapes(draw):
            draw.polygon([*line, (SIZE[0] * FINER, SIZE[1] * FINER + 9), (0, SIZE[1] * FINER + 9)], fill=255)
            if layer == 3:
                for x, y in line:
                    for _ in range(5):
                        x0, tall = x + rng.uniform(0, 12), rng.uniform(40, 160)
                        draw.polygon([(x0 - 3, y + 20), (x0 + rng.normal(0, 25), y - tall), (x0 + 3, y + 20)], fill=255)
        pixels = before(pixels, mask(shapes), far * (0.6, 0.42, 0.25, 0.05)[layer])
    return pixels


def ferns(rng):
    ground = numpy.zeros((27, 48, 3)) + rng.uniform(30, 90, 3)
    ground += rng.normal(0, 30, (27, 48, 1)) * rng.uniform(0.5, 1.2, 3)
    blurred = Image.fromarray(ground.clip(0, 255).astype(numpy.uint8)).resize(SIZE, Image.Resampling.BICUBIC).filter(ImageFilter.GaussianBlur(30))

    def shapes(draw):
        for _ in range(9):
            x, y, angle = rng.uniform(0, SIZE[0] * FINER), SIZE[1] * FINER * 1.02, -math.pi / 2 + rng.normal(0, 0.35)
            bend, length = rng.normal(0, 0.02), rng.uniform(50, 90)
            for k in range(48):
                ahead = (x + math.cos(angle) * length, y + math.sin(angle) * length)
                draw.line([(x, y), ahead], fill=255, width=8)
                leaf = (1 - k / 48) * length * 4
                for side in (-1, 1):
                    to = (x + math.cos(angle + side) * leaf, y + math.sin(angle + side) * leaf)
                    middle = (x + math.cos(angle + 0.7 * side) * leaf / 2, y + math.sin(angle + 0.7 * side) * leaf / 2)
                    draw.polygon([(x, y), middle, to, ahead], fill=255)
                (x, y), angle = ahead, angle + bend
    return before(numpy.asarray(blurred, float), mask(shapes), (8, 20, 10))


def cubes(rng, height_of, color_of, count):
    """Renders columns of cubes from an oblique direction, far ones first."""
    image = Image.fromarray((gradient([(130, 170, 220), (215, 228, 240)]) + 0.5).astype(numpy.uint8)).resize((SIZE[0] * FINER, SIZE[1] * FINER), Image.Resampling.BICUBIC)
    draw = ImageDraw.Draw(image)
    side = SIZE[0] * FINER / count
    half, quarter = side / 2, side / 4

    def shade(color, light):
        return tuple(int(min(255, c * light)) for c in color)
    for row in range(2 * count):
        for k in range(row + 1):
            i, j = k, row - k
            if i >= count or j >= count:
                continue
            top, below = height_of(i, j), min(height_of(i + 1, j) if i + 1 < count else 0, height_of(i, j + 1) if j + 1 < count else 0)
            x, ground = SIZE[0] * FINER / 2 + (i - j) * half, 0.3 * SIZE[1] * FINER + (i + j) * quarter
            shadow = 0.72 if i > 0 and height_of(i - 1, j) > top else 1.0
            for z in range(min(below, top), top + 1):
                y, color = ground - z * half, color_of(i, j, z, top)
                # Haze in the distance, and a lamp whose light fades.
                haze, lamp = 0.5 * (1 - row / (2 * count)), 0.6 + 0.5 * math.exp(-((i - 0.6 * count) ** 2 + (j - 0.5 * count) ** 2) / (0.2 * count * count))
                color = [c * lamp * (1 - haze) + h * haze for c, h in zip(color, (190, 205, 225))]
                draw.polygon([(x, y), (x + half, y + quarter), (x, y + half), (x - half, y + quarter)], fill=shade(color, shadow * 1.1))
                draw.polygon([(x - half, y + quarter), (x, y + half), (x, y + side), (x - half, y + quarter + half)], fill=shade(color, 0.8))
                draw.polygon([(x + half, y + quarter), (x, y + half), (x, y + side), (x + half, y + quarter + half)], fill=shade(color, 0.55))
    return numpy.asarray(image.resize(SIZE, Image.Resampling.BOX), float)


def terrain(rng):
    count = 70
    waves = [(rng.uniform(1, 8), rng.uniform(-8, 8), rng.uniform(0, 7)) for _ in range(12)]
    at = [[sum(math.sin((a * i + b * j) / 30 + p) / (1 + abs(a) / 3) for a, b, p in waves) for j in range(count)] for i in range(count)]

    def color(i, j, z, top):
        varied = 0.92 + 0.16 * ((i * 7919 + j * 104729 + z * 31) % 17) / 17
        base = (70, 110, 190) if z <= 3 else (96, 160, 70) if z == top and top < 14 else (245, 245, 250) if z == top else (120, 92, 66)
        return [c * varied for c in base]
    return cubes(rng, lambda i, j: max(3, round(8 + 2.6 * at[i][j])), color, count)


def castle(rng):
    count = 44
    towers = [(int(i), int(j), int(rng.integers(2, 5)), int(rng.integers(8, 22))) for i, j in rng.integers(5, count - 5, (12, 2))]

    def height(i, j):
        found = [h + (1 if (i + j) % 2 and max(abs(i - x), abs(j - y)) == r else 0) for x, y, r, h in towers if max(abs(i - x), abs(j - y)) <= r]
        return max(found, default=1)

    def color(i, j, z, top):
        varied = 0.9 + 0.2 * ((i * 31 + j * 17 + z * 13) % 5) / 5
        return [c * varied for c in ((104, 150, 82) if top <= 1 else (168, 160, 150) if z < top else (170, 84, 64))]
    return cubes(rng, height, color, count)


def spheres(rng):
    width, height = SIZE
    y, x = numpy.mgrid[0:height * 2, 0:width * 2] / 2.0
    pixels = numpy.zeros((height * 2, width * 2, 3)) + numpy.array(rng.uniform(150, 220, 3)) * (0.6 + 0.4 * (y / height))[..., None]
    balls = sorted(((rng.uniform(0, width), rng.uniform(0.3, 0.9) * height, rng.uniform(40, 210)) for _ in range(16)), key=lambda b: b[1] + b[2])
    for cx, cy, r in balls:
        dark = 0.5 * numpy.exp(-(((x - cx - 0.5 * r) / (1.1 * r)) ** 2 + ((y - cy - 0.95 * r) / (0.28 * r)) ** 2) ** 2)[..., None]
        pixels *= 1 - dark
    for cx, cy, r in balls:
        u, v = (x - cx) / r, (y - cy) / r
        inside = u * u + v * v < 1
        w = numpy.sqrt((1 - u * u - v * v).clip(0, 1))
        light = (-0.5 * u - 0.6 * v + 0.62 * w).clip(0, 1)
        shine = light ** rng.uniform(20, 60)
        color = rng.uniform(30, 235, 3)
        pixels[inside] = (color * (0.18 + 0.8 * light[..., None]) + 220 * shine[..., None])[inside]
    small = picture(pixels).resize(SIZE, Image.Resampling.BOX)
    return numpy.asarray(small, float)


def waves(rng):
    pixels = gradient([rng.uniform(40, 240, 3) for _ in range(3)], rng.uniform(0, 1.2))
    for _ in range(7):
        curve = [(rng.uniform(0.5, 4), rng.uniform(0, 7), rng.uniform(20, 120)) for _ in range(3)]
        base = rng.uniform(0.2, 1.0) * SIZE[1] * FINER
        line = [(x, base + FINER * sum(a * math.sin(f * x / 1000 + p) for f, p, a in curve)) for x in range(0, SIZE[0] * FINER + 9, 9)]
        cover = mask(lambda draw: draw.polygon([*line, (SIZE[0] * FINER, SIZE[1] * FINER * 2), (0, SIZE[1] * FINER * 2)], fill=255))
        pixels = before(pixels, cover * rng.uniform(0.5, 1), rng.uniform(20, 240, 3))
    return pixels


KINDS = [branches, skyline, hills, ferns, terrain, castle, spheres, waves]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    folder = parser.parse_args().folder
    for half, seed in [("clean", 1), ("clean-judge", 2)]:
        (folder / half).mkdir(parents=True, exist_ok=True)
        for number, kind in enumerate(KINDS):
            rng = numpy.random.default_rng([seed, number])
            picture(kind(rng)).save(folder / half / f"{kind.__name__}.png")


if __name__ == "__main__":
    main()
