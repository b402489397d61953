//! How the bytes of a file are divided between the Gaussians and the layer.
//!
//! The best number of Gaussians belongs to the picture and hardly to the asked bytes: they make its large shapes and
//! its edges, and from there on the layer is cheaper. That is some 8 kB for photographs of .4 megapixels, and more for
//! pictures that are sharp and drawn-like, on which Gaussians still gain fast. Which they are is seen when the smaller
//! base has been fitted.

use super::Layered;
use super::texture::Texture;
use crate::bitstream::splats::{Layout, PackedSplats};
use crate::encode::input::stored_scene;
use crate::encode::session::{EncodeSession, KeptBase, Outcome};
use crate::encode::whole::{Base, WholeSession};
use crate::error::Result;
use crate::fit::model::drawing::field::{Field, Output};
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::peaks;
use crate::fit::model::problem::Problem;
use crate::instant::Instant;
use crate::options::{Detail, EncodeOptions, Recipe, Tune};
use crate::round::rounded::projected;
use crate::round::size::Size;
use crate::strict_math::StrictMath;
use crate::target::Target;

/// Pixels of the pictures that the numbers below were found on; they go with powers of how much larger a picture is.
const REFERENCE_PIXELS: f64 = 393_216.0;
/// Bytes of a base that serves most photographs; `--detail SHARE` tries other ones.
const REFERENCE_BASE_BYTES: f64 = 8_200.0;
const BASE_POWER: f64 = 0.35;
/// Power of the ratio, over 50, with which it falls from 20 to 100.
const BASE_FALL: f64 = 0.37;
/// The same at effort 1, over that: a short fit makes less of its bytes than the layer.
const HASTY_BASE: f64 = 0.5;
/// Most of the bytes that such a base may take.
const MAX_BASE_SHARE: f64 = 0.7;
/// Ratio above which files have no layer, if the tune is not perceptual or the texture is unknown.
const MAX_RATIO: f64 = 120.0;
const RATIO_POWER: f64 = 0.85;
/// Fineness of pictures of so many pixels for which a layer is worth as much at such a ratio as its bytes of Gaussians:
/// at effort 1, whose short fits under a layer make less of their bytes, and from 2 on. The ratio goes with the square
/// of fineness, and with a power of the pixels. At effort 1 and 100 it tells the better one on 18 of 19 pictures of
/// CID22 and graphics; at effort 3 a layer wins .1 to 7.9 points of SSIMULACRA2 there on all of 14.
const FINE: [f64; 2] = [0.71, 0.42];
const FINE_RATIO: f64 = 100.0;
const FINE_PIXELS: f64 = 262_144.0;
const FINE_RATIO_POWER: f64 = 2.0 / 3.0;
/// Up to this ratio, drawings of [`FINE_PIXELS`] have a layer from effort 2 on: at 200, three diagrams have 4 to 6
/// points more with one.
const DRAWING_RATIO: f64 = 250.0;
/// Up to this ratio, texture does not rule out a layer.
const ALWAYS_RATIO: f64 = 80.0;
/// Minimum share of the Gaussians in a large, busy picture at a ratio of 100, where the layer is coarse.
const BUSY_SHARE: f64 = 0.5;
/// Activities at which a picture starts to count as busy, and counts in full.
const BUSY: [f64; 2] = [2.9, 4.1];
/// Logarithm of the pixels, divided by [`REFERENCE_PIXELS`], at which that share applies in full.
const BUSY_SIZE: f64 = 1.9;
/// Pixels of the largest pictures whose residual is held as a whole, in some 30 bytes a pixel; that of larger ones is
/// made a part at a time, and their Gaussians are fitted once.
const LARGEST: u64 = 1 << 26;
/// Files of fewer bytes have none.
const MIN_FILE_BYTES: u64 = 2_500;
/// A picture's sharpness is the share of the error that as many Gaussians again, set where it is largest, promise to
/// take away, for each decibel that doubling the bytes of the layer wins. Up to here a small base is best.
const MAX_SHARPNESS: f64 = 0.105;
/// The same from effort 7 on: of twelve pictures one gains .1 dB at 20 and .2 at 50, and five are fitted again for
/// nothing.
const MAX_SHARPNESS_TRIED: f64 = 0.085;
/// Power of the ratio over 20 with which that grows.
const SHARP_POWER: f64 = 0.1;
/// A base that is larger by less than this is not worth another fit.
const MIN_BASE_GROWTH: f64 = 1.5;
/// Decibels from which on a larger base has won enough for the largest one to be tried.
const MIN_GAIN: f64 = 0.22;
/// Bytes of the layer that sharpness is measured with, over those of the base: what was found at a ratio of 50 holds at
/// others.
const MEASURED_LAYER: f64 = 1.9;
/// Share of a budget of time that the Gaussians get.
pub(in crate::encode) const BASE_TIME: f64 = 0.6;
/// Share of the bytes that the Gaussians of a sharp picture get at a ratio of 20, and what each doubling of the ratio
/// adds.
const SHARP_SHARE: f64 = 0.6;
const SHARP_MORE: f64 = 0.15;
/// And at most.
const MOST_SHARP: f64 = 0.9;
/// How much larger than asked such Gaussians may come out.
const MAX_OVERSHOOT: f64 = 1.1;

