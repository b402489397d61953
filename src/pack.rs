//! Quantizes Gaussians that were fitted elsewhere to the integers of a file, with step sizes chosen by precision or by
//! file size (spec §4.1). [`Encoder::encode_gaussians`](crate::Encoder::encode_gaussians) is its public entry.
//!
//! Nothing is fitted here: every Gaussian gets the nearest integers. [`Encoder::encode`](crate::Encoder::encode)
//! achieves better quality at a given size, because it refines the integers against the picture.

use crate::bitstream::lattice::Lattice;
use crate::bitstream::rules::{self, MAX_COLOR};
use crate::bitstream::splats::{Layout, Metadata, PackedSplats, Steps};
use crate::encode::render::check_opens;
use crate::encode::{self, EncodeReport, Encoded, smallest};
use crate::error::{Error, Result};
use crate::gaussian::{Gaussian, Gaussians};
use crate::instant::Instant;
use crate::limits::Limits;
use crate::options::{Backend, Detail, EncodeOptions, Outside, Precision, Thumbnail};
use crate::parameter::{Limit, Parameter};
use crate::quantize::Quantizer;
use crate::target::Target;

/// Step sizes from the coarsest to the finest: scale, angle, position, luma and chroma, in the order of [`Steps`]. The
/// encoder uses similar ones for 24 to 41 dB: levels 2 to 5, and one between levels 3 and 4.
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

/// The level of files without a requested size.
const DEFAULT_LEVEL: u8 = 6;

/// Writes the nearest integers of `given` to a file.
///
/// # Errors
/// As [`Encoder::encode_gaussians`](crate::Encoder::encode_gaussians).
pub(crate) fn encode_gaussians(given: &Gaussians, options: &EncodeOptions) -> Result<Encoded> {
    let start = Instant::now();
    encode::check(options)?;
    check_applies(given, options)?;
    let (splats, bytes) = pack(given, options)?;
    check_opens(&splats)?;
    let report = EncodeReport {
        gaussians: splats.gaussians.len(),
        psnr: f64::NAN,
        float_psnr: f64::NAN,
        seconds: start.elapsed().as_secs_f64(),
        ..EncodeReport::default()
    };
    Ok(Encoded { bytes, report })
}

/// Checks that no option is set that only applies to pixels.
fn check_applies(given: &Gaussians, options: &EncodeOptions) -> Result<()> {
    let plain = EncodeOptions::default();
    let target = match options.target {
        Target::Gaussians(_) => Some(Parameter::Gaussians),
        Target::Psnr(_) => Some(Parameter::Psnr),
        #[cfg(feature = "quality-hook")]
        Target::Quality(_) => Some(Parameter::Quality),
        Target::Lossless => Some(Parameter::Other("lossless")),
        Target::Auto | Target::Bytes(_) | Target::Ratio(_) => None,
    };
    let is_set = [
        (Parameter::Effort, options.effort != plain.effort),
        (Parameter::Time, options.time.is_some()),
        (Parameter::Seed, options.seed != plain.seed),
        (Parameter::Blend, options.blend.is_some_and(|blend| blend != given.blend)),
        (Parameter::Tune, options.tune.is_some()),
        (Parameter::Backend, options.backend == Backend::Gpu),
        (Parameter::Detail, matches!(options.detail, Detail::GaussianShare(_))),
        (Parameter::Thumbnail, matches!(options.thumbnail, Thumbnail::Bytes(_))),
        (Parameter::Tiles, options.tiles.is_some()),
        (Parameter::Other("inspector"), options.inspector.is_some()),
    ];
    match target.or(is_set.into_iter().find(|(_, is_set)| *is_set).map(|(parameter, _)| parameter)) {
        Some(parameter) => Err(Error::Parameter { parameter, problem: "it does not apply to given Gaussians".into() }),
        None => Ok(()),
    }
}

