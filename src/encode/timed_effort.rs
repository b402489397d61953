//! Chooses the effort of an encode that has a time budget.
//!
//! An encode that runs out of time ends its fit early. If the file has a detail layer, a lower effort, which was made
//! for less time, gives a better picture: kodim05 at a ratio of 50 in 0.2 s reaches 38 points of SSIMULACRA2 with
//! effort 2 and 26 with a fit of effort 5 that ends early. Without a layer it does not: the middle 256² pixels of
//! CID22's 4843579 at a ratio of 50 in 0.2 s reach 48, 51 and 54 points with efforts 2, 3 and 5.
//!
//! On kodim05, 13, 15 and 23 with `--ratio 50 --time 1`, on two busy cores, the choice gains 8.6 points over effort 5,
//! and the encode ends after 1.9 instead of 4.5 s. With `--time 0.3` it gains 2.9 points.

use std::time::Duration;

use super::allocation::{has_layer, is_search};
use super::rate_control::picture_size;
use super::texture::Texture;
use crate::constants::encode;
use crate::effort::{Duration as Expected, EffortSettings};
use crate::gaussian::Channels;
use crate::options::EncodeOptions;
use crate::parallel;
use crate::rdo::size::Size;
use crate::strict_math::StrictMath;
use crate::target::Target;

/// Returns the highest effort, up to that of `options`, whose encode of a picture of this size is expected to take no
/// longer than the time budget; effort 1 if none is. It is that of `options` for a file without a layer. `texture`
/// measures the texture of a picture that is fitted as a whole, and `slowness` how many times longer this machine takes
/// than that of the measurements.
pub(super) fn affordable(
    [width, height]: [u32; 2],
    channels: Channels,
    options: &EncodeOptions,
    texture: impl FnOnce() -> Option<Texture>,
    slowness: impl FnOnce() -> f64,
) -> u8 {
    let Some(time) = options.time else { return options.effort };
    let pixels = u64::from(width) * u64::from(height);
    let samples = pixels as f64 * channels.count() as f64;
    let (has_layer, ratio) = match picture_size(options, samples, 0) {
        Size::Bytes(bytes) => (has_layer(options, pixels, samples, bytes, texture), samples / bytes.max(1) as f64),
        // A search tries files of many sizes.
        Size::Free => (is_search(options.target), encode::MEASURED_RATIO),
    };
    if !has_layer {
        return options.effort;
    }
    let megapixels = pixels as f64 / 1e6;
    let threads = parallel::threads().max(1) as f64;
    let tries = match options.target {
        Target::Psnr(_) => encode::PSNR_SEARCH_TIME,
        target if is_search(target) => encode::QUALITY_SEARCH_TIME,
        _ => 1.0,
    };
    let more_bytes = (encode::MEASURED_RATIO / ratio).max(1.0).strict_powf(encode::TIME_BYTES_EXPONENT);
    let factor = slowness() * more_bytes * tries * (encode::SERIAL_SHARE + (1.0 - encode::SERIAL_SHARE) / threads);
    let fits = |&effort: &u8| {
        let Expected { seconds, power } = EffortSettings::from_preset(effort).duration;
        let seconds = seconds
            * megapixels.min(encode::LINEAR_TIME_MEGAPIXELS).strict_powf(power)
            * (megapixels / encode::LINEAR_TIME_MEGAPIXELS).max(1.0);
        Duration::try_from_secs_f64(factor * seconds).is_ok_and(|needed| needed <= time)
    };
    (1..=options.effort).rev().find(fits).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_effort_grows_with_the_time_up_to_the_requested_one() {
        let effort = |effort, time: Option<f64>, side| {
            affordable(
                [side; 2],
                Channels::Rgb,
                &EncodeOptions { effort, time: time.map(Duration::from_secs_f64), ..EncodeOptions::default() },
                || None,
                || 1.0,
            )
        };
        let mut last = 1;
        for step in 0..60 {
            let now = effort(9, Some(0.1 * 1.15f64.powi(step)), 600);
            assert!(now >= last);
            last = now;
        }
        assert_eq!(last, 9);
        assert_eq!(effort(5, Some(1e6), 600), 5);
        assert_eq!(effort(5, Some(0.0), 600), 1);
        assert_eq!(effort(5, Some(0.4), 4000), 1);
        assert_eq!(effort(9, Some(u64::MAX as f64 / 2.0), 1 << 20), 9);
        assert_eq!(effort(7, None, 4000), 7);
        // A picture of this size has no layer.
        assert_eq!(effort(7, Some(0.0), 100), 7);
    }

    #[test]
    fn the_effort_falls_on_a_slow_machine() {
        let options = EncodeOptions { time: Some(Duration::from_secs(60)), ..EncodeOptions::default() };
        let effort = |slowness| affordable([2000; 2], Channels::Rgb, &options, || None, || slowness);
        assert_eq!([1.0, 1e6].map(effort), [5, 1]);
    }

    #[test]
    fn the_texture_decides_at_high_ratios() {
        let effort = |ratio, fineness| {
            let time = Some(Duration::from_millis(50));
            let options = EncodeOptions { target: Target::Ratio(ratio), time, ..EncodeOptions::default() };
            let texture = Texture { fineness, activity: 4.0, flat: 0.0 };
            affordable([768, 512], Channels::Rgb, &options, || Some(texture), || 1.0)
        };
        assert_eq!([50.0, 200.0].map(|ratio| effort(ratio, 0.9)), [1, 1]);
        // With coarse texture, the file has no layer at a ratio of 200.
        assert_eq!([50.0, 200.0].map(|ratio| effort(ratio, 0.3)), [1, 5]);
    }
}