impl WholeSession<'_> {
    /// A file of `size` with the Gaussians and the detail layer that share it.
    pub(in crate::encode) fn layered(&mut self, size: Size) -> Result<Outcome> {
        let options = self.input.options;
        let Size::Bytes(most) = size else { return self.gaussians_of_size(size) };
        // Header and metadata are there whatever the division is.
        let fixed = self.fixed()?;
        let Some(shared) = most.checked_sub(fixed) else { return self.gaussians_of_size(size) };
        let may_have = options.layout == Layout::Coded && options.recipe == Recipe::Ssplat;
        let rounds = self.rounds();
        let time = self.clock.left().map(|left| self.share.map_or(left, |share| share.min(left)));
        self.until = time.and_then(|time| Instant::now().checked_add(time));
        match options.detail {
            Detail::Share(share) => {
                let base = self.base(fixed + (shared as f64 * share) as u64, self.samples() / shared as f64)?;
                if self.pixels() > LARGEST {
                    return self.layered_in_parts(base, most);
                }
                let clock = self.report.seconds();
                let layered = self.layer(base, most)?;
                if layered.coded.is_none() {
                    // No room for a layer: all of it is the Gaussians'.
                    return self.gaussians_of_size(size);
                }
                let outcome = self.joined(layered, most, rounds)?;
                self.report.stage("detail", clock);
                Ok(outcome)
            }
            Detail::Auto if may_have => {
                let texture = self.texture();
                let largest = largest_ratio(options.effort, self.pixels(), texture);
                match is_worth_a_layer(self.samples(), shared, largest) {
                    true => self.divided([fixed, shared], texture, rounds),
                    false => self.gaussians_of_size(size),
                }
            }
            _ => self.gaussians_of_size(size),
        }
    }

    /// Returns the texture of the picture if the division of the bytes depends on it.
    fn texture(&self) -> Option<Texture> {
        if self.input.options.favoured() == Tune::Iq { Texture::of(&self.planes) } else { None }
    }

    /// Rounds of descent beside the layer.
    fn rounds(&self) -> u32 {
        match self.input.options.effort {
            1 => 0,
            2 | 3 => 1,
            4..=6 => match self.input.options.favoured() {
                // Each of the second and the third wins .01 dB: not worth it in every try.
                Tune::Psnr if is_search(self.input.options.target) => 1,
                Tune::Psnr => 3,
                // The second wins .1 points of SSIMULACRA2 on Kodak, and .01 at 2.8 megapixels, for .07 and .13 of the
                // time.
                Tune::Ssim | Tune::Iq => 1,
            },
            _ => 4,
        }
    }

    pub(super) fn pixels(&self) -> u64 {
        u64::from(self.planes.width) * u64::from(self.planes.height)
    }

    /// A fit of so many bytes for a layer to be laid over, in a file of such a ratio.
    fn base(&mut self, bytes: u64, ratio: f64) -> Result<Outcome> {
        let share = self.share;
        self.share = self.until.map(|end| end.saturating_duration_since(Instant::now()).mul_f64(BASE_TIME)).or(share);
        // Fits of a search are not the longest: there are several.
        self.base = Some(Base { ratio: (!is_search(self.input.options.target)).then_some(ratio) });
        let outcome = self.gaussians_of_size(Size::Bytes(bytes));
        (self.base, self.share) = (None, share);
        outcome
    }

    /// Finds the division of `shared` bytes, beside those of header and metadata, and makes the file.
    fn divided(&mut self, [fixed, shared]: [u64; 2], texture: Option<Texture>, rounds: u32) -> Result<Outcome> {
        let (most, all) = (fixed + shared, shared as f64);
        let ratio = (self.samples() / all).max(20.0);
        let least = all * texture.map_or(0.0, |texture| busy_share(texture, self.pixels(), ratio));
        let few = bytes_of_base(self.input.options.effort, self.pixels(), ratio, all).max(least);
        let most_for_base = (SHARP_SHARE + SHARP_MORE * (ratio / 20.0).strict_log2()).min(MOST_SHARP) * all;
        // What was large enough for a sharp picture can be too large for a smaller file of it.
        let room = fixed as f64 + (MAX_OVERSHOOT * most_for_base).min(MOST_SHARP * all);
        let serves = |kept: &&KeptBase| is_near(few, kept.base_budget) && kept.base.bytes.len() as f64 <= room;
        let kept = self.kept.as_ref().filter(serves).map(|kept| kept.base.clone());
        let is_new = kept.is_none();
        let base = kept.map_or_else(|| self.base(fixed + few as u64, ratio), Ok)?;
        if self.pixels() > LARGEST {
            if is_new {
                self.keep(&base, few);
            }
            return self.layered_in_parts(base, most);
        }
        let clock = self.report.seconds();
        let mut layered = self.layer(base, most)?;
        self.report.stage("detail", clock);
        // For eyes the smaller base is as good. And a budget of time is not enough for several fits.
        let is_exact = self.input.options.favoured() == Tune::Psnr;
        let may_be_larger = is_new && is_exact && self.until.is_none() && most_for_base > MIN_BASE_GROWTH * few;
        let sharpness = if may_be_larger { self.sharpness(&layered, few * MEASURED_LAYER)? } else { Some(0.0) };
        let least = if self.input.options.effort >= 7 { MAX_SHARPNESS_TRIED } else { MAX_SHARPNESS };
        if sharpness.is_none_or(|sharpness| sharpness > least * (ratio / 20.0).strict_powf(SHARP_POWER)) {
            for bytes in [(few * most_for_base).sqrt(), most_for_base] {
                self.initial = primitives_of(&layered.base.splats);
                let base = self.base(fixed + bytes as u64, ratio)?;
                let clock = self.report.seconds();
                let other = self.layer(base, most)?;
                self.report.stage("detail", clock);
                let gain = 10.0 * (layered.error / other.error).strict_log10();
                if gain > 0.0 {
                    layered = other;
                }
                if gain.is_nan() || gain < MIN_GAIN {
                    break;
                }
            }
        }
        if layered.coded.is_none() {
            return self.gaussians_of_size(Size::Bytes(most));
        }
        if is_new {
            self.keep(&layered.base, few);
        }
        let clock = self.report.seconds();
        let outcome = self.joined(layered, most, rounds)?;
        self.report.stage("detail", clock);
        Ok(outcome)
    }

    /// Keeps Gaussians for the next try, where there is one.
    fn keep(&mut self, base: &Outcome, base_budget: f64) {
        if is_search(self.input.options.target) {
            self.kept = Some(KeptBase { base: base.clone(), base_budget });
        }
    }

    /// How much more Gaussians promise, beside more bytes for the layer; `None` where there is no layer.
    fn sharpness(&self, layered: &Layered, bytes: f64) -> Result<Option<f64>> {
        let Some(coded) = &layered.coded else { return Ok(None) };
        let splats = &layered.base.splats;
        // All errors count alike here: that tells pictures apart best, whatever is favoured.
        let [finer, coarser] = self.two_steps(splats, coded, bytes);
        let decibels = 10.0 * (coarser[1] / finer[1]).strict_log10() / (finer[0] / coarser[0]).strict_log2();
        if !decibels.is_finite() {
            return Ok(None);
        }
        let estimated_gain = self.estimated_gain(splats);
        Ok(Some(estimated_gain / decibels.max(0.1)))
    }

    /// The share of the error of `splats` that as many Gaussians again are estimated to take away.
    fn estimated_gain(&self, splats: &PackedSplats) -> f64 {
        let mut plain = self.planes.weighed(Vec::new());
        plain.channel_amplitude = [1.0; 4];
        let problem = Problem { scene: stored_scene(splats), target: &plain };
        let drawn = projected(&splats.quantizer(), &splats.gaussians, splats.height);
        let mut field = Field::default();
        let error = field.draw(&problem, &drawn, RowSet::ALL, Output::Picture);
        let count = splats.gaussians.len();
        let peaks = peaks::peaks(&problem, &field, RowSet::ALL, count, count);
        peaks.iter().map(|peak| f64::from(peak.gain)).sum::<f64>() / error.max(f64::MIN_POSITIVE)
    }
}

