//! Quantizes Gaussians that were fitted elsewhere to the integers of a file, with step sizes chosen by precision or by
//! file size (spec §4.1).
//!
//! Nothing is fitted here: every Gaussian gets the nearest integers. [`Encoder`](crate::Encoder) achieves better
//! quality at a given size, because it refines the integers against the picture.
//!
//! ```
//! # #[cfg(feature = "unstable")] {
//! use ssplat::unstable::{PackOptions, bitstream, pack};
//! use ssplat::{Blend, Channels, Gaussian, Gaussians};
//!
//! let gaussians = vec![Gaussian { mean: [8.0, 4.0], scale: [3.0, 1.5], rotation: 0.3, color: [0.9, 0.2, 0.1, 0.0] }];
//! let picture =
//!     Gaussians { width: 16, height: 8, channels: Channels::Rgb, blend: Blend::Sum, background: [0.0; 4], list: gaussians };
//! let splats = pack(&picture, &PackOptions::default())?;
//! let file = bitstream::to_bytes(&splats)?;
//! # assert!(file.len() < 60);
//! # }
//! # Ok::<(), ssplat::Error>(())
//! ```

use crate::bitstream::lattice::Lattice;
use crate::bitstream::rules::{self, MAX_COLOR};
use crate::bitstream::splats::{Layout, Metadata, PackedSplats, Steps};
use crate::encode::smallest;
use crate::error::{Error, Result};
use crate::gaussian::{Gaussian, Gaussians};
use crate::limits::Limits;
use crate::pixels::Depth;
use crate::quantize::Quantizer;

/// Step sizes from the coarsest to the finest: scale, angle, position, luma and chroma, in the order of [`Steps`]. The
/// encoder uses those in the middle for 24 to 41 dB.
const LADDER: [[u8; 5]; 10] = [
    [9, 2, 3, 9, 2],
    [6, 1, 4, 7, 1],
    [5, 1, 5, 6, 1],
    [4, 1, 6, 6, 1],
    [3, 1, 7, 5, 1],
    [2, 1, 8, 4, 1],
    [1, 1, 9, 3, 1],
    [0, 0, 11, 2, 0],
    [0, 0, 13, 1, 0],
    [0, 0, 15, 0, 0],
];

/// The finest [`Precision::Level`].
pub const FINEST: u8 = LADDER.len() as u8 - 1;

/// Precision of the integers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Precision {
    /// `0..=`[`FINEST`], from coarse to fine. The encoder uses 0 to 5. Levels above 6 enlarge the file and change
    /// little else.
    Level(u8),
    /// The finest level whose file has at most this many bytes. It is an error if the coarsest level needs more. No
    /// Gaussian is left out to reach the size.
    Bytes(u64),
    /// The given steps.
    Steps(Steps),
}

/// Treatment of Gaussians whose mean lies outside the picture, where the format has no positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Outside {
    /// Return [`Error::Parameter`].
    Refuse,
    /// Leave out Gaussians whose support does not reach the picture, and move the means of the others to the nearest
    /// position inside.
    Crop,
}

/// Options of [`pack()`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PackOptions {
    /// Precision of the integers; the default is level 6.
    pub precision: Precision,
    /// Treatment of means outside the picture; the default is [`Outside::Refuse`].
    pub outside: Outside,
    /// Layout of the file.
    pub layout: Layout,
    /// Bits per sample of the picture that the file represents.
    pub depth: Depth,
    /// ICC profile to store.
    pub icc: Option<Vec<u8>>,
    /// EXIF block to store.
    pub exif: Option<Vec<u8>>,
}

impl Default for PackOptions {
    fn default() -> Self {
        let (precision, outside) = (Precision::Level(6), Outside::Refuse);
        PackOptions { precision, outside, layout: Layout::Coded, depth: Depth::Eight, icc: None, exif: None }
    }
}

