"""Reading and writing Gaussians."""

import numpy as np
import pytest
import ssplat
from hypothesis import given, settings
from hypothesis import strategies as st
from pictures import waves

PICTURE = waves(48, 64)
FILE = ssplat.encode(PICTURE, effort=2, bytes=700)


def drawn(g):
    """Renders the picture by the formula of the documentation, in double precision."""
    y, x = np.mgrid[0 : g["height"], 0 : g["width"]] + 0.5
    total, colors = np.zeros(x.shape), np.zeros((*x.shape, g["color"].shape[1]))
    for (mx, my), (major, minor), turn, color in zip(g["mean"], g["scale"], g["rotation"].astype(float), g["color"]):
        u = ((x - mx) * np.cos(turn) + (y - my) * np.sin(turn)) / major
        v = ((y - my) * np.cos(turn) - (x - mx) * np.sin(turn)) / minor
        weight = np.maximum(0, np.exp(-(u * u + v * v) / 2) - np.exp(-(3.5**2) / 2))
        total += weight
        colors += weight[..., None] * color
    if g.get("blend") == "sum":
        return colors + g["background"]
    return (colors + g["background"] / 128) / (total[..., None] + 1 / 128)


@pytest.mark.parametrize("blend", ["normalized", "sum"])
def test_the_documented_formula_gives_the_decoded_picture(blend):
    data = ssplat.encode(PICTURE, effort=1, bytes=500, research={"blend": blend})
    want = np.clip(drawn(ssplat.gaussians(data)), 0, 1) * 255
    # Rounding, and the code value that the specification allows.
    assert abs(want - ssplat.decode(data)).max() <= 1.5


def test_limits_hold_before_arrays_are_made():
    data = ssplat.encode(waves(20, 30), effort=1, gaussians=9)
    count = len(ssplat.gaussians(data)["mean"])
    assert len(ssplat.gaussians(data, limits={"gaussians": count})["mean"]) == count
    for name, value in [("gaussians", count - 1), ("width", 10), ("alloc", 30 * count)]:
        with pytest.raises(ssplat.LimitExceededError) as caught:
            ssplat.gaussians(data, limits={name: value})
        assert caught.value.what == name


def test_shapes_and_types_are_those_documented():
    g = ssplat.gaussians(FILE)
    n = ssplat.info(FILE)["gaussians"]
    assert n > 20
    shapes = {"mean": (n, 2), "scale": (n, 2), "rotation": (n,), "color": (n, 3), "background": (3,)}
    for name, shape in shapes.items():
        assert (g[name].shape, g[name].dtype) == (shape, np.float32), name
    assert (g["scale"][:, 0] >= g["scale"][:, 1]).all() and (g["scale"] >= 0.25).all()
    assert ((g["mean"] >= 0) & (g["mean"] <= [64, 48])).all()


def test_the_same_gaussians_make_the_same_file():
    assert ssplat.from_gaussians(**ssplat.gaussians(FILE)) == FILE


def others(n, channels, seed):
    random = np.random.default_rng(seed)
    return {
        "mean": random.uniform(0, (64, 48), (n, 2)),
        "scale": random.uniform(0.3, 20, (n, 2)),
        "rotation": random.uniform(-9, 9, n),
        "color": random.normal(0.5, 0.3, (n, channels)),
        "background": random.uniform(0, 1, channels),
        "width": 64,
        "height": 48,
    }


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 40), st.integers(1, 4), st.integers(0, 1000), st.sampled_from(["normalized", "sum"]))
def test_gaussians_fitted_elsewhere_are_stored_as_they_are(n, channels, seed, blend):
    g = others(n, channels, seed) | {"blend": blend}
    data = ssplat.from_gaussians(**g, bits=16)
    pixels = ssplat.decode(data).reshape(48, 64, channels) / 65535
    assert ssplat.info(data)["gaussians"] == n
    # The cost of rounding to the usual steps: a luma step of 2^(4/3 - 7) is 5 of 255, and many overlap.
    assert np.sqrt(np.mean((np.clip(drawn(g), 0, 1) - pixels) ** 2)) < 0.05


def test_more_bytes_round_finer():
    g = others(60, 3, 5)
    want, errors, sizes = np.clip(drawn(g), 0, 1), [], []
    for most in (235, 260, 290, 330, 5000):
        data = ssplat.from_gaussians(**g, bytes=most, bits=16)
        assert len(data) <= most
        sizes.append(len(data))
        errors.append(np.sqrt(np.mean((want - ssplat.decode(data) / 65535) ** 2)))
    assert sizes == sorted(sizes) and len(set(sizes)) == 5
    assert errors[-1] < 0.005 < 0.01 < errors[0]


def test_a_ratio_is_a_size():
    g = others(60, 3, 5)
    assert ssplat.from_gaussians(**g, ratio=20) == ssplat.from_gaussians(**g, bytes=64 * 48 * 3 // 20)


def test_too_few_bytes_are_refused_with_what_is_needed():
    with pytest.raises(ssplat.ParameterError, match="are needed"):
        ssplat.from_gaussians(**others(60, 3, 5), bytes=100)


def test_equal_colors_become_a_codebook():
    g = others(400, 3, 2)
    g["color"][:] = g["color"][:5].repeat(80, 0)
    assert ssplat.info(ssplat.from_gaussians(**g))["codebook"] == 5


def test_every_layout_holds_them():
    g = others(60, 4, 3)
    for layout in ("coded", "planes", "packed"):
        data = ssplat.from_gaussians(**g, layout=layout, bits=16)
        assert ssplat.info(data)["layout"] == layout
        pixels = ssplat.decode(data) / 65535
        assert np.sqrt(np.mean((np.clip(drawn(g), 0, 1) - pixels) ** 2)) < 0.05


def test_metadata_are_carried():
    data = ssplat.from_gaussians(**others(3, 1, 0), icc_profile=b"profile", exif=b"Exif\0\0MM")
    assert (ssplat.info(data)["icc_profile"], ssplat.info(data)["exif"]) == (b"profile", b"MM")


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("mean", lambda v: v + [0, 100]),
        ("mean", lambda v: v * np.nan),
        ("mean", lambda v: v[:-1]),
        ("mean", lambda v: v[:, :1]),
        ("mean", lambda v: v[0]),
        ("scale", lambda v: v * 0),
        ("scale", lambda v: v * np.inf),
        ("scale", lambda v: v[1:]),
        ("rotation", lambda v: v * np.nan),
        ("rotation", lambda v: v[:, None]),
        ("color", lambda v: v * np.inf),
        ("color", lambda v: np.concatenate([v, v], 1)),
        ("color", lambda v: v.ravel()),
        ("background", lambda v: v[1:]),
        ("background", lambda v: v * np.nan),
        ("width", lambda v: 0),
        ("width", lambda v: 1 << 21),
        ("height", lambda v: -1),
    ],
)
def test_what_has_no_place_in_a_file_is_refused_by_name(name, change):
    g = others(10, 3, 1)
    with pytest.raises(ssplat.ParameterError) as caught:
        ssplat.from_gaussians(**g | {name: change(g[name])})
    assert caught.value.name == name