/// Tells whether sizes are tried until a file is as good as was asked for.
pub(in crate::encode) fn is_search(target: Target) -> bool {
    match target {
        Target::Auto | Target::Ratio(_) | Target::Bytes(_) | Target::Primitives(_) => false,
        Target::Psnr(_) => true,
        #[cfg(feature = "quality")]
        Target::Quality(_) => true,
    }
}

/// Returns the Gaussians of `splats` as a fit has them.
fn primitives_of(splats: &PackedSplats) -> Vec<Primitive> {
    let quantizer = splats.quantizer();
    splats.gaussians.iter().map(|g| Primitive::from_gaussian(&quantizer.dequantize(g))).collect()
}

/// Returns the largest ratio at which a picture of so many pixels gains by a layer; `texture` is known where eyes are
/// favoured.
fn largest_ratio(effort: u8, pixels: u64, texture: Option<Texture>) -> f64 {
    let usual = MAX_RATIO * (pixels as f64 / REFERENCE_PIXELS).strict_powf(RATIO_POWER);
    let Some(texture) = texture else { return usual };
    let fine = FINE[usize::from(effort > 1)];
    let larger = (pixels as f64 / FINE_PIXELS).strict_powf(FINE_RATIO_POWER);
    let of_drawing = if effort > 1 && texture.is_drawing() { DRAWING_RATIO * larger } else { 0.0 };
    usual.min(ALWAYS_RATIO).max(FINE_RATIO * (texture.fineness / fine).powi(2) * larger).max(of_drawing)
}