/// Returns the nearest integers of `given` and the bytes of their file. Colours are stored in a codebook if that makes
/// the file smaller.
///
/// Scales below [`MIN_SCALE`](crate::gaussian::MIN_SCALE) are raised to it. [`EncodeOptions::outside`] chooses the
/// treatment of means outside the picture.
fn pack(given: &Gaussians, options: &EncodeOptions) -> Result<(PackedSplats, Vec<u8>)> {
    Limits::check(Limit::Gaussians, given.list.len() as u64, Limits::default().gaussians)?;
    given.list.iter().enumerate().try_for_each(|(i, g)| check(i, g))?;
    if !given.background.iter().all(|v| v.is_finite()) {
        let problem = format!("{:?} is not finite", given.background);
        return Err(Error::Parameter { parameter: Parameter::Background, problem });
    }
    let samples = f64::from(given.width) * f64::from(given.height) * given.channels.count() as f64;
    let max_bytes = match options.target {
        Target::Bytes(bytes) => Some(bytes),
        // Casts saturate.
        Target::Ratio(ratio) => Some((samples / ratio).floor() as u64),
        _ => None,
    };
    let levels = match options.precision {
        Some(Precision::Level(level)) if level > FINEST => {
            let problem = format!("{level} is outside 0..={FINEST}");
            return Err(Error::Parameter { parameter: Parameter::Precision, problem });
        }
        Some(Precision::Level(level)) => level..=level,
        Some(Precision::Steps(_)) => 0..=0,
        None => {
            let exact = exact_level(given, options.layout)?;
            match max_bytes {
                None => exact.map_or(DEFAULT_LEVEL..=DEFAULT_LEVEL, |level| level..=level),
                Some(_) => 0..=exact.unwrap_or(FINEST),
            }
        }
    };
    let (max_bytes, mut least) = (max_bytes.unwrap_or(u64::MAX), u64::MAX);
    for level in levels.rev() {
        let steps = match options.precision {
            Some(Precision::Steps(steps)) => steps,
            _ => steps(given, options.layout, level)?,
        };
        let (splats, bytes) = packed(given, options, steps)?;
        if bytes.len() as u64 <= max_bytes {
            return Ok((splats, bytes));
        }
        least = least.min(bytes.len() as u64);
    }
    let problem = format!("{max_bytes} cannot hold {} Gaussians: {least} are needed", given.list.len());
    Err(Error::Parameter { parameter: Parameter::Bytes, problem })
}

/// Returns the coarsest level that stores `given` without any rounding, as those of Gaussians that come from a file of
/// this function. Finer levels would only enlarge the file.
fn exact_level(given: &Gaussians, layout: Layout) -> Result<Option<u8>> {
    for level in 0..=FINEST {
        let quantizer = blank(given, layout, steps(given, layout, level)?)?.quantizer();
        let color = quantizer.dequantize_color(quantizer.quantize_color(given.background));
        let is_exact = |g: &Gaussian| quantizer.dequantize(&quantizer.quantize(g)) == *g;
        if color == given.background && given.list.iter().all(is_exact) {
            return Ok(Some(level));
        }
    }
    Ok(None)
}

/// Checks that the format can represent `g`.
fn check(index: usize, g: &Gaussian) -> Result<()> {
    let bad = |parameter, values: &[f32], what| {
        Err(Error::Parameter { parameter, problem: format!("{values:?} of Gaussian {index} is not {what}") })
    };
    for (parameter, values) in [
        (Parameter::Mean, &g.mean[..]),
        (Parameter::Scale, &g.scale),
        (Parameter::Rotation, &[g.rotation]),
        (Parameter::Color, &g.color),
    ] {
        if !values.iter().all(|v| v.is_finite()) {
            return bad(parameter, values, "finite");
        }
    }
    if g.scale.iter().all(|&s| s > 0.0) { Ok(()) } else { bad(Parameter::Scale, &g.scale, "positive") }
}

