//! Parameters of other programs, in an `.npz` archive of their arrays. Their checkpoints are PyTorch pickles, which run
//! code when opened and are not read here; a command of Python converts them (see [`HOW`]).
//!
//! GaussianImage (Zhang et al., ECCV 2024; github.com/Xinjie-Q/GaussianImage): `_xyz`, `_features_dc`, and `_cholesky`
//! or `_scaling` with `_rotation`. Image-GS (Zhang et al., SIGGRAPH 2025; github.com/NYU-ICL/image-gs): `xy`, `scale`,
//! `rot`, `feat`. Both programs have pixel centres at whole numbers; ssplat has them at +0.5. Both multiply by the
//! transpose of the usual rotation matrix, so their angle is the negative of ssplat's.

use std::collections::BTreeMap;

use ssplat::{Blend, Channels, Depth, Gaussians};

use super::npy::Array;
use super::parameters::{self, Given, Parameters, rows, same_length};
use super::problem::Problem;

/// Names of the arrays of both programs.
pub const ARRAYS: [&str; 9] =
    ["_xyz", "_cholesky", "_scaling", "_rotation", "_features_dc", "xy", "scale", "rot", "feat"];

/// Commands that convert their checkpoints to archives.
pub const HOW: &str = "\
GaussianImage:

  python3 -c \"import torch, numpy; numpy.savez('fit.npz', **{k: v.cpu().numpy()
    for k, v in torch.load('gaussian_model.pth.tar',
    map_location='cpu').items()})\"

Image-GS:

  python3 -c \"import torch, numpy; numpy.savez('fit.npz', **{k: v.cpu().numpy()
    for k, v in torch.load('ckpt_step-10000.pt', map_location='cpu',
    weights_only=False)['state_dict'].items()})\"";

/// Offset that GaussianImage adds to the diagonal of the Cholesky factor, and to the scales.
const BOUND: f64 = 0.5;

/// Whether the archive has arrays of one of the programs.
pub fn is_known(arrays: &BTreeMap<String, Array>) -> bool {
    arrays.contains_key("_xyz") || arrays.contains_key("feat")
}

/// Returns the parameters, and a note on how ssplat's blend differs from the program's.
pub fn read(arrays: &BTreeMap<String, Array>, given: Given) -> Result<(Parameters, &'static str), Problem> {
    if arrays.contains_key("_xyz") { gaussian_image(arrays, given) } else { image_gs(arrays, given) }
}

/// `μ = ½·size·(1 + tanh xyz)`, `Σ = L Lᵀ` with the factor's diagonal raised by ½, or `Σ = Rᵀ diag(|s + ½|²) R` with an
/// angle of `2π·sigmoid`; the picture is the clamped sum without background.
fn gaussian_image(arrays: &BTreeMap<String, Array>, given: Given) -> Result<(Parameters, &'static str), Problem> {
    let size = given.size(None)?;
    let (places, colors) = (rows(arrays, "_xyz", Some(2))?, rows(arrays, "_features_dc", Some(3))?);
    let n = places.len();
    let mut shapes = Vec::with_capacity(n);
    if arrays.contains_key("_cholesky") {
        let factors = rows(arrays, "_cholesky", Some(3))?;
        for l in factors.iter() {
            let (l11, l21, l22) = (l[0] + BOUND, l[1], l[2] + BOUND);
            shapes.push(parameters::of_covariance([l11 * l11, l11 * l21, l21 * l21 + l22 * l22]));
        }
        same_length(n, &[("_features_dc", colors.len()), ("_cholesky", factors.len())])?;
    } else {
        let (scales, rotations) = (rows(arrays, "_scaling", Some(2))?, rows(arrays, "_rotation", Some(1))?);
        same_length(n, &[("_features_dc", colors.len()), ("_scaling", scales.len()), ("_rotation", rotations.len())])?;
        for (s, r) in scales.iter().zip(rotations.iter()) {
            let turn = std::f64::consts::TAU / (1.0 + (-r[0]).exp());
            let shape = parameters::ordered([(s[0] + BOUND).abs(), (s[1] + BOUND).abs()], -turn);
            shapes.push((shape.0[1] > 0.0).then_some(shape));
        }
    }
    let mean = |p: &[f64], k: usize| 0.5 * f64::from(size[k]) * (1.0 + p[k].tanh()) + 0.5;
    // The program skips Gaussians whose covariance has no inverse.
    let gaussians = (0..n)
        .filter_map(|i| {
            let (scale, rotation) = shapes[i]?;
            Some(parameters::gaussian([mean(&places[i], 0), mean(&places[i], 1)], scale, rotation, &colors[i]))
        })
        .collect();
    let picture = Gaussians {
        width: size[0],
        height: size[1],
        channels: Channels::Rgb,
        depth: Depth::Eight,
        blend: given.blend.unwrap_or(Blend::Sum),
        background: [0.0; 4],
        list: gaussians,
    };
    Ok((
        Parameters { picture, stored: None },
        "GaussianImage cuts off a Gaussian where it is below 1/255; ssplat fades it out up to 3.5 scales",
    ))
}

