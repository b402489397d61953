//! `--max-side`: downscales pictures in linear light, from any source of samples, in bands of rows.

use std::ops::Range;

use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::{F32, F32x2, F32x3, F32x4};
use fast_image_resize::{FilterType, PixelTrait, ResizeAlg, ResizeOptions, Resizer};
use moxcms::{ColorProfile, ToneReprCurve};
use rayon::prelude::*;
use ssplat::{Depth, Error, HiddenColors, PixelSource, Pixels, Rect, Samples};

use crate::guard;
use crate::limits::MAX_SIDE;

/// The filter, and its radius in pixels of the output.
const FILTER: FilterType = FilterType::Lanczos3;
const SUPPORT: f64 = 3.0;

/// If the scale factor is larger, blocks of pixels are averaged first until this factor remains. That takes little
/// memory, and makes no visible difference.
const FILTERED_FACTOR: f64 = 4.0;

/// Approximate number of samples of a band before filtering: 16 MiB as floats.
const BAND_SAMPLES: f64 = (4 << 20) as f64;

/// Longest profile that is parsed, in bytes; longer ones contain tables instead of curves.
const LONGEST_PROFILE: usize = 4 << 20;

/// Returns `size`, reduced with the same aspect ratio so that no side is above `max_side`.
pub fn fitted(size: [u32; 2], max_side: Option<u32>) -> [u32; 2] {
    let longest = size[0].max(size[1]);
    match max_side {
        Some(most) if longest > most => {
            size.map(|side| (f64::from(side) * f64::from(most) / f64::from(longest)).round().max(1.0) as u32)
        }
        _ => size,
    }
}

/// Downscales `source` to `size`. Colours are filtered in linear light, by the curves of the profile `icc` or those of
/// sRGB, and weighted by alpha unless hidden colours are kept. Rounding may differ between processors with different
/// vector instructions.
///
/// # Errors
/// Those of `source`.
pub fn resize(
    source: &dyn PixelSource,
    size: [u32; 2],
    icc: Option<&[u8]>,
    hidden: HiddenColors,
) -> Result<Pixels, Error> {
    let job = Resize::new(source, size, icc, hidden);
    let [width, height] = size;
    let bands: Vec<Range<u32>> = (0..height).step_by(job.rows as usize).map(|y| y..height.min(y + job.rows)).collect();
    let bands: Vec<Samples> = bands.into_par_iter().map(|rows| job.band(rows)).collect::<Result<_, _>>()?;
    let mut all = match source.depth() {
        Depth::Eight => Samples::U8(Vec::new()),
        Depth::Sixteen => Samples::U16(Vec::new()),
    };
    for band in bands {
        match (&mut all, band) {
            (Samples::U8(all), Samples::U8(band)) => all.extend(band),
            (Samples::U16(all), Samples::U16(band)) => all.extend(band),
            _ => unreachable!("all bands have the depth of the source"),
        }
    }
    Pixels::new(width, height, source.channels(), all)
}

struct Resize<'a> {
    source: &'a dyn PixelSource,
    size: [u32; 2],
    /// Width and height of the blocks of pixels that are averaged first.
    block: [u32; 2],
    /// Blocks per pixel of the output, in x and y.
    factor: [f64; 2],
    /// Number of rows of a band of the output.
    rows: u32,
    curves: Vec<Curve>,
    hidden: HiddenColors,
}

impl<'a> Resize<'a> {
    fn new(source: &'a dyn PixelSource, size: [u32; 2], icc: Option<&[u8]>, hidden: HiddenColors) -> Self {
        let ratio = [0, 1].map(|k| f64::from(source.size()[k]) / f64::from(size[k]));
        let block = ratio.map(|ratio| (ratio / FILTERED_FACTOR).floor().max(1.0) as u32);
        let factor = [0, 1].map(|k| ratio[k] / f64::from(block[k]));
        let of_row = f64::from(source.width()) / f64::from(block[0]) * source.channels().count() as f64 * factor[1];
        let rows = (BAND_SAMPLES / of_row - 2.0 * SUPPORT).clamp(1.0, f64::from(size[1])) as u32;
        let colors = source.channels().count() - usize::from(source.channels().alpha().is_some());
        let curves = curves(icc, colors, source.depth());
        Resize { source, size, block, factor, rows, curves, hidden }
    }

