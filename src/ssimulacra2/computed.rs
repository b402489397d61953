//! SSIMULACRA2 computed by the crate `fast-ssim2`.

use fast_ssim2::{
    PixelDescriptor, PixelSlice, Ssimulacra2Config, Ssimulacra2Reference, compute_ssimulacra2_with_config,
};

use super::measurable::measurable;
use crate::error::{Error, Result};
use crate::metrics::BACKGROUNDS;
use crate::parameter::Parameter;
use crate::pixels::{Pixels, Samples};
use crate::strict_math::StrictMath;

/// Number of pixels above which the measure is computed in strips. This takes less memory and changes the last digits
/// of the score.
const STRIPED_PIXELS: u64 = 1 << 22;
/// Rows of a strip.
const STRIP_ROWS: usize = 256;

/// Returns the SSIMULACRA2 score of two pictures of the same size, channels and depth, whose samples are interpreted
/// as sRGB. The score is at most 100, for identical pictures. About 90, 70, 50 and 30 mean very high, high, medium and
/// low quality; scores can be negative. Pictures with alpha are composited onto a dark and onto a light grey, and the
/// lower score is returned. Pictures with a side below 64 pixels are mirrored before they are measured, because the
/// measure needs several scales. If `reference` has 16 bits and uses less than an eighth of their range, that part is
/// stretched to the whole range in both pictures.
///
/// # Errors
/// [`Error::Parameter`] if the two differ in width, height, channels or depth.
pub fn ssimulacra2(reference: &Pixels, test: &Pixels) -> Result<f64> {
    crate::metrics::check_alike(reference, test)?;
    if let Some([reference, test]) = measurable(reference, test) {
        return measured(&reference, &test);
    }
    measured(reference, test)
}

/// Returns the score of pictures that can be measured as they are.
fn measured(reference: &Pixels, test: &Pixels) -> Result<f64> {
    let size = [reference.width(), reference.height()];
    let mut worst = f64::INFINITY;
    for &background in backgrounds(reference) {
        let [a, b] = [reference, test].map(|pixels| linear_light(pixels, background));
        worst = worst.min(similarity(&a, &b, size)?);
    }
    Ok(worst)
}

fn similarity(a: &[[f32; 3]], b: &[[f32; 3]], size: [u32; 2]) -> Result<f64> {
    let config = if is_large(size) { Ssimulacra2Config::strips(STRIP_ROWS) } else { Ssimulacra2Config::default() };
    compute_ssimulacra2_with_config(&slice(a, size)?, &slice(b, size)?, &config).map_err(failed)
}

/// Returns whether pictures of this size are measured in strips.
fn is_large([width, height]: [u32; 2]) -> bool {
    u64::from(width) * u64::from(height) > STRIPED_PIXELS
}

fn slice(pixels: &[[f32; 3]], [width, height]: [u32; 2]) -> Result<PixelSlice<'_>> {
    let row = width as usize * size_of::<[f32; 3]>();
    let slice = PixelSlice::new(bytemuck::cast_slice(pixels), width, height, row, PixelDescriptor::RGBF32_LINEAR);
    slice.map_err(|e| failed(format!("{e:?}")))
}

fn failed(problem: impl std::fmt::Display) -> Error {
    Error::Parameter { parameter: Parameter::Pixels, problem: format!("SSIMULACRA2: {problem}") }
}

/// A picture against which several others are measured. What the measure needs of it is computed once.
pub(crate) struct Reference<'a> {
    pixels: &'a Pixels,
    /// What is computed for each background. It is empty if the picture is large or is not measured as it is.
    computed: Vec<(f32, Ssimulacra2Reference)>,
}

impl<'a> Reference<'a> {
    /// Prepares `pixels`.
    ///
    /// # Errors
    /// An error of the measure.
    pub(crate) fn new(pixels: &'a Pixels) -> Result<Self> {
        let size = [pixels.width(), pixels.height()];
        let backgrounds =
            if is_large(size) || measurable(pixels, pixels).is_some() { &[] } else { backgrounds(pixels) };
        let computed = backgrounds.iter().map(|&background| {
            let computed = Ssimulacra2Reference::new(&slice(&linear_light(pixels, background), size)?);
            Ok((background, computed.map_err(failed)?))
        });
        Ok(Reference { pixels, computed: computed.collect::<Result<_>>()? })
    }