/// Tells whether a picture of so many samples gains by a layer in a file of so many bytes, if it does up to a ratio of
/// `largest`.
fn is_worth_a_layer(samples: f64, bytes: u64, largest: f64) -> bool {
    bytes >= MIN_FILE_BYTES && samples / bytes as f64 <= largest
}

/// Tells whether a base of `base_budget` bytes is as good as one of `few`.
pub(in crate::encode) fn is_near(few: f64, base_budget: f64) -> bool {
    (few / base_budget).strict_ln().abs() < MIN_BASE_GROWTH.strict_ln()
}

/// Returns the bytes of the Gaussians in a file of `all` bytes.
fn bytes_of_base(effort: u8, pixels: u64, ratio: f64, all: f64) -> f64 {
    let larger = pixels as f64 / REFERENCE_PIXELS;
    let haste = if effort == 1 { HASTY_BASE } else { 1.0 };
    (haste * REFERENCE_BASE_BYTES * larger.strict_powf(BASE_POWER) * (ratio.min(100.0) / 50.0).strict_powf(-BASE_FALL))
        .min(MAX_BASE_SHARE * all)
}

/// Returns the least share of the bytes that the Gaussians of such a picture get.
fn busy_share(texture: Texture, pixels: u64, ratio: f64) -> f64 {
    let [from, to] = BUSY;
    let busy = ((texture.activity - from) / (to - from)).clamp(0.0, 1.0);
    let large = ((pixels as f64 / REFERENCE_PIXELS).strict_ln() / BUSY_SIZE).clamp(0.0, 1.0);
    BUSY_SHARE * busy * large * (ratio / 100.0).min(1.0)
}