    /// Returns the rows `rows` of the output.
    fn band(&self, rows: Range<u32>) -> Result<Samples, Error> {
        let channels = self.source.channels();
        let blocks = [0, 1].map(|k| self.source.size()[k].div_ceil(self.block[k]));
        // Includes the rows within the radius of the filter, and one more for rounding.
        let margin = SUPPORT.ceil() as u32 + 1;
        let [first, last] = [rows.start.saturating_sub(margin), (rows.end + margin).min(self.size[1])];
        let exact = [first, last].map(|y| f64::from(y) * self.factor[1]);
        let [top, bottom] = [exact[0].floor() as u32, (exact[1].ceil() as u32).min(blocks[1])];
        let means = self.means(top..bottom, blocks[0])?;
        let mut out = vec![0f32; (self.size[0] * (last - first)) as usize * channels.count()];
        let width = f64::from(self.size[0]) * self.factor[0];
        let options = ResizeOptions::new()
            .resize_alg(ResizeAlg::Convolution(FILTER))
            .crop(0.0, exact[0] - f64::from(top), width, (exact[1] - exact[0]).min(f64::from(bottom) - exact[0]))
            .use_alpha(false);
        let (from, to) = ([blocks[0], bottom - top], [self.size[0], last - first]);
        match channels.count() {
            1 => filter::<F32>(&means, from, &mut out, to, &options),
            2 => filter::<F32x2>(&means, from, &mut out, to, &options),
            3 => filter::<F32x3>(&means, from, &mut out, to, &options),
            _ => filter::<F32x4>(&means, from, &mut out, to, &options),
        }
        let row = self.size[0] as usize * channels.count();
        let kept = &out[(rows.start - first) as usize * row..(rows.end - first) as usize * row];
        Ok(match self.source.depth() {
            Depth::Eight => Samples::U8(self.codes(kept).into_iter().map(|code| code as u8).collect()),
            Depth::Sixteen => Samples::U16(self.codes(kept)),
        })
    }

    /// Returns the averages of rows of blocks, in linear light and premultiplied by alpha.
    fn means(&self, rows: Range<u32>, blocks: u32) -> Result<Vec<f32>, Error> {
        let [width, height] = self.source.size();
        let row = blocks as usize * self.source.channels().count();
        let mut means = vec![0f32; row * rows.len()];
        for (y, means) in rows.zip(means.chunks_exact_mut(row)) {
            let top = y * self.block[1];
            let tall = self.block[1].min(height - top);
            // A part has no more columns than a picture may have, in whole blocks.
            let blocks_of_part = (MAX_SIDE / self.block[0]).max(1);
            let count = self.source.channels().count();
            for (k, means) in means.chunks_mut(blocks_of_part as usize * count).enumerate() {
                let left = k as u32 * blocks_of_part * self.block[0];
                let wide = (blocks_of_part * self.block[0]).min(width - left);
                let part = self.source.part(Rect::new(left, top, wide, tall))?;
                match part.samples() {
                    Samples::U8(samples) => self.add(samples, wide, means),
                    Samples::U16(samples) => self.add(samples, wide, means),
                }
            }
            for (x, mean) in means.chunks_exact_mut(count).enumerate() {
                let wide = self.block[0].min(width - x as u32 * self.block[0]);
                let share = 1.0 / (f64::from(wide) * f64::from(tall)) as f32;
                mean.iter_mut().for_each(|v| *v *= share);
            }
        }
        Ok(means)
    }

    /// Adds the samples of a row of blocks, `width` pixels wide, to the sums of the blocks.
    fn add<T: Copy + Into<usize>>(&self, samples: &[T], width: u32, sums: &mut [f32]) {
        let channels = self.source.channels();
        let (count, colors) = (channels.count(), self.curves.len());
        let max = f32::from(self.source.depth().max());
        for line in samples.chunks_exact(width as usize * count) {
            let blocks = line.chunks(self.block[0] as usize * count).zip(sums.chunks_exact_mut(count));
            for (pixels, sum) in blocks {
                for pixel in pixels.chunks_exact(count) {
                    let opacity = channels.alpha().map_or(1.0, |k| {
                        let alpha: usize = pixel[k].into();
                        sum[k] += alpha as f32 / max;
                        if self.hidden == HiddenColors::Keep { 1.0 } else { alpha as f32 / max }
                    });
                    for (k, curve) in self.curves.iter().enumerate().take(colors) {
                        sum[k] += curve.light[pixel[k].into()] * opacity;
                    }
                }
            }
        }
    }

