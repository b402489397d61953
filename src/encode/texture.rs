//! Measures the texture of a picture. The result determines, before any fit, how the bytes of a file are divided
//! between the Gaussians and the layer.

use crate::constants::allocation;
use crate::fit::model::objective::planes::Planes;
use crate::parallel;
use crate::strict_math::StrictMath;

/// Side of the measured squares, pixels.
const SQUARE: usize = 8;

/// Fineness and strength of the texture of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Texture {
    /// Variance of luma that is lost at half the resolution, divided by the further loss at a quarter. It is large if
    /// the finest detail is strong. Gaussians represent such detail poorly, a layer represents it well. It is infinite if
    /// nothing is left at half the resolution.
    pub fineness: f64,
    /// Mean logarithm of the luma variance (in code values²) within squares of 8×8 pixels.
    pub activity: f64,
    /// Share of the squares that have one colour.
    pub flat: f64,
}

impl Texture {
    /// Measures the texture of `pixels`. Returns `None` if there are no whole squares, or if they are constant.
    pub fn of_pixels(pixels: &crate::pixels::Pixels) -> Option<Texture> {
        Texture::of(&Planes::new(pixels))
    }

    /// Measures the whole squares of a picture. Returns `None` if there are none, or if they are constant.
    pub(super) fn of(planes: &Planes) -> Option<Texture> {
        let [across, down] = [planes.width, planes.height].map(|side| side as usize / SQUARE);
        let strips = parallel::map(down, |strip| {
            let mut sums = [0f64; 4];
            let rows: [Vec<f32>; SQUARE] = std::array::from_fn(|y| luma(planes, strip * SQUARE + y));
            for x in 0..across {
                let square = |u: usize, v: usize| rows[v][x * SQUARE + u];
                sums.iter_mut().zip(measured(square)).for_each(|(sum, more)| *sum += more);
            }
            sums
        });
        let sums = strips.iter().fold([0.0; 4], |sums, strip| [0, 1, 2, 3].map(|i| sums[i] + strip[i]));
        let count = (across * down) as f64;
        let [fine, coarse, activity, flat] = sums.map(|sum| sum / count);
        (fine + coarse > 0.0).then(|| Texture { fineness: fine / coarse, activity, flat })
    }

    /// Returns whether the picture contains both flat regions and much detail, like a page of text with photographs or
    /// a screenshot. Its texture does not tell how many Gaussians it needs.
    pub(super) fn is_mixed(self) -> bool {
        self.flat > allocation::MIXED_FLAT_SHARE && self.activity > allocation::BUSY_ACTIVITY
    }

    /// Returns whether the picture is a regular texture.
    pub(super) fn is_regular(self) -> bool {
        self.fineness >= allocation::REGULAR_FINENESS
    }

    /// Returns whether the picture is a diagram, a page or a screenshot rather than a photograph.
    pub(super) fn is_drawing(&self) -> bool {
        self.flat > allocation::DRAWING_FLAT_SHARE
    }
}

/// Returns the luma of a row, in code values.
fn luma(planes: &Planes, y: usize) -> Vec<f32> {
    let row = planes.row(y as u32);
    let value = |k: usize, x: usize| 255.0 * row[k * planes.stride + x];
    let has_color = planes.channels.count() >= 3;
    let at = |x: usize| match has_color {
        true => luma_and_chroma([0, 1, 2].map(|k| value(k, x)))[0],
        false => value(0, x),
    };
    (0..planes.width as usize).map(at).collect()
}

