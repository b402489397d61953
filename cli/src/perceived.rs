//! Perceptual metrics: SSIMULACRA2 and the 3-norm of Butteraugli.
//!
//! Both treat samples as sRGB. Pictures with alpha are measured over a dark and over a light background, and the worse
//! value counts. The lab uses this module as well.

use butteraugli::{ButteraugliParams, Img, RGB, butteraugli_linear};
use ssplat::Pixels;
use ssplat::unstable::metrics::{self, BACKGROUNDS};

/// Shortest side that Butteraugli accepts, pixels.
const MIN_SIDE: u32 = 8;
/// Larger pictures are not measured by Butteraugli, which takes about 250 bytes of memory per pixel.
const MAX_PIXELS: u64 = 1 << 24;

/// Perceptual metrics of the difference between two pictures.
#[derive(Debug, Clone, Copy, Default)]
pub struct Perceived {
    /// 100 for equal pictures; about 90, 70, 50 and 30 for very high, high, medium and low quality; may be negative.
    /// Small pictures are mirrored before they are measured.
    pub ssimulacra2: Option<f64>,
    /// 0 for equal pictures; lower is better. `None` if a side is under 8 pixels, or for more than 2²⁴ pixels.
    pub butteraugli: Option<f64>,
}

/// Measures two pictures with the same size, channels and depth.
pub fn measure(reference: &Pixels, test: &Pixels) -> Perceived {
    let (width, height) = (reference.width(), reference.height());
    let ssimulacra2 = metrics::ssimulacra2(reference, test).ok();
    if width.min(height) < MIN_SIDE {
        return Perceived { ssimulacra2, butteraugli: None };
    }
    let backgrounds = if reference.channels().alpha().is_some() { &BACKGROUNDS[..] } else { &BACKGROUNDS[..1] };
    let found = backgrounds.iter().map(|&background| {
        let [a, b] = [reference, test].map(|pixels| {
            let light = metrics::linear_light(pixels, background);
            light.into_iter().map(|[r, g, b]| RGB::new(r, g, b)).collect::<Vec<_>>()
        });
        distance(&a, &b, [width, height])
    });
    // The worse value counts; there is none if one is missing.
    let butteraugli = found.reduce(|a, b| a.zip(b).map(|(a, b)| a.max(b))).flatten();
    Perceived { ssimulacra2, butteraugli }
}

fn distance(a: &[RGB<f32>], b: &[RGB<f32>], [width, height]: [u32; 2]) -> Option<f64> {
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return None;
    }
    let picture = |p| Img::new(p, width as usize, height as usize);
    butteraugli_linear(picture(a), picture(b), &ButteraugliParams::default()).ok().map(|found| found.pnorm_3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ssplat::{Channels, Samples};

    fn noise(width: u32, height: u32, channels: Channels, most: u8) -> Pixels {
        let samples = width as usize * height as usize * channels.count();
        let samples = (0..samples).map(|i| 100 + (i * 7919 % 251 % (usize::from(most) + 1)) as u8).collect();
        Pixels::new(width, height, channels, Samples::U8(samples)).unwrap()
    }

    #[test]
    fn equal_pictures_are_perfect_and_more_noise_is_worse() {
        let smooth = noise(48, 40, Channels::Rgb, 0);
        let found = [0, 4, 40].map(|most| measure(&smooth, &noise(48, 40, Channels::Rgb, most)));
        let similarity = found.map(|f| f.ssimulacra2.unwrap());
        let distance = found.map(|f| f.butteraugli.unwrap());
        assert_eq!((similarity[0], distance[0]), (100.0, 0.0));
        assert!(similarity.is_sorted_by(|a, b| a > b) && distance.is_sorted_by(|a, b| a < b), "{found:?}");
    }

    #[test]
    fn sixteen_bits_measure_as_eight() {
        let eight = [noise(32, 32, Channels::Rgb, 60), noise(32, 32, Channels::Rgb, 9)];
        let sixteen = eight.each_ref().map(|p| {
            let Samples::U8(v) = p.samples() else { unreachable!() };
            Pixels::new(32, 32, Channels::Rgb, Samples::U16(v.iter().map(|&v| u16::from(v) * 257).collect())).unwrap()
        });
        let [a, b] = [measure(&eight[0], &eight[1]), measure(&sixteen[0], &sixteen[1])];
        assert!((a.ssimulacra2.unwrap() - b.ssimulacra2.unwrap()).abs() < 1e-3, "{a:?} {b:?}");
        assert!((a.butteraugli.unwrap() - b.butteraugli.unwrap()).abs() < 1e-3, "{a:?} {b:?}");
    }

    #[test]
    fn the_colour_of_clear_pixels_does_not_count_and_alpha_does() {
        let rgba = |color: u8, alpha: u8| {
            let samples = [color, color, color, alpha].repeat(32 * 32);
            Pixels::new(32, 32, Channels::Rgba, Samples::U8(samples)).unwrap()
        };
        let clear = measure(&rgba(10, 0), &rgba(250, 0));
        assert_eq!((clear.ssimulacra2, clear.butteraugli), (Some(100.0), Some(0.0)));
        // Seen only where the background is dark.
        let light = measure(&rgba(229, 255), &rgba(229, 0));
        assert!(light.ssimulacra2.unwrap() < 50.0 && light.butteraugli.unwrap() > 1.0, "{light:?}");
    }

    #[test]
    fn small_pictures_are_mirrored_for_ssimulacra2_only() {
        let small = noise(7, 40, Channels::Grey, 3);
        let found = measure(&small, &small);
        assert_eq!((found.ssimulacra2, found.butteraugli), (Some(100.0), None));
    }
}