    /// Returns the score of `test`, as [`ssimulacra2`] does.
    ///
    /// # Errors
    /// [`Error::Parameter`] if the pictures differ in width, height, channels or depth.
    pub(crate) fn score(&self, test: &Pixels) -> Result<f64> {
        if self.computed.is_empty() {
            return ssimulacra2(self.pixels, test);
        }
        crate::metrics::check_alike(self.pixels, test)?;
        let mut scores = self.computed.iter().map(|(background, computed)| {
            let light = linear_light(test, *background);
            computed.compare(&slice(&light, [test.width(), test.height()])?).map_err(failed)
        });
        scores.try_fold(f64::INFINITY, |worst, score| Ok(worst.min(score?)))
    }
}

/// Returns the greys onto which a picture is composited.
fn backgrounds(pixels: &Pixels) -> &'static [f32] {
    if pixels.channels().alpha().is_some() { &BACKGROUNDS[..] } else { &BACKGROUNDS[..1] }
}

/// Returns `pixels`, interpreted as sRGB and composited onto a grey of the sRGB value `background`, in linear light:
/// red, green and blue of each pixel, where 1.0 is white.
#[must_use]
pub fn linear_light(pixels: &Pixels, background: f32) -> Vec<[f32; 3]> {
    let (count, alpha) = (pixels.channels().count(), pixels.channels().alpha());
    let pixel = |values: &[f32]| {
        let opacity = alpha.map_or(1.0, |a| values[a]);
        [0, 1, 2].map(|k| linear(background + opacity * (values[if count < 3 { 0 } else { k }] - background)))
    };
    let mut values = [0.0f32; 4];
    let mut of = |samples: &mut dyn Iterator<Item = f32>| {
        samples.zip(&mut values[..count]).for_each(|(v, to)| *to = v);
        pixel(&values[..count])
    };
    match pixels.samples() {
        // Opaque samples of 8 bits have 256 results.
        Samples::U8(v) if alpha.is_none() => {
            let known: [f32; 256] = std::array::from_fn(|i| pixel(&[i as f32 / 255.0; 4])[0]);
            v.chunks_exact(count)
                .map(|p| [0, 1, 2].map(|k| known[usize::from(p[if count < 3 { 0 } else { k }])]))
                .collect()
        }
        Samples::U8(v) => {
            let known: [f32; 256] = std::array::from_fn(|i| i as f32 / 255.0);
            v.chunks_exact(count).map(|p| of(&mut p.iter().map(|&v| known[usize::from(v)]))).collect()
        }
        Samples::U16(v) => v.chunks_exact(count).map(|p| of(&mut p.iter().map(|&v| f32::from(v) / 65535.0))).collect(),
    }
}

/// Converts an sRGB value to linear light.
fn linear(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).strict_powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussian::Channels;

    #[test]
    fn a_prepared_reference_gives_the_same_scores() {
        for (side, channels) in [(80, Channels::Rgb), (80, Channels::Rgba), (70, Channels::Grey), (20, Channels::Rgb)] {
            let count = side * side * channels.count() as u32;
            let picture = |noise: u32| {
                let samples = (0..count).map(|i| (i / 90 % 200 + (i.wrapping_mul(2_654_435_761) >> 24) % noise) as u8);
                Pixels::new(side, side, channels, Samples::U8(samples.collect())).unwrap()
            };
            let (a, b) = (picture(1), picture(30));
            let reference = Reference::new(&a).unwrap();
            assert_eq!(reference.score(&b).unwrap(), ssimulacra2(&a, &b).unwrap(), "{side} {channels:?}");
            assert_eq!(
                reference.computed.len(),
                if side < 64 { 0 } else { 1 + usize::from(channels == Channels::Rgba) }
            );
            assert!(reference.score(&picture(1).clone()).unwrap() > 99.9);
        }
    }

    #[test]
    fn opaque_samples_are_as_light_with_alpha_as_without() {
        let values: Vec<u8> = (0..=255).flat_map(|v| [v, v ^ 0x55, 255 - v]).collect();
        let with_alpha: Vec<u8> = values.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect();
        let [opaque, covered] = [(Channels::Rgb, values), (Channels::Rgba, with_alpha)]
            .map(|(channels, v)| Pixels::new(16, 16, channels, Samples::U8(v)).unwrap());
        for background in BACKGROUNDS {
            assert_eq!(linear_light(&opaque, background), linear_light(&covered, background));
        }
    }
}