/// Returns four measures of a square: the variance per pixel that it loses at half the resolution, the further loss at
/// a quarter, the logarithm of its variance, and 1 if it has one colour or else 0.
fn measured(square: impl Fn(usize, usize) -> f32) -> [f64; 4] {
    let first = square(0, 0);
    let mut sums = [0f32; 2];
    let mut squares = 0f32;
    let mut halves = [0f32; SQUARE * SQUARE / 4];
    for v in 0..SQUARE {
        for u in 0..SQUARE {
            // The values are relative to the first one, so that the variance of a one-colour square is exactly 0.
            let value = square(u, v) - first;
            sums[0] += value;
            squares += value * value;
            halves[v / 2 * SQUARE / 2 + u / 2] += 0.25 * value;
        }
    }
    let mut quarters = [0f32; SQUARE * SQUARE / 16];
    for (i, half) in halves.iter().enumerate() {
        sums[1] += half * half;
        let [u, v] = [i % (SQUARE / 2), i / (SQUARE / 2)];
        quarters[v / 2 * SQUARE / 4 + u / 2] += 0.25 * half;
    }
    let pixels = (SQUARE * SQUARE) as f32;
    let [whole, half] = [squares / pixels, sums[1] * 4.0 / pixels];
    let quarter = quarters.iter().map(|q| q * q).sum::<f32>() * 16.0 / pixels;
    let mean = sums[0] / pixels;
    let lost = |from: f32, to: f32| f64::from((from - to).max(0.0));
    let variance = lost(whole, mean * mean);
    let flat = f64::from(u8::from(variance < allocation::MAX_FLAT_VARIANCE));
    [lost(whole, half), lost(half, quarter), (variance + allocation::TEXTURE_VARIANCE_FLOOR).strict_ln(), flat]
}

/// Converts red, green and blue to luma, orange chroma and green chroma. The additions of spec §11.5 apply the inverse.
pub(super) fn luma_and_chroma([r, g, b]: [f32; 3]) -> [f32; 3] {
    [0.25 * (r + 2.0 * g + b), r - b, g - 0.5 * (r + b)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussian::Channels;
    use crate::pixels::{Pixels, Samples};

    fn texture(value: impl Fn(u32, u32) -> u8) -> Option<Texture> {
        let values = (0..64 * 48).map(|i| value(i % 64, i / 64)).collect();
        Texture::of(&Planes::new(&Pixels::new(64, 48, Channels::Grey, Samples::U8(values)).unwrap()))
    }

    #[test]
    fn only_single_pixel_detail_is_fine() {
        let check = |side: u32| move |x: u32, y: u32| if (x / side + y / side).is_multiple_of(2) { 90 } else { 110 };
        assert_eq!(texture(|_, _| 7), None, "nothing in it");
        let regular = texture(check(1)).unwrap();
        assert!(regular.fineness == f64::INFINITY && regular.is_regular(), "nothing is left at half the size");
        let noise = |x: u32, y: u32| ((x * 7919 + y * 104_729).wrapping_mul(2_654_435_761) >> 24) as u8;
        let fine = texture(noise).unwrap();
        let coarse = texture(|x, y| noise(x / 2, y / 2)).unwrap();
        let mixed = texture(|x, y| noise(x, y) / 4 + noise(x / 2, y / 2) / 4 * 3).unwrap();
        assert!(
            coarse.fineness < 0.01 && mixed.fineness > 0.05 && fine.fineness > 1.0,
            "{coarse:?} {mixed:?} {fine:?}"
        );
        assert!(![coarse, mixed, fine].into_iter().any(Texture::is_regular), "{fine:?}");
        let framed = texture(|x, y| if x < 32 { 255 } else { noise(x / 2, y / 2) }).unwrap();
        assert!(framed.flat == 0.5 && framed.is_drawing() && !mixed.is_drawing(), "{framed:?} {mixed:?}");
        // A page of text is mixed; a simple diagram and a photograph are not.
        let line = texture(|x, _| if x == 32 { 0 } else { 255 }).unwrap();
        assert_eq!([framed, line, mixed].map(Texture::is_mixed), [true, false, false]);
        // A checkerboard of 2×2-pixel squares has a variance of 100.
        let even = texture(|x, y| check(2)(x, y) + (x + y * 3) as u8 % 2).unwrap();
        assert!((even.activity - 104f64.ln()).abs() < 0.02, "{even:?}");
    }
}
