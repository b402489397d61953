"""Synthetic pictures for the tests."""

import pathlib

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
VECTORS = ROOT / "spec" / "vectors"
KODIM05 = ROOT / "tests" / "images" / "kodim05.png"


def waves(height, width, channels=3, dtype=np.uint8, seed=0):
    """Returns smooth waves with a little noise; the shape is (height, width) if ``channels`` is None."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width]
    planes = [
        0.5 + 0.4 * np.sin((x * (k + 1) + 2 * y) / 9.0) + random.normal(0, 0.02, x.shape) for k in range(channels or 1)
    ]
    samples = (np.clip(np.stack(planes, -1), 0, 1) * np.iinfo(dtype).max + 0.5).astype(dtype)
    return samples if channels else samples[..., 0]
