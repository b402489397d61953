# %% [markdown]
# # A picture, its Gaussians, and its rate–distortion curve
#
# Run as a script, or open as a notebook (VS Code, Jupytext: each `# %%` is a cell).
#
#     pip install matplotlib pillow    # and the ssplat wheel, see python/README.md
#     python examples/python/gaussians.py
#
# It writes `gaussians.png` and `rate_distortion.png` to its own folder, or to the folder given with `--out`.

# %%
import io
import pathlib
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import ssplat
from matplotlib.collections import EllipseCollection
from PIL import Image

HERE = pathlib.Path(__file__).resolve().parent
OUT = pathlib.Path(sys.argv[2]) if sys.argv[1:2] == ["--out"] else HERE


def save(figure, name):
    """Saves a figure with a palette of 128 colours, which keeps the file small enough to commit."""
    out = io.BytesIO()
    figure.savefig(out, dpi=90)
    Image.open(out).convert("RGB").quantize(128).save(OUT / name, optimize=True)


PICTURE = Image.open(HERE.parents[1] / "tests" / "images" / "kodim15.png").convert("RGB")

# %% [markdown]
# ## Gaussians as ellipses
#
# A part of the picture at a ratio of 200, next to its Gaussians. Each is drawn as an ellipse at 1.5 standard deviations
# in its own colour. They are dense and small where there is detail.

# %%
part = PICTURE.crop((180, 20, 500, 260))
data = ssplat.encode(part, ratio=200, effort=5)
g = ssplat.gaussians(data)
stored = ssplat.decode(data)
decibels = ssplat.metrics.psnr(part, stored)
print(f"{part.width}x{part.height}: {len(data)} bytes, {len(g['mean'])} Gaussians, {decibels:.2f} dB")

figure, axes = plt.subplots(1, 3, figsize=(10.5, 2.9), layout="constrained")
for axis, title in zip(axes, ("source", f"{len(data)} bytes", f"{len(g['mean'])} Gaussians")):
    axis.set(title=title, xlim=(0, part.width), ylim=(part.height, 0), aspect="equal", xticks=[], yticks=[])
extent = (0, part.width, part.height, 0)
axes[0].imshow(part, extent=extent)
axes[1].imshow(stored, extent=extent)
order = np.argsort(-g["scale"].prod(1))
axes[2].add_collection(
    EllipseCollection(
        # Diameters at 1.5 standard deviations, and degrees.
        3 * g["scale"][order, 0],
        3 * g["scale"][order, 1],
        np.degrees(g["rotation"][order]),
        units="xy",
        offsets=g["mean"][order],
        offset_transform=axes[2].transData,
        facecolors=np.clip(g["color"][order], 0, 1),
        edgecolors="black",
        linewidths=0.2,
    )
)
save(figure, "gaussians.png")

# %% [markdown]
# ## Rate and distortion
#
# The whole picture at several file sizes, compared with JPEG and WebP.


# %%
def pillow_sizes(format, qualities):
    points = []
    for quality in qualities:
        out = io.BytesIO()
        PICTURE.save(out, format, quality=quality)
        points.append((out.tell(), ssplat.metrics.psnr(PICTURE, Image.open(out).convert("RGB"))))
    return points


curves = {"ssplat": []}
for ratio in (800, 400, 200, 100, 50):
    data = ssplat.encode(PICTURE, ratio=ratio, effort=3)
    curves["ssplat"].append((len(data), ssplat.metrics.psnr(PICTURE, ssplat.decode(data))))
curves["WebP"] = pillow_sizes("WEBP", (0, 5, 15, 30, 50, 70))
curves["JPEG"] = pillow_sizes("JPEG", (3, 6, 10, 18, 30, 45))
for name, points in curves.items():
    print(name, ", ".join(f"{size} bytes {decibels:.2f} dB" for size, decibels in points))

figure, axis = plt.subplots(figsize=(5.5, 3.6), layout="constrained")
for name, points in curves.items():
    axis.plot(*zip(*points), "o-", markersize=3, label=name)
axis.set(xscale="log", xlabel="bytes", ylabel="PSNR, dB", title=f"kodim15, {PICTURE.width}×{PICTURE.height}")
axis.grid(alpha=0.3)
axis.legend()
save(figure, "rate_distortion.png")