/// `μ = size·xy`, `Σ = Rᵀ diag(1/scale²) R`; the picture is the mean of the ten largest, weighted by them, with 1e-4
/// added to the sum of the weights.
fn image_gs(arrays: &BTreeMap<String, Array>, given: Given) -> Result<(Parameters, &'static str), Problem> {
    let size = given.size(None)?;
    let (places, scales) = (rows(arrays, "xy", Some(2))?, rows(arrays, "scale", Some(2))?);
    let (rotations, colors) = (rows(arrays, "rot", Some(1))?, rows(arrays, "feat", None)?);
    let others = [("scale", scales.len()), ("rot", rotations.len()), ("feat", colors.len())];
    same_length(places.len(), &others)?;
    let width = colors.width;
    let channels = Channels::from_count(width).ok_or_else(|| format!("feat has {width} channels, not 1 to 4"))?;
    let mean = |p: &[f64], k: usize| f64::from(size[k]) * p[k] + 0.5;
    let gaussians = (0..places.len())
        .map(|i| {
            let inverse = [1.0 / scales[i][0].abs(), 1.0 / scales[i][1].abs()];
            let (scale, rotation) = parameters::ordered(inverse, -rotations[i][0]);
            parameters::gaussian([mean(&places[i], 0), mean(&places[i], 1)], scale, rotation, &colors[i])
        })
        .collect();
    let picture = Gaussians {
        width: size[0],
        height: size[1],
        channels,
        depth: Depth::Eight,
        blend: given.blend.unwrap_or(Blend::Normalized),
        background: [0.0; 4],
        list: gaussians,
    };
    Ok((
        Parameters { picture, stored: None },
        "Image-GS blends the ten largest Gaussians at each pixel and ssplat blends all, so the picture differs slightly",
    ))
}

#[cfg(test)]
mod tests {
    use super::super::npy;
    use super::*;

    fn arrays(of: &[(&str, Vec<usize>, Vec<f32>)]) -> BTreeMap<String, Array> {
        let array = |shape: &[usize], values: &[f32]| {
            npy::read(&npy::floats(shape, values.iter().copied())[..], 1000, &mut 1000).unwrap()
        };
        of.iter().map(|(name, shape, values)| ((*name).to_owned(), array(shape, values))).collect()
    }

    const GIVEN: Given = Given { size: Some([200, 100]), blend: None };

    #[test]
    fn cholesky_factors_of_gaussianimage_become_covariances() {
        let place = vec![0.5f32.atanh(), (-0.5f32).atanh()];
        let arrays = arrays(&[
            ("_xyz", vec![1, 2], place),
            ("_cholesky", vec![1, 3], vec![2.5, 1.0, 0.5]),
            ("_features_dc", vec![1, 3], vec![0.1, 0.2, 0.3]),
        ]);
        let found = read(&arrays, GIVEN).unwrap().0.picture;
        assert_eq!((found.blend, found.channels), (Blend::Sum, Channels::Rgb));
        let g = found.list[0];
        // The centre of the last pixel is 199 there and 199.5 here.
        assert!((g.mean[0] - 150.5).abs() < 1e-4 && (g.mean[1] - 25.5).abs() < 1e-4, "{g:?}");
        // L = [3 0; 1 1].
        let c = parameters::covariance(&g);
        for (found, want) in c.iter().zip([9.0, 3.0, 2.0]) {
            assert!((found - want).abs() < 1e-4, "{c:?}");
        }
    }

    #[test]
    fn scales_and_angles_of_gaussianimage_become_covariances() {
        // sigmoid(−ln 7) = 1/8: an angle of 45° for their matrix, which is the transpose of ours.
        let arrays = arrays(&[
            ("_xyz", vec![1, 2], vec![0.0, 0.0]),
            ("_scaling", vec![1, 2], vec![2.5, -1.5]),
            ("_rotation", vec![1, 1], vec![-(7f32.ln())]),
            ("_features_dc", vec![1, 3], vec![0.1, 0.2, 0.3]),
        ]);
        let g = read(&arrays, GIVEN).unwrap().0.picture.list[0];
        assert_eq!(g.scale, [3.0, 1.0]);
        let c = parameters::covariance(&g);
        for (found, want) in c.iter().zip([5.0, -4.0, 5.0]) {
            assert!((found - want).abs() < 1e-4, "{c:?}");
        }
    }

    #[test]
    fn image_gs_stores_inverse_scales_and_places_in_units_of_the_picture() {
        let arrays = arrays(&[
            ("xy", vec![1, 2], vec![0.25, 0.5]),
            ("scale", vec![1, 2], vec![0.5, 0.25]),
            ("rot", vec![1, 1], vec![0.3]),
            ("feat", vec![1, 1], vec![0.7]),
        ]);
        let found = read(&arrays, GIVEN).unwrap().0.picture;
        assert_eq!((found.blend, found.channels), (Blend::Normalized, Channels::Grey));
        let g = found.list[0];
        assert_eq!((g.mean, g.scale, g.color[0]), ([50.5, 50.5], [4.0, 2.0], 0.7));
        assert!((g.rotation - (std::f32::consts::FRAC_PI_2 - 0.3)).abs() < 1e-6, "{g:?}");
    }

    #[test]
    fn lengths_that_differ_and_missing_sizes_are_named() {
        let mut of = arrays(&[
            ("xy", vec![2, 2], vec![0.5; 4]),
            ("scale", vec![2, 2], vec![0.5; 4]),
            ("rot", vec![1, 1], vec![0.0]),
            ("feat", vec![2, 3], vec![0.5; 6]),
        ]);
        assert!(read(&of, GIVEN).unwrap_err().to_string().contains("2 means but 1 rot"));
        assert!(read(&of, Given::default()).unwrap_err().to_string().contains("--size"));
        of.remove("scale");
        assert!(read(&of, GIVEN).unwrap_err().to_string().contains("no array scale"));
    }
}
