//! Finds pages whose paper has noise, as scanners and cameras make them, and removes that noise.

use super::survey::sampled_rows;
use crate::constants::exact;
use crate::error::Result;
use crate::pixel_source::PixelSource;
use crate::pixels::{Pixels, Samples};

/// Paper with noise.
#[derive(Debug, Clone, Copy)]
pub(super) struct Paper {
    /// Colour of the paper, as sample values.
    color: [u32; 4],
    /// Largest difference of noise from this colour in each channel, as sample values.
    noise: u32,
}

/// Calls `visit` with the samples of each pixel.
fn each_pixel(pixels: &Pixels, visit: impl FnMut([u32; 4])) {
    fn each<T: Copy + Into<u32>>(samples: &[T], count: usize, mut visit: impl FnMut([u32; 4])) {
        let value = |pixel: &[T], k: usize| pixel.get(k).map_or(0, |&v| v.into());
        samples.chunks_exact(count).for_each(|pixel| visit(std::array::from_fn(|k| value(pixel, k))));
    }
    match pixels.samples() {
        Samples::U8(v) => each(v, pixels.channels().count(), visit),
        Samples::U16(v) => each(v, pixels.channels().count(), visit),
    }
}

impl Paper {
    /// Returns the paper of the picture of `source` if most pixels are paper with noise, on which other colours have sharp
    /// edges, as letters do.
    ///
    /// # Errors
    /// Returns an error of `source`.
    pub(super) fn of(source: &dyn PixelSource) -> Result<Option<Paper>> {
        let (channels, unit) = (source.channels(), u32::from(source.depth().max()) / 255);
        if channels.alpha().is_some() {
            return Ok(None);
        }
        let colors = channels.count();
        let level = |pixel: &[u32; 4]| pixel[..colors].iter().sum::<u32>() / (colors as u32 * unit);
        let (mut levels, mut samples) = ([0u64; 256], vec![[0u64; 256]; colors]);
        let (mut edges, mut equal, mut all) = (0u64, 0u64, 0u64);
        for rows in sampled_rows(source, exact::PAPER_SAMPLED_PAIRS) {
            let (mut before, mut at) = (None::<[u32; 4]>, 0);
            each_pixel(&rows?, |pixel| {
                levels[level(&pixel) as usize] += 1;
                samples.iter_mut().zip(pixel).for_each(|(counts, v)| counts[(v / unit) as usize] += 1);
                if let Some(before) = before.filter(|_| at % source.size()[0] > 0) {
                    edges += u64::from(level(&before).abs_diff(level(&pixel)) >= exact::MIN_INK_EDGE);
                    equal += u64::from(before == pixel);
                }
                (before, at) = (Some(pixel), at + 1);
            });
            all += at as u64;
        }
        let paper = most_frequent(&levels);
        let within = |least: u32, most: u32| -> u64 {
            levels
                .iter()
                .zip(0u32..)
                .filter(|&(_, v)| (least..=most).contains(&v.abs_diff(paper)))
                .map(|(n, _)| n)
                .sum()
        };
        let least = |share: f64| (share * all as f64) as u64;
        let is_page = within(0, exact::CERTAIN_PAPER_NOISE) > least(exact::MIN_PAPER_SHARE)
            && within(exact::MIN_INK_CONTRAST, 255) > least(exact::MIN_INK_SHARE)
            && edges > least(exact::MIN_INK_EDGE_SHARE)
            && equal < least(exact::MAX_EQUAL_ON_PAPER);
        if !is_page {
            return Ok(None);
        }
        let color: [u32; 4] = std::array::from_fn(|k| samples.get(k).map_or(0, most_frequent));
        let deviation = samples.iter().zip(color).map(|(counts, v)| deviation(counts, v)).fold(0.0, f64::max);
        let noise = ((exact::PAPER_NOISE_DEVIATIONS * deviation).ceil() as u32).clamp(1, exact::MAX_PAPER_NOISE) * unit;
        Ok(Some(Paper { color: color.map(|v| v * unit), noise }))
    }

    /// Returns the picture with paper of one colour.
    pub(super) fn without_noise(&self, pixels: &Pixels) -> Result<Pixels> {
        fn cleaned<T: Copy + Into<u32> + TryFrom<u32>>(v: &[T], count: usize, paper: &Paper) -> Vec<T> {
            let clean = |pixel: &[T]| {
                let is_paper = pixel.iter().zip(paper.color).all(|(&v, own)| v.into().abs_diff(own) <= paper.noise);
                let new = |(&v, own): (&T, u32)| if is_paper { T::try_from(own).unwrap_or(v) } else { v };
                pixel.iter().zip(paper.color).map(new).collect::<Vec<T>>()
            };
            v.chunks_exact(count).flat_map(clean).collect()
        }
        let count = pixels.channels().count();
        let samples = match pixels.samples() {
            Samples::U8(v) => Samples::U8(cleaned(v, count, self)),
            Samples::U16(v) => Samples::U16(cleaned(v, count, self)),
        };
        Pixels::new(pixels.width(), pixels.height(), pixels.channels(), samples)
    }
}

/// Returns the level with the most counts among it and its neighbours.
fn most_frequent(counts: &[u64; 256]) -> u32 {
    let around = |v: usize| counts[v.saturating_sub(1)..(v + 2).min(256)].iter().sum::<u64>();
    (0..256).max_by_key(|&v| (around(v), counts[v])).unwrap_or(0) as u32
}

/// Returns the root of the mean squared difference of the certain noise from a level.
fn deviation(counts: &[u64; 256], level: u32) -> f64 {
    let noise = counts.iter().zip(0u32..).map(|(&n, v)| (n as f64, f64::from(v.abs_diff(level))));
    let (sum, n) = noise
        .filter(|&(_, d)| d <= f64::from(exact::CERTAIN_PAPER_NOISE))
        .fold((0.0, 0.0), |(sum, all), (n, d)| (sum + n * d * d, all + n));
    (sum / n).sqrt()
}