    /// Converts filtered samples to code values.
    fn codes(&self, means: &[f32]) -> Vec<u16> {
        let channels = self.source.channels();
        let max = f32::from(self.source.depth().max());
        let mut codes = Vec::with_capacity(means.len());
        for mean in means.chunks_exact(channels.count()) {
            let alpha = channels.alpha().map(|k| (mean[k].clamp(0.0, 1.0), (mean[k].clamp(0.0, 1.0) * max).round()));
            let opacity = match alpha {
                Some((opacity, _)) if self.hidden != HiddenColors::Keep => opacity,
                _ => 1.0,
            };
            // Pixels whose alpha rounds to 0 have no colour.
            let is_hidden = alpha.is_some_and(|(_, code)| code == 0.0) && self.hidden != HiddenColors::Keep;
            for (curve, light) in self.curves.iter().zip(mean) {
                codes.push(if is_hidden { 0 } else { curve.code(light / opacity) });
            }
            codes.extend(alpha.map(|(_, code)| code as u16));
        }
        codes
    }
}

/// Filters an image of pixels `P` and of size `from` to size `to`. Images whose type is known at compile time keep the
/// code for others out of the program.
fn filter<P: PixelTrait>(image: &[f32], from: [u32; 2], out: &mut [f32], to: [u32; 2], options: &ResizeOptions) {
    let image = TypedImageRef::<P>::from_buffer(from[0], from[1], bytemuck::cast_slice(image));
    let image = image.expect("a sample for each channel of each block");
    let out = TypedImage::<P>::from_buffer(to[0], to[1], bytemuck::cast_slice_mut(out));
    let mut out = out.expect("a sample for each channel of each pixel");
    Resizer::new().resize_typed(&image, &mut out, options).expect("the crop is within the image");
}

/// The linear light of each code value, from 0 to 1, in ascending order.
struct Curve {
    light: Vec<f32>,
}

impl Curve {
    fn new(curve: &ToneReprCurve, depth: Depth) -> Option<Curve> {
        let evaluator = curve.make_linear_evaluator().ok()?;
        let max = depth.max();
        let light: Vec<f32> =
            (0..=max).map(|code| evaluator.evaluate_value(f32::from(code) / f32::from(max))).collect();
        let is_sound = light.iter().all(|v| v.is_finite()) && light.is_sorted() && light.first() < light.last();
        is_sound.then_some(Curve { light })
    }

    /// Returns the code value with the nearest linear light.
    fn code(&self, light: f32) -> u16 {
        let above = self.light.partition_point(|&v| v < light).min(self.light.len() - 1);
        let below = above.saturating_sub(1);
        let nearest = if light - self.light[below] < self.light[above] - light { below } else { above };
        nearest as u16
    }
}

/// Returns the curves of a profile for `colors` channels, or those of sRGB if it has none.
fn curves(icc: Option<&[u8]>, colors: usize, depth: Depth) -> Vec<Curve> {
    let stated = || {
        let profile = ColorProfile::new_from_slice(icc.filter(|icc| icc.len() <= LONGEST_PROFILE)?).ok()?;
        let curves = match colors {
            1 => vec![profile.gray_trc?],
            _ => vec![profile.red_trc?, profile.green_trc?, profile.blue_trc?],
        };
        curves.iter().map(|curve| Curve::new(curve, depth)).collect::<Option<Vec<Curve>>>()
    };
    guard::quietly(stated).ok().flatten().unwrap_or_else(|| {
        let srgb = ColorProfile::new_srgb().red_trc.expect("sRGB has a curve");
        (0..colors).map(|_| Curve::new(&srgb, depth).expect("its curve rises")).collect()
    })
}

#[cfg(test)]
mod tests {
    use ssplat::Channels;

    use super::*;