/// Returns the nearest integers of the Gaussians of `picture`, ready to be written by
/// [`to_bytes`](crate::bitstream::to_bytes). Colours are stored in a codebook if that makes the file smaller.
///
/// Scales below [`MIN_SCALE`](crate::gaussian::MIN_SCALE) are raised to it. [`PackOptions::outside`] chooses the
/// treatment of means outside the picture.
///
/// # Errors
/// [`Error::Parameter`] if a value is not finite, a scale is not positive, a colour exceeds the range of the format (8
/// times white in luma, chroma or alpha), the picture's sides or the steps are out of range, or the file cannot be as
/// small as requested; [`Error::LimitExceeded`] if there are more Gaussians than the default [`Limits`] allow decoders
/// to read.
pub fn pack(picture: &Gaussians, options: &PackOptions) -> Result<PackedSplats> {
    Limits::check("primitives", picture.list.len() as u64, Limits::default().primitives)?;
    picture.list.iter().enumerate().try_for_each(|(i, g)| check(i, g))?;
    if !picture.background.iter().all(|v| v.is_finite()) {
        let problem = format!("{:?} is not finite", picture.background);
        return Err(Error::Parameter { name: "background", problem });
    }
    let packed = |level| packed(picture, options, steps(picture, options.layout, level));
    match options.precision {
        Precision::Steps(steps) => self::packed(picture, options, steps).map(|p| p.0),
        Precision::Level(level) if level <= FINEST => packed(level).map(|p| p.0),
        Precision::Level(level) => {
            Err(Error::Parameter { name: "precision", problem: format!("{level} is outside 0..={FINEST}") })
        }
        Precision::Bytes(most) => {
            let mut least = u64::MAX;
            for level in (0..=FINEST).rev() {
                let (splats, bytes) = packed(level)?;
                if bytes <= most {
                    return Ok(splats);
                }
                least = least.min(bytes);
            }
            let count = picture.list.len();
            let problem = format!("{most} cannot hold {count} Gaussians: {least} are needed");
            Err(Error::Parameter { name: "bytes", problem })
        }
    }
}

/// Checks that the format can represent `g`.
fn check(index: usize, g: &Gaussian) -> Result<()> {
    let bad = |name, values: &[f32], what| {
        Err(Error::Parameter { name, problem: format!("{values:?} of Gaussian {index} is not {what}") })
    };
    for (name, values) in [("mean", &g.mean[..]), ("scale", &g.scale), ("rotation", &[g.rotation]), ("color", &g.color)]
    {
        if !values.iter().all(|v| v.is_finite()) {
            return bad(name, values, "finite");
        }
    }
    if g.scale.iter().all(|&s| s > 0.0) { Ok(()) } else { bad("scale", &g.scale, "positive") }
}

/// Returns the steps of a level for the scales of `picture`.
fn steps(picture: &Gaussians, layout: Layout, level: u8) -> Steps {
    let [scale, angle, position, luma, chroma] = LADDER[usize::from(level)];
    let mut sizes: Vec<f32> = picture.list.iter().map(|g| g.scale[0].max(g.scale[1]).log2()).collect();
    sizes.sort_by(f32::total_cmp);
    let at = |share: f32| sizes.get((sizes.len() as f32 * share) as usize).copied().unwrap_or(0.0);
    let fineness = f32::from(position) / 4.0;
    let (coarsest, range) = match layout {
        Layout::Coded => {
            let coarsest = ((at(0.97) - fineness).ceil() as i8).clamp(-2, 9);
            // At fine levels, the range of exponents includes the smallest Gaussians.
            let finest = if position < 10 { -4 } else { -6 };
            (coarsest, (coarsest - finest).clamp(1, 15) as u8)
        }
        // One step for all positions, fine enough for the small Gaussians.
        Layout::Packed | Layout::Planes => (((at(0.25) - fineness / 2.0).round() as i8).clamp(-4, 6), 0),
    };
    Steps { scale, angle, position, coarsest, range, luma, chroma }
}

/// Returns the integers and the length of their file.
fn packed(picture: &Gaussians, options: &PackOptions, steps: Steps) -> Result<(PackedSplats, u64)> {
    let mut metadata = Metadata::default();
    (metadata.icc, metadata.exif) = (options.icc.clone(), options.exif.clone());
    let mut splats = PackedSplats {
        width: picture.width,
        height: picture.height,
        channels: picture.channels,
        depth: options.depth,
        blend: picture.blend,
        layout: options.layout,
        steps,
        background: [0; 4],
        codebook: None,
        gaussians: Vec::new(),
        levels: Vec::new(),
        detail: None,
        metadata,
    };
    // Checks the sides and the steps before they are used below.
    rules::check(&splats)?;
    let quantizer = splats.quantizer();
    let color = |of: &dyn Fn() -> String, color: [f32; 4]| {
        let axes = quantizer.transform_color(color);
        if axes[..picture.channels.count()].iter().all(|v| v.abs() <= MAX_COLOR) {
            return Ok(quantizer.quantize_color(color));
        }
        let problem = format!("{color:?} of {} is more than {MAX_COLOR} in luma, chroma or alpha", of());
        Err(Error::Parameter { name: "color", problem })
    };
    splats.background = color(&|| "the background".into(), picture.background)?;
    let size = [picture.width, picture.height];
    let asked = matches!(options.precision, Precision::Steps(_));
    for (i, g) in picture.list.iter().enumerate() {
        let bounds = if asked { position_limits(&quantizer, g, size) } else { size.map(|side| side as f32) };
        let is_inside = (0..2).all(|k| (0.0..=bounds[k]).contains(&g.mean[k]));
        if !is_inside && options.outside == Outside::Refuse {
            let problem = format!("{:?} of Gaussian {i} lies outside the picture", g.mean);
            return Err(Error::Parameter { name: "mean", problem });
        }
        color(&|| format!("Gaussian {i}"), g.color)?;
        if is_inside || reaches(g, size) {
            splats.gaussians.push(quantizer.quantize(g));
        }
    }
    let bytes = smallest(&mut splats, 1)?.len() as u64;
    Ok((splats, bytes))
}

