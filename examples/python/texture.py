"""Measures the effect of noise in place of lost texture: `python texture.py PROGRAM PICTURE... [--sheet OUT.webp]`.

Each picture is encoded at ratio 50. Noise is added to the luma, with the local strength of the lost texture within a
window of a few pixels, times an amplitude. The strength is computed from the original and takes no bytes here; a file
that stored it would do worse. Prints the mean change of PSNR, MS-SSIM, SSIMULACRA2 and Butteraugli's 3-norm, as
`PROGRAM compare` reports them. Needs NumPy and Pillow. The sheet shows a crop of each picture: the original, the file,
and the file with noise.
"""

import argparse
import pathlib
import re
import subprocess
import sys
import tempfile

import numpy as np
from PIL import Image

LUMA = np.array([0.25, 0.6, 0.15])
#: Standard deviations of the blur that gives the noise its spectrum, pixels (0: white), and amplitudes.
SPECTRA, AMPLITUDES = (0.0, 0.7, 1.2), (0.15, 0.3, 0.5)
#: Standard deviation of the window for the strength of the lost texture, pixels.
WINDOW = 4.0
#: Side of the crops in the sheet, pixels, and the noise that it shows.
CROP, SHOWN = 192, (0.7, 0.5)


def blur(plane, sigma):
    """Applies a Gaussian blur to a plane, which is mirrored at its borders."""
    reach = int(3 * sigma + 1)
    taps = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * sigma**2))
    taps /= taps.sum()
    for axis in (0, 1):
        wide = np.pad(plane, [(reach, reach) if a == axis else (0, 0) for a in (0, 1)], mode="reflect")
        length = plane.shape[axis]
        plane = sum(t * wide.take(range(i, i + length), axis) for i, t in enumerate(taps))
    return plane


def noise(shape, sigma):
    """Returns noise of variance 1, the same at each call."""
    plane = np.random.default_rng(1).standard_normal(shape)
    if sigma:
        plane = blur(plane, sigma)
    return plane / plane.std()


def run(*words):
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program")
    parser.add_argument("pictures", nargs="+", type=pathlib.Path)
    parser.add_argument("--sheet", type=pathlib.Path)
    given = parser.parse_args()
    rows, changes = [], {}
    with tempfile.TemporaryDirectory() as folder:
        file, png = pathlib.Path(folder, "a.ssplat"), pathlib.Path(folder, "a.png")
        for picture in given.pictures:
            run(given.program, "encode", picture, file, "--ratio", "50", "--effort", "3", "--quiet")
            run(given.program, "decode", file, png, "--quiet")
            source, found = (np.asarray(Image.open(p).convert("RGB"), float) for p in (picture, png))

            def measured(pixels, name="b.png"):
                other = pathlib.Path(folder, name)
                Image.fromarray(np.clip(np.rint(pixels), 0, 255).astype(np.uint8)).save(other)
                told = run(given.program, "compare", picture, other)
                return np.array([float(v) for v in re.findall(r"(?:PSNR|MS-SSIM|SSIMULACRA2|Butteraugli) (-?[\d.]+)", told)])

            before = measured(found)
            strength = np.sqrt(blur(((source - found) @ LUMA) ** 2, WINDOW))
            for sigma in SPECTRA:
                for amplitude in AMPLITUDES:
                    drawn = found + (amplitude * strength * noise(strength.shape, sigma))[..., None]
                    changes.setdefault((sigma, amplitude), []).append(measured(drawn) - before)
                    if (sigma, amplitude) == SHOWN:
                        busiest = blur(strength, CROP / 6)[CROP // 2 : -CROP // 2, CROP // 2 : -CROP // 2]
                        y, x = np.unravel_index(busiest.argmax(), busiest.shape)
                        rows.append([p[y : y + CROP, x : x + CROP] for p in (source, found, drawn)])
    print("| blur of the noise, px | amplitude | PSNR | MS-SSIM | SSIMULACRA2 | Butteraugli |\n|--:|--:|--:|--:|--:|--:|")
    for (sigma, amplitude), of in changes.items():
        psnr, ms_ssim, ss2, butteraugli = np.mean(of, axis=0)
        print(f"| {sigma} | {amplitude} | {psnr:+.2f} | {ms_ssim:+.4f} | {ss2:+.1f} | {butteraugli:+.2f} |")
    if given.sheet:
        sheet = np.vstack([np.hstack(row) for row in rows])
        Image.fromarray(np.clip(np.rint(sheet), 0, 255).astype(np.uint8)).save(given.sheet, quality=90)


if __name__ == "__main__":
    sys.exit(main())