/// Returns the bytes of the Gaussians of a picture that is fitted in tiles; `None` where it has no layer. `shared` are
/// the bytes of the file but those of header and metadata.
pub(in crate::encode) fn base_in_tiles(options: &EncodeOptions, pixels: u64, samples: f64, shared: u64) -> Option<u64> {
    let all = shared as f64;
    match options.detail {
        Detail::Share(share) => Some((all * share) as u64),
        Detail::Auto if is_worth_a_layer(samples, shared, largest_ratio(options.effort, pixels, None)) => {
            Some(bytes_of_base(options.effort, pixels, (samples / all).max(20.0), all) as u64)
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS_OF_512: u64 = 512 * 512;

    fn texture(fineness: f64, activity: f64) -> Option<Texture> {
        Some(Texture { fineness, activity, flat: 0.0 })
    }

    #[test]
    fn fine_pictures_have_a_layer_in_smaller_files_than_coarse_ones() {
        let has = |effort, texture, ratio: u64| {
            let (samples, bytes) = (3 * PIXELS_OF_512, 3 * PIXELS_OF_512 / ratio);
            is_worth_a_layer(samples as f64, bytes, largest_ratio(effort, PIXELS_OF_512, texture))
        };
        let [coarse, fine] = [0.46, 1.2].map(|fineness| texture(fineness, 4.0));
        assert_eq!([50, 100, 200].map(|ratio| has(5, coarse, ratio)), [true, true, false]);
        assert_eq!([50, 100, 200].map(|ratio| has(5, fine, ratio)), [true, true, true]);
        assert_eq!([50, 100, 200].map(|ratio| has(1, coarse, ratio)), [true, false, false]);
        assert_eq!([50, 100, 200].map(|ratio| has(1, None, ratio)), [true, false, false]);
        // Files of fewer bytes than a layer needs have none, whatever the picture.
        assert!(!has(5, texture(9.0, 4.0), 400));
        // More pixels are worth a layer at larger ratios.
        assert!(largest_ratio(5, 10 * PIXELS_OF_512, coarse) > 4.0 * largest_ratio(5, PIXELS_OF_512, coarse));
    }

    #[test]
    fn gaussians_get_more_of_large_busy_pictures_in_small_files() {
        let share = |activity, pixels, ratio| busy_share(texture(0.5, activity).unwrap(), pixels, ratio);
        let large = 7 * REFERENCE_PIXELS as u64;
        assert_eq!(share(5.0, large, 100.0), BUSY_SHARE);
        assert_eq!(share(5.0, large, 50.0), BUSY_SHARE / 2.0);
        assert_eq!([share(2.0, large, 100.0), share(5.0, REFERENCE_PIXELS as u64, 100.0)], [0.0; 2]);
        let half = share(3.5, large, 200.0);
        assert!((half - BUSY_SHARE / 2.0).abs() < 1e-9, "{half}");
    }
}