/// Returns the limits of the positions of `g`. The last cell of a coarse step may have its centre outside the picture.
/// With explicit steps, it is a valid position as well.
fn position_limits(quantizer: &Quantizer, g: &Gaussian, size: [u32; 2]) -> [f32; 2] {
    let (major, minor, angle) = quantizer.quantize_shape(g.scale, g.rotation);
    let exponents = quantizer.lattice().exponents(major, minor, angle);
    std::array::from_fn(|k| Lattice::positions(size[k], exponents[k]) as f32 * (exponents[k] as f32).exp2())
}

/// Returns whether the support of `g` reaches a picture of `size` pixels.
fn reaches(g: &Gaussian, size: [u32; 2]) -> bool {
    let extent = g.extent();
    (0..2).all(|k| g.mean[k] + extent[k] > 0.0 && g.mean[k] - extent[k] < size[k] as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bitstream;
    use crate::gaussian::{Blend, Channels};

    fn picture(blend: Blend) -> Gaussians {
        let gaussians = (0..400u32)
            .map(|i| {
                let f = |k: u32| (f64::from(i) * f64::from(k).sqrt()).fract() as f32;
                Gaussian {
                    mean: [f(2) * 96.0, f(3) * 64.0],
                    scale: [1.0 + 9.0 * f(5), 0.5 + 5.0 * f(7)],
                    rotation: 3.0 * f(11),
                    color: [f(13), f(17), f(19), 0.0],
                }
            })
            .collect();
        Gaussians {
            width: 96,
            height: 64,
            channels: Channels::Rgb,
            blend,
            background: [0.5, 0.4, 0.3, 0.0],
            list: gaussians,
        }
    }

    /// Returns the largest differences of means (in units of the Gaussian's scales), scales (octaves) and colours.
    fn differences(a: &Gaussians, b: &Gaussians) -> [f32; 3] {
        a.list.iter().zip(&b.list).fold([0.0f32; 3], |worst, (a, b)| {
            let mut scale = a.scale;
            scale.sort_by(|x, y| y.total_cmp(x));
            let (sin, cos) = a.rotation.sin_cos();
            let [dx, dy] = [0, 1].map(|k| a.mean[k] - b.mean[k]);
            let mean = ((cos * dx + sin * dy) / a.scale[0]).hypot((cos * dy - sin * dx) / a.scale[1]);
            let octaves = (0..2).map(|k| (scale[k] / b.scale[k]).log2().abs()).fold(0.0, f32::max);
            let color = (0..3).map(|k| (a.color[k] - b.color[k]).abs()).fold(0.0, f32::max);
            [worst[0].max(mean), worst[1].max(octaves), worst[2].max(color)]
        })
    }

    #[test]
    fn colours_outside_the_format_range_are_refused() {
        for (color, holds) in
            [([8.0, 8.0, 8.0, 0.0], true), ([8.1, 8.1, 8.1, 0.0], false), ([0.0, -9.0, 0.0, 0.0], false)]
        {
            let mut picture = picture(Blend::Sum);
            picture.list[3].color = color;
            for level in 0..=FINEST {
                let options = PackOptions { precision: Precision::Level(level), ..PackOptions::default() };
                match pack(&picture, &options) {
                    Ok(splats) => assert!(holds && bitstream::to_bytes(&splats).is_ok(), "{color:?}"),
                    Err(Error::Parameter { name: "color", problem }) => {
                        assert!(!holds && problem.contains("Gaussian 3"), "{color:?} {problem}");
                    }
                    other => panic!("{other:?}"),
                }
            }
            picture.list.clear();
            picture.background = color;
            assert_eq!(pack(&picture, &PackOptions::default()).is_ok(), holds, "{color:?}");
        }
    }

    #[test]
    fn every_level_and_layout_stays_within_half_its_steps() {
        let picture = picture(Blend::Sum);
        for layout in [Layout::Coded, Layout::Planes, Layout::Packed] {
            for level in 0..=FINEST {
                let options = PackOptions { precision: Precision::Level(level), layout, ..PackOptions::default() };
                let splats = pack(&picture, &options).unwrap();
                let bytes = bitstream::to_bytes(&splats).unwrap();
                assert_eq!(bitstream::read(&bytes[..], &Limits::default()).unwrap().gaussians.len(), 400);
                let [_, octaves, color] = differences(&picture, &splats.to_picture());
                let delta = (f32::from(splats.steps.scale) + 4.0) / 32.0;
                assert!(octaves <= 0.5 * delta + 1e-4, "{layout:?} {level}: {octaves} octaves");
                // A channel is the sum of luma and half of each chroma component.
                let steps = splats.quantizer().color_steps();
                assert!(color <= 0.5 * steps[0] + 0.5 * steps[1] + 1e-5, "{layout:?} {level}: {color}");
            }
        }
    }

    #[test]
    fn the_finest_level_keeps_positions_within_a_tenth_of_the_scale() {
        let splats =
            pack(&picture(Blend::Sum), &PackOptions { precision: Precision::Level(FINEST), ..PackOptions::default() });
        let [mean, ..] = differences(&picture(Blend::Sum), &splats.unwrap().to_picture());
        assert!(mean < 0.1, "{mean}");
    }

    #[test]
    fn stored_gaussians_get_the_same_integers_with_the_same_steps() {
        for layout in [Layout::Coded, Layout::Planes, Layout::Packed] {
            let options = PackOptions { layout, ..PackOptions::default() };
            let once = pack(&picture(Blend::Normalized), &options).unwrap();
            let options = PackOptions { precision: Precision::Steps(once.steps), ..options };
            assert_eq!(pack(&once.to_picture(), &options).unwrap(), once);
        }
    }

    #[test]
    fn a_size_is_filled_with_the_finest_level_that_fits() {
        let picture = picture(Blend::Normalized);
        let length = |precision| {
            let options = PackOptions { precision, ..PackOptions::default() };
            bitstream::to_bytes(&pack(&picture, &options).unwrap()).unwrap().len() as u64
        };
        let (at, finer) = (length(Precision::Level(4)), length(Precision::Level(5)));
        assert!(finer > at);
        assert_eq!(length(Precision::Bytes(finer - 1)), at);
        assert_eq!(length(Precision::Bytes(finer)), finer);
        let least = length(Precision::Level(0));
        let options = PackOptions { precision: Precision::Bytes(least - 1), ..PackOptions::default() };
        let error = pack(&picture, &options).unwrap_err().to_string();
        assert!(error.contains(&least.to_string()), "{error}");
    }

    #[test]
    fn values_that_the_format_cannot_represent_are_parameter_errors() {
        for (what, change) in [
            ("mean", (|g: &mut Gaussian| g.mean[1] = f32::NAN) as fn(&mut Gaussian)),
            ("scale", |g| g.scale[0] = 0.0),
            ("scale", |g| g.scale[1] = -1.0),
            ("rotation", |g| g.rotation = f32::INFINITY),
            ("color", |g| g.color[2] = f32::NAN),
        ] {
            let mut picture = picture(Blend::Sum);
            change(&mut picture.list[7]);
            let error = pack(&picture, &PackOptions::default()).unwrap_err().to_string();
            assert!(error.contains(&format!("{what}: ")) && error.contains("Gaussian 7"), "{error}");
        }
        for (width, height) in [(0, 8), (8, 1 << 21)] {
            let picture = Gaussians { width, height, ..picture(Blend::Sum) };
            assert!(matches!(pack(&picture, &PackOptions::default()), Err(Error::Parameter { .. })));
        }
    }

    #[test]
    fn equal_colours_become_a_codebook() {
        let mut picture = picture(Blend::Sum);
        let few = picture.list[..5].iter().map(|g| g.color).collect::<Vec<_>>();
        picture.list.iter_mut().enumerate().for_each(|(i, g)| g.color = few[i % 5]);
        let splats = pack(&picture, &PackOptions::default()).unwrap();
        assert_eq!(splats.codebook.map(|c| c.len()), Some(5));
    }

    #[test]
    fn gaussians_outside_are_omitted_or_moved_to_the_border() {
        let mut picture = picture(Blend::Sum);
        picture.list.truncate(3);
        picture.list[0].mean = [-1000.0, 5.0];
        (picture.list[1].mean, picture.list[1].scale) = ([97.0, 5.0], [4.0, 4.0]);
        let error = pack(&picture, &PackOptions::default()).unwrap_err().to_string();
        assert!(error.contains("mean: [-1000.0, 5.0] of Gaussian 0"), "{error}");
        let options = PackOptions { outside: Outside::Crop, ..PackOptions::default() };
        let found = pack(&picture, &options).unwrap().to_picture();
        assert_eq!(found.list.len(), 2);
        assert!((found.list[0].mean[0] - 96.0).abs() < 1.0, "{:?}", found.list[0]);
    }
}
