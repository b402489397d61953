"""Compares the measures with their definitions and known values."""

import math

import numpy as np
import pytest
import ssplat
from pictures import waves
from PIL import Image

A = waves(180, 200)
B = np.clip(A.astype(int) + np.random.default_rng(1).integers(-9, 10, A.shape), 0, 255).astype(np.uint8)


def test_psnr_is_its_definition():
    mse = np.mean((A.astype(float) - B) ** 2)
    assert ssplat.metrics.psnr(A, B) == pytest.approx(10 * math.log10(255**2 / mse), abs=1e-9)
    deep = [v.astype(np.uint16) * 257 for v in (A, B)]
    assert ssplat.metrics.psnr(*deep) == pytest.approx(ssplat.metrics.psnr(A, B), abs=1e-9)


def test_equal_pictures_are_infinitely_close():
    assert ssplat.metrics.psnr(A, A) == math.inf
    assert ssplat.metrics.ssim(A, A) == pytest.approx(1)
    assert ssplat.metrics.ms_ssim(A, A) == pytest.approx(1)


def test_similarities_order_pictures_as_noise_does():
    assert 0.3 < ssplat.metrics.ssim(A, B) < ssplat.metrics.ms_ssim(A, B) < 1


def test_small_pictures_have_no_similarity():
    assert ssplat.metrics.ssim(A[:10], B[:10]) is None
    assert ssplat.metrics.ms_ssim(A[:160], B[:160]) is None
    assert ssplat.metrics.ms_ssim(A[:161], B[:161]) is not None


def test_pictures_of_pillow_and_paths_are_taken(tmp_path):
    Image.fromarray(B).save(tmp_path / "b.png")
    assert ssplat.metrics.psnr(Image.fromarray(A), tmp_path / "b.png") == ssplat.metrics.psnr(A, B)
