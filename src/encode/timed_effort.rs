//! Chooses the effort of an encode that has a time budget.
//!
//! An encode that runs out of time ends its fit early. If the file has a detail layer, a lower effort, which was made
//! for less time, gives a better picture: kodim05 at a ratio of 50 in 0.2 s reaches 38 points of SSIMULACRA2 with
//! effort 1 and 26 with a fit of effort 5 that ends early. Without a layer it does not: the middle 256² pixels of
//! CID22's 4843579 at a ratio of 50 in 0.2 s reach 48, 53, 51 and 54 points with efforts 1, 2, 3 and 5.

use std::time::Duration;

use super::layer::divide::is_search;
use super::layer::division::has_layer;
use super::layer::texture::Texture;
use super::rate_control::size_asked;
use crate::gaussian::Channels;
use crate::options::EncodeOptions;
use crate::parallel;
use crate::round::size::Size;
use crate::strict_math::StrictMath;

/// Seconds that an effort takes on one thread for a photograph of one megapixel at a ratio of 50, and the power of the
/// number of pixels with which they grow. Measured on photographs of 0.4 and 2.8 megapixels, on an Intel Xeon (model
/// 167 of family 6).
const SECONDS: [(f64, f64); 9] = [
    (0.7, 1.05),
    (1.2, 1.0),
    (1.95, 0.85),
    (2.3, 0.75),
    (2.6, 0.67),
    (6.0, 0.67),
    (13.0, 0.67),
    (21.0, 0.67),
    (33.0, 0.67),
];
/// Part of the work that one thread does alone.
const SERIAL: f64 = 0.3;
/// Duration of a search for a PSNR or a quality, relative to that of one encode.
const SEARCH: f64 = 3.0;

/// Returns the highest effort, up to that of `options`, whose encode of a picture of this size is expected to take no
/// longer than the time budget; effort 1 if none is. It is that of `options` for a file without a layer. `texture`
/// measures the texture of a picture that is fitted as a whole.
pub(super) fn affordable(
    [width, height]: [u32; 2],
    channels: Channels,
    options: &EncodeOptions,
    texture: impl FnOnce() -> Option<Texture>,
) -> u8 {
    let Some(time) = options.time else { return options.effort };
    let pixels = u64::from(width) * u64::from(height);
    let samples = pixels as f64 * channels.count() as f64;
    let has_layer = match size_asked(options, samples, 0) {
        Size::Bytes(bytes) => has_layer(options, pixels, samples, bytes, texture),
        // A search tries files of many sizes.
        Size::Free => is_search(options.target),
    };
    if !has_layer {
        return options.effort;
    }
    let megapixels = pixels as f64 / 1e6;
    let threads = parallel::threads().max(1) as f64;
    let tries = if is_search(options.target) { SEARCH } else { 1.0 };
    let factor = tries * (SERIAL + (1.0 - SERIAL) / threads);
    let fits = |&effort: &u8| {
        let (seconds, power) = SECONDS[usize::from(effort) - 1];
        Duration::try_from_secs_f64(factor * seconds * megapixels.strict_powf(power)).is_ok_and(|needed| needed <= time)
    };
    (1..=options.effort).rev().find(fits).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::target::Target;

    #[test]
    fn the_effort_grows_with_the_time_up_to_the_requested_one() {
        let effort = |effort, time: Option<f64>, side| {
            affordable(
                [side; 2],
                Channels::Rgb,
                &EncodeOptions { effort, time: time.map(Duration::from_secs_f64), ..EncodeOptions::default() },
                || None,
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
    fn the_texture_decides_at_high_ratios() {
        let effort = |ratio, fineness| {
            let time = Some(Duration::from_millis(200));
            let options = EncodeOptions { target: Target::Ratio(ratio), time, ..EncodeOptions::default() };
            affordable([768, 512], Channels::Rgb, &options, || Some(Texture { fineness, activity: 4.0, flat: 0.0 }))
        };
        assert_eq!([50.0, 200.0].map(|ratio| effort(ratio, 0.9)), [1, 1]);
        // With coarse texture, the file has no layer at a ratio of 200.
        assert_eq!([50.0, 200.0].map(|ratio| effort(ratio, 0.3)), [1, 5]);
    }
}