/// Returns the steps of a level for the scales of `given`. They depend only on the scales as they are stored, so that
/// stored Gaussians get the same steps again.
fn steps(given: &Gaussians, layout: Layout, level: u8) -> Result<Steps> {
    let [scale, angle, position, luma, chroma] = LADDER[usize::from(level)];
    let mut steps =
        Steps { scale, angle, position, coarsest: 0, range: u8::from(layout == Layout::Coded), luma, chroma };
    // Checks the sides before they are used.
    let blank = blank(given, layout, steps)?;
    let quantizer = blank.quantizer();
    let mut majors: Vec<u8> = given.list.iter().map(|g| quantizer.quantize_shape(g.scale, g.rotation).0).collect();
    majors.sort_unstable();
    let at = |share: f32| {
        let index = majors.get((majors.len() as f32 * share) as usize);
        index.map_or(0.0, |&index| quantizer.scale(index).log2())
    };
    let fineness = f32::from(position) / 4.0;
    (steps.coarsest, steps.range) = match layout {
        Layout::Coded => {
            let coarsest = ((at(0.97) - fineness).ceil() as i8).clamp(-2, 9);
            // At fine levels, the range of exponents includes the smallest Gaussians.
            let finest = if position < 10 { -4 } else { -6 };
            (coarsest, (coarsest - finest).clamp(1, 15) as u8)
        }
        // One step for all positions, fine enough for the small Gaussians.
        Layout::Packed | Layout::Planes => (((at(0.25) - fineness / 2.0).round() as i8).clamp(-4, 6), 0),
    };
    Ok(steps)
}

/// Returns a file without Gaussians.
///
/// # Errors
/// [`Error::Parameter`] if the sides of the picture or the steps are out of range.
fn blank(picture: &Gaussians, layout: Layout, steps: Steps) -> Result<PackedSplats> {
    let splats = PackedSplats {
        width: picture.width,
        height: picture.height,
        channels: picture.channels,
        depth: picture.depth,
        blend: picture.blend,
        layout,
        steps,
        background: [0; 4],
        codebook: None,
        gaussians: Vec::new(),
        levels: Vec::new(),
        detail: None,
        exact: None,
        metadata: Metadata::default(),
    };
    rules::check(&splats)?;
    Ok(splats)
}

/// Returns the integers and their file.
fn packed(picture: &Gaussians, options: &EncodeOptions, steps: Steps) -> Result<(PackedSplats, Vec<u8>)> {
    let mut splats = blank(picture, options.layout, steps)?;
    splats.metadata = options.stored();
    let quantizer = splats.quantizer();
    let color = |of: &dyn Fn() -> String, color: [f32; 4]| {
        let axes = quantizer.transform_color(color);
        if axes[..picture.channels.count()].iter().all(|v| v.abs() <= MAX_COLOR) {
            return Ok(quantizer.quantize_color(color));
        }
        let problem = format!("{color:?} of {} is more than {MAX_COLOR} in luma, chroma or alpha", of());
        Err(Error::Parameter { parameter: Parameter::Color, problem })
    };
    splats.background = color(&|| "the background".into(), picture.background)?;
    let size = [picture.width, picture.height];
    for (i, g) in picture.list.iter().enumerate() {
        let bounds = position_limits(&quantizer, g, size);
        let is_inside = (0..2).all(|k| (0.0..=bounds[k]).contains(&g.mean[k]));
        if !is_inside && options.outside == Outside::Refuse {
            let problem = format!("{:?} of Gaussian {i} lies outside the picture", g.mean);
            return Err(Error::Parameter { parameter: Parameter::Mean, problem });
        }
        color(&|| format!("Gaussian {i}"), g.color)?;
        if is_inside || reaches(g, size) {
            splats.gaussians.push(quantizer.quantize(g));
        }
    }
    let bytes = smallest(&mut splats, options.levels)?;
    Ok((splats, bytes))
}