    fn grey(width: u32, height: u32, value: impl Fn(u32, u32) -> u8) -> Pixels {
        let samples = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| value(x, y)).collect();
        Pixels::new(width, height, Channels::Grey, Samples::U8(samples)).unwrap()
    }

    fn bytes(pixels: &Pixels) -> &[u8] {
        let Samples::U8(samples) = pixels.samples() else { panic!("8 bits") };
        samples
    }

    fn smaller(pixels: &Pixels, max_side: u32) -> Pixels {
        let size = fitted(pixels.size(), Some(max_side));
        resize(pixels, size, None, HiddenColors::Continue).unwrap()
    }

    #[test]
    fn only_longer_sides_are_fitted_and_the_aspect_ratio_is_kept() {
        assert_eq!(fitted([4000, 3000], Some(1000)), [1000, 750]);
        assert_eq!(fitted([3000, 4000], Some(1000)), [750, 1000]);
        assert_eq!(fitted([1000, 20], Some(1000)), [1000, 20]);
        assert_eq!(fitted([1 << 20, 1], Some(10)), [10, 1]);
        assert_eq!(fitted([5, 5], None), [5, 5]);
    }

    #[test]
    fn light_is_averaged_and_not_code_values() {
        // Half of the light of white is 188 in sRGB; the mean of the code values would be 128.
        let stripes = grey(256, 256, |x, _| if x % 2 == 0 { 0 } else { 255 });
        for side in [64, 20, 5] {
            let small = smaller(&stripes, side);
            // At the border, the filter covers unequal numbers of black and white stripes.
            let row = &bytes(&small)[1..side as usize - 1];
            assert!(row.iter().all(|&v| v.abs_diff(188) <= 2), "{side}: {row:?}");
        }
    }

    #[test]
    fn every_flat_grey_stays_as_it_is_at_either_depth() {
        for value in 0..=255 {
            let small = smaller(&grey(40, 30, |_, _| value), 7);
            assert!(bytes(&small).iter().all(|&v| v == value), "{value}");
        }
        for value in [0, 1, 2, 255, 1000, 30_000, 65_534, 65_535] {
            let flat = Pixels::new(40, 30, Channels::Grey, Samples::U16(vec![value; 1200])).unwrap();
            let small = smaller(&flat, 7);
            let Samples::U16(samples) = small.samples() else { panic!("16 bits") };
            // Weights of floats sum up to one within 1e-6.
            assert!(samples.iter().all(|&v| v.abs_diff(value) <= 1), "{value}: {:?}", &samples[..3]);
        }
    }

    #[test]
    fn a_profile_without_gamma_is_averaged_by_its_code_values() {
        let stripes = grey(64, 64, |x, _| if x % 2 == 0 { 0 } else { 255 });
        let mut linear = ColorProfile::new_gray_with_gamma(1.0);
        linear.white_point = ColorProfile::new_srgb().white_point;
        let icc = linear.encode().unwrap();
        let small = resize(&stripes, [8, 8], Some(&icc), HiddenColors::Continue).unwrap();
        assert!(bytes(&small)[1..7].iter().all(|&v| v.abs_diff(128) <= 2), "{:?}", &bytes(&small)[..5]);
    }

    #[test]
    fn hidden_colours_do_not_bleed() {
        // Opaque red beside transparent green.
        let samples = (0..64 * 64).flat_map(|i| if i % 64 < 31 { [255, 0, 0, 255] } else { [0, 255, 0, 0] }).collect();
        let pixels = Pixels::new(64, 64, Channels::Rgba, Samples::U8(samples)).unwrap();
        for side in [16, 3] {
            let small = smaller(&pixels, side);
            for pixel in bytes(&small).chunks_exact(4) {
                assert!(pixel[1] == 0 && (pixel[3] < 8 || pixel[0] >= 254), "{side}: {pixel:?}");
            }
        }
        let kept = resize(&pixels, [16, 16], None, HiddenColors::Keep).unwrap();
        assert_eq!(bytes(&kept)[15 * 4..16 * 4], [0, 255, 0, 0]);
    }

    #[test]
    fn bands_and_blocks_make_no_difference() {
        let value = |x: u32, y: u32| ((x * 7 + y * 13) % 97 + (x / 9 + y / 5) % 60) as u8 + 40;
        let pixels = grey(301, 517, value);
        let size = fitted(pixels.size(), Some(100));
        let mut job = Resize::new(&pixels, size, None, HiddenColors::Continue);
        let whole = job.band(0..size[1]).unwrap();
        job.rows = 9;
        for first in (0..size[1]).step_by(9) {
            let rows = first..size[1].min(first + 9);
            let (Samples::U8(band), Samples::U8(whole)) = (job.band(rows.clone()).unwrap(), &whole) else { panic!() };
            let [start, end] = [rows.start, rows.end].map(|y| (y * size[0]) as usize);
            let most = band.iter().zip(&whole[start..end]).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(most <= Some(1), "rows {rows:?}: {most:?}");
        }
        // Averaging blocks first gives the same as the filter alone.
        let smooth =
            grey(640, 400, |x, y| (128.0 + 60.0 * (f64::from(x) / 60.0).sin() * (f64::from(y) / 45.0).cos()) as u8);
        let [with, without] = [[2, 2], [1, 1]].map(|block| {
            let mut job = Resize::new(&smooth, [64, 40], None, HiddenColors::Continue);
            assert_eq!(job.block, [2, 2]);
            job.factor = [0, 1].map(|k| job.factor[k] * f64::from(job.block[k]) / f64::from(block[k]));
            job.block = block;
            let Samples::U8(band) = job.band(0..40).unwrap() else { panic!() };
            band
        });
        let most = with.iter().zip(&without).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(most <= Some(1), "{most:?}");
    }
}
