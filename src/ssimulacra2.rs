//! How far two pictures are apart to the eye: SSIMULACRA2, by the crate that has it.

use fast_ssim2::{PixelDescriptor, PixelSlice, Ssimulacra2Config, compute_ssimulacra2_with_config};

use crate::error::{Error, Result};
use crate::metrics::BACKGROUNDS;
use crate::pixels::{Pixels, Samples};

/// Least side of a picture that is measured, pixels.
pub(crate) const LEAST: u32 = 8;
/// Pixels from which on the measure goes over strips of the picture, which takes less memory and moves its last digits.
const LARGE: u64 = 1 << 22;
/// Rows of such a strip.
const STRIP: usize = 256;

/// SSIMULACRA2 of two pictures of one size, channels and depth, whose samples are taken as sRGB: at most 100, which stands
/// for equal pictures; about 90, 70, 50 and 30 for what eyes call very high, high, medium and low quality; below 0 for worse.
/// `None` when a side is under 8 pixels. Where there is alpha, both are laid over a dark and over a light grey, and the worse
/// counts.
///
/// # Errors
/// [`Error::Parameter`] when the two differ in width, height, channels or depth.
pub fn ssimulacra2(reference: &Pixels, test: &Pixels) -> Result<Option<f64>> {
    crate::metrics::check_alike(reference, test)?;
    let size = [reference.width(), reference.height()];
    if size[0].min(size[1]) < LEAST {
        return Ok(None);
    }
    let backgrounds = if reference.channels().alpha().is_some() { &BACKGROUNDS[..] } else { &BACKGROUNDS[..1] };
    let mut worst = f64::INFINITY;
    for &background in backgrounds {
        let [a, b] = [reference, test].map(|pixels| linear_light(pixels, background));
        worst = worst.min(similarity(&a, &b, size)?);
    }
    Ok(Some(worst))
}

fn similarity(a: &[[f32; 3]], b: &[[f32; 3]], [width, height]: [u32; 2]) -> Result<f64> {
    let failed = |e: String| Error::Parameter { name: "pixels", problem: format!("SSIMULACRA2: {e}") };
    let slice = |p| {
        let row = width as usize * size_of::<[f32; 3]>();
        PixelSlice::new(bytemuck::cast_slice(p), width, height, row, PixelDescriptor::RGBF32_LINEAR)
    };
    let is_large = u64::from(width) * u64::from(height) > LARGE;
    let config = if is_large { Ssimulacra2Config::strips(STRIP) } else { Ssimulacra2Config::default() };
    let (a, b) = (slice(a).map_err(|e| failed(format!("{e:?}")))?, slice(b).map_err(|e| failed(format!("{e:?}")))?);
    compute_ssimulacra2_with_config(&a, &b, &config).map_err(|e| failed(e.to_string()))
}

/// Returns `pixels`, whose samples are taken as sRGB, over a grey of the sRGB value `background`, in linear light: red, green
/// and blue of each pixel, where 1.0 is white.
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
        Samples::U8(v) => {
            let known: [f32; 256] = std::array::from_fn(|i| i as f32 / 255.0);
            v.chunks_exact(count).map(|p| of(&mut p.iter().map(|&v| known[usize::from(v)]))).collect()
        }
        Samples::U16(v) => v.chunks_exact(count).map(|p| of(&mut p.iter().map(|&v| f32::from(v) / 65535.0))).collect(),
    }
}

/// Linear light of an sRGB value.
fn linear(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}