/// Returns the limits of the positions of `g`. The last cell of a coarse step may have its centre outside the picture,
/// and a Gaussian from a file may lie there.
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
    use crate::depth::Depth;
    use crate::gaussian::{Blend, Channels};

    fn stored(given: &Gaussians, options: &EncodeOptions) -> Result<PackedSplats> {
        pack(given, options).map(|(splats, _)| splats)
    }

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
            depth: Depth::Eight,
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
                let options = EncodeOptions { precision: Some(Precision::Level(level)), ..EncodeOptions::default() };
                match stored(&picture, &options) {
                    Ok(splats) => assert!(holds && bitstream::to_bytes(&splats).is_ok(), "{color:?}"),
                    Err(Error::Parameter { parameter: Parameter::Color, problem }) => {
                        assert!(!holds && problem.contains("Gaussian 3"), "{color:?} {problem}");
                    }
                    other => panic!("{other:?}"),
                }
            }
            picture.list.clear();
            picture.background = color;
            assert_eq!(stored(&picture, &EncodeOptions::default()).is_ok(), holds, "{color:?}");
        }
    }

    #[test]
    fn every_level_and_layout_stays_within_half_its_steps() {
        let picture = picture(Blend::Sum);
        for layout in [Layout::Coded, Layout::Planes, Layout::Packed] {
            for level in 0..=FINEST {
                let options =
                    EncodeOptions { precision: Some(Precision::Level(level)), layout, ..EncodeOptions::default() };
                let splats = stored(&picture, &options).unwrap();
                let bytes = bitstream::to_bytes(&splats).unwrap();
                assert_eq!(bitstream::read(&bytes[..], &Limits::default()).unwrap().gaussians.len(), 400);
                let [_, octaves, color] = differences(&picture, &splats.to_gaussians());
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
        let splats = stored(
            &picture(Blend::Sum),
            &EncodeOptions { precision: Some(Precision::Level(FINEST)), ..EncodeOptions::default() },
        );
        let [mean, ..] = differences(&picture(Blend::Sum), &splats.unwrap().to_gaussians());
        assert!(mean < 0.1, "{mean}");
    }

    #[test]
    fn stored_gaussians_get_the_same_integers_with_the_same_steps() {
        for layout in [Layout::Coded, Layout::Planes, Layout::Packed] {
            let options = EncodeOptions { layout, ..EncodeOptions::default() };
            let once = stored(&picture(Blend::Normalized), &options).unwrap();
            let options = EncodeOptions { precision: Some(Precision::Steps(once.steps)), ..options };
            assert_eq!(stored(&once.to_gaussians(), &options).unwrap(), once);
        }
    }

    #[test]
    fn a_size_is_filled_with_the_finest_level_that_fits() {
        let picture = picture(Blend::Normalized);
        let length = |precision, target| {
            let options = EncodeOptions { precision, target, ..EncodeOptions::default() };
            pack(&picture, &options).unwrap().1.len() as u64
        };
        let at_level = |level| length(Some(Precision::Level(level)), Target::Auto);
        let (at, finer) = (at_level(4), at_level(5));
        assert!(finer > at);
        assert_eq!(length(None, Target::Bytes(finer - 1)), at);
        assert_eq!(length(None, Target::Bytes(finer)), finer);
        let least = at_level(0);
        let options = EncodeOptions { target: Target::Bytes(least - 1), ..EncodeOptions::default() };
        let error = stored(&picture, &options).unwrap_err().to_string();
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
            let error = stored(&picture, &EncodeOptions::default()).unwrap_err().to_string();
            assert!(error.contains(&format!("{what}: ")) && error.contains("Gaussian 7"), "{error}");
        }
        for (width, height) in [(0, 8), (8, 1 << 21)] {
            let picture = Gaussians { width, height, ..picture(Blend::Sum) };
            assert!(matches!(stored(&picture, &EncodeOptions::default()), Err(Error::Parameter { .. })));
        }
    }

    #[test]
    fn equal_colours_become_a_codebook() {
        let mut picture = picture(Blend::Sum);
        let few = picture.list[..5].iter().map(|g| g.color).collect::<Vec<_>>();
        picture.list.iter_mut().enumerate().for_each(|(i, g)| g.color = few[i % 5]);
        let splats = stored(&picture, &EncodeOptions::default()).unwrap();
        assert_eq!(splats.codebook.map(|c| c.len()), Some(5));
    }

    #[test]
    fn gaussians_outside_are_omitted_or_moved_to_the_border() {
        let mut picture = picture(Blend::Sum);
        picture.list.truncate(3);
        picture.list[0].mean = [-1000.0, 5.0];
        (picture.list[1].mean, picture.list[1].scale) = ([97.0, 5.0], [4.0, 4.0]);
        let error = stored(&picture, &EncodeOptions::default()).unwrap_err().to_string();
        assert!(error.contains("mean: [-1000.0, 5.0] of Gaussian 0"), "{error}");
        let options = EncodeOptions { outside: Outside::Crop, ..EncodeOptions::default() };
        let found = stored(&picture, &options).unwrap().to_gaussians();
        assert_eq!(found.list.len(), 2);
        assert!((found.list[0].mean[0] - 96.0).abs() < 1.0, "{:?}", found.list[0]);
    }
}
