//! Reads a picture into the tiles of an exact layer (spec §12), and makes files of such layers.

use std::sync::Arc;

use crate::bitstream::exact::{ExactTile, tile_area, tile_counts};
use crate::bitstream::splats::{Metadata, PackedSplats};
use crate::bitstream::{ExactLayer, to_bytes};
use crate::constants::exact;
use crate::encode::hidden::hides_colors;
use crate::encode::input;
use crate::encode::render::check_opens;
use crate::encode::report::ReportBuilder;
use crate::encode::skipped::SkipReason;
use crate::encode::steps::encode_whole;
use crate::encode::thumbnail;
use crate::error::Result;
use crate::gaussian::{Blend, Channels};
use crate::options::{EncodeOptions, HiddenColors};
use crate::pixel_source::PixelSource;
use crate::pixels::{Depth, Pixels, Samples};
use crate::rect::Rect;
use crate::strict_math::StrictMath;

/// A picture as the tiles of an exact layer.
pub(super) struct Survey {
    pub size: [u32; 2],
    pub channels: Channels,
    pub depth: Depth,
    /// The layer that stores the picture without loss.
    pub layer: ExactLayer,
    /// Mean sample of each channel.
    mean: [f64; 4],
    /// Whether all pixels are equal.
    pub is_constant: bool,
}

impl Survey {
    /// Reads the picture of `source`.
    ///
    /// # Errors
    /// [`Error::Cancelled`](crate::Error::Cancelled) if the caller cancels, and the errors of `source`.
    pub(super) fn of(
        source: &dyn PixelSource,
        options: &EncodeOptions,
        report: &mut ReportBuilder<'_>,
    ) -> Result<Survey> {
        let size = source.size();
        let tiles = tile_counts(size, exact::TILE_SIDES[0]);
        let mut parts = Vec::new();
        let (mut equal, mut pixels, mut sums, mut has_hidden) = (0, 0u64, [0; 4], false);
        for i in 0..tiles[0] * tiles[1] {
            report.stage_progress("survey", i as f32 / (tiles[0] * tiles[1]) as f32)?;
            let [x, y, width, height] = tile_area(size, exact::TILE_SIDES[0], i).map(|v| v as u32);
            let part = source.part(Rect::new(x, y, width, height))?;
            let part = if options.hidden == HiddenColors::Keep { part } else { without_hidden(part)? };
            has_hidden |= options.hidden != HiddenColors::Keep && hides_colors(&part);
            equal += equal_pixels(&part);
            pixels += u64::from(width) * u64::from(height);
            add_samples(&part, &mut sums);
            parts.push(part);
        }
        if has_hidden {
            report.note(SkipReason::HiddenColors, 0, 0.0);
        }
        let first = parts[0].part(Rect::new(0, 0, 1, 1))?;
        let side = exact::TILE_SIDES[usize::from(2 * equal < pixels)];
        let count = tile_counts(size, side);
        let tile = |i: usize| {
            let [x, y, width, height] = tile_area(size, side, i);
            let part = &parts[(y >> exact::TILE_SIDES[0]) * tiles[0] + (x >> exact::TILE_SIDES[0])];
            let corner = [x, y].map(|v| (v % (1 << exact::TILE_SIDES[0])) as u32);
            let samples = match side == exact::TILE_SIDES[0] {
                true => part.samples().clone(),
                false => part.part(Rect::new(corner[0], corner[1], width as u32, height as u32))?.into_samples(),
            };
            Ok(Some(ExactTile { samples, cells: None }))
        };
        let layer = ExactLayer { side, tiles: (0..count[0] * count[1]).map(tile).collect::<Result<_>>()? };
        Ok(Survey {
            size,
            channels: source.channels(),
            depth: source.depth(),
            layer,
            mean: sums.map(|sum| sum as f64 / pixels as f64),
            is_constant: equal + parts.len() as u64 == pixels && parts.iter().all(|part| starts_like(part, &first)),
        })
    }

    /// Returns the file of the layer that stores the picture without loss.
    pub(super) fn into_file(mut self, options: &EncodeOptions) -> PackedSplats {
        let layer = std::mem::replace(&mut self.layer, ExactLayer { side: exact::TILE_SIDES[0], tiles: Vec::new() });
        self.file(layer, options)
    }

    /// Returns a file of this layer alone, without metadata.
    pub(super) fn file(&self, layer: ExactLayer, options: &EncodeOptions) -> PackedSplats {
        let mut splats = input::empty(self.size, (self.channels, self.depth), Blend::Normalized, options);
        splats.background = background(&splats, self.mean);
        splats.exact = Some(Arc::new(layer));
        splats
    }
}

/// Returns up to `pairs` pairs of rows, from the first ones of a picture to the last ones.
pub(super) fn sampled_rows(source: &dyn PixelSource, pairs: u32) -> impl Iterator<Item = Result<Pixels>> {
    let [width, height] = source.size();
    let pairs = pairs.min(height / 2);
    (0..pairs).map(move |i| {
        let y = (u64::from(height - 2) * u64::from(i) / u64::from(pairs.max(2) - 1)) as u32;
        source.part(Rect::new(0, y.min(height - 2), width, 2))
    })
}

/// Estimates the bytes of a picture without loss from the differences of some samples from their neighbours.
///
/// # Errors
/// Returns an error of `source`.
pub(super) fn estimated_bytes(source: &dyn PixelSource) -> Result<f64> {
    /// Bits of the samples in the second of two rows.
    fn bits<T: Copy + Into<i32>>(samples: &[T], count: usize, of: &impl Fn(u32) -> f64) -> f64 {
        let (above, row) = samples.split_at(samples.len() / 2);
        let value = |row: &[T], at: usize| -> i32 { row[at].into() };
        let each = |at: usize| {
            // The lesser of the differences from the neighbours and from a plane through them. Differences of colours
            // are relative to that of the channel before.
            let difference = |at: usize| {
                let [left, up, corner] = [value(row, at - count), value(above, at), value(above, at - count)];
                value(row, at) - (left + up - corner).clamp(left.min(up), left.max(up))
            };
            let own = difference(at);
            let rest = if !at.is_multiple_of(count) && count >= 3 { own - difference(at - 1) } else { own };
            of(own.unsigned_abs().min(rest.unsigned_abs()))
        };
        (count..row.len()).map(each).sum()
    }
    let bits_of = |difference: u32| (2.0 * f64::from(difference) + 1.0).strict_log2() + 0.5;
    let small: [f64; 64] = std::array::from_fn(|difference| bits_of(difference as u32));
    let of = |difference: u32| small.get(difference as usize).copied().unwrap_or_else(|| bits_of(difference));
    let [width, height] = source.size();
    let (mut sum, mut samples) = (0.0, 0.0);
    for rows in sampled_rows(source, exact::ESTIMATED_PAIRS) {
        let rows = rows?;
        let count = rows.channels().count();
        sum += match rows.samples() {
            Samples::U8(v) => bits(v, count, &of),
            Samples::U16(v) => bits(v, count, &of),
        };
        samples += f64::from(width) * count as f64;
    }
    let all = f64::from(width) * f64::from(height) * source.channels().count() as f64;
    Ok(if samples > 0.0 { all * sum / samples / 8.0 } else { 0.0 })
}

/// Adds metadata and a thumbnail to a file, of which `bytes` has neither, and returns its bytes.
///
/// # Errors
/// [`Error::LimitExceeded`](crate::Error::LimitExceeded) if decoders with default limits would refuse the file, and
/// [`Error::Cancelled`](crate::Error::Cancelled).
pub(super) fn finished(
    mut splats: PackedSplats,
    mut bytes: Vec<u8>,
    options: &EncodeOptions,
    report: &mut ReportBuilder<'_>,
) -> Result<(PackedSplats, Vec<u8>)> {
    let metadata = Metadata {
        thumbnail: thumbnail::for_file(&splats, bytes.len() as u64, options, encode_whole, report)?,
        ..options.stored()
    };
    if metadata != Metadata::default() {
        splats.metadata = metadata;
        bytes = to_bytes(&splats)?;
    }
    check_opens(&splats)?;
    Ok((splats, bytes))
}

/// Returns whether the first pixel of a part equals `pixel`.
fn starts_like(part: &Pixels, pixel: &Pixels) -> bool {
    let count = part.channels().count();
    match (part.samples(), pixel.samples()) {
        (Samples::U8(a), Samples::U8(b)) => a[..count] == b[..],
        (Samples::U16(a), Samples::U16(b)) => a[..count] == b[..],
        _ => false,
    }
}

/// Returns the nearest background colour to a mean of samples.
fn background(splats: &PackedSplats, mean: [f64; 4]) -> [i16; 4] {
    let quantizer = splats.quantizer();
    let white = match splats.depth {
        Depth::Eight => 255.0,
        Depth::Sixteen => 65_535.0,
    };
    let (values, steps) = (quantizer.transform_color(mean.map(|v| (v / white) as f32)), quantizer.color_steps());
    let nearest = |k: usize| (values[k] / steps[k] + 0.5).floor() as i16;
    std::array::from_fn(|k| if k < splats.channels.count() { nearest(k) } else { 0 })
}

/// Adds the samples of each channel to `sums`.
fn add_samples(pixels: &Pixels, sums: &mut [u64; 4]) {
    fn add<T: Copy + Into<u64>>(samples: &[T], count: usize, sums: &mut [u64; 4]) {
        for pixel in samples.chunks_exact(count) {
            sums.iter_mut().zip(pixel).for_each(|(sum, &v)| *sum += v.into());
        }
    }
    match pixels.samples() {
        Samples::U8(v) => add(v, pixels.channels().count(), sums),
        Samples::U16(v) => add(v, pixels.channels().count(), sums),
    }
}

/// Returns the number of pixels that are equal to their left neighbour or to the one above.
fn equal_pixels(pixels: &Pixels) -> u64 {
    fn equal<T: PartialEq>(samples: &[T], count: usize, row: usize) -> u64 {
        let pixel = |at: usize| &samples[at..at + count];
        let is_equal = |at: usize| {
            (at % row >= count && pixel(at) == pixel(at - count)) || (at >= row && pixel(at) == pixel(at - row))
        };
        (0..samples.len()).step_by(count).filter(|&at| is_equal(at)).count() as u64
    }
    let count = pixels.channels().count();
    let row = pixels.width() as usize * count;
    match pixels.samples() {
        Samples::U8(v) => equal(v, count, row),
        Samples::U16(v) => equal(v, count, row),
    }
}

/// Returns for each pixel of the second of two rows whether it equals its left neighbour, and the one above.
pub(super) fn equal_neighbours(rows: &Pixels) -> Vec<[bool; 2]> {
    fn equal<T: PartialEq>(samples: &[T], count: usize) -> Vec<[bool; 2]> {
        let (above, row) = samples.split_at(samples.len() / 2);
        let equal = |x: usize| {
            let (at, own) = (x * count, &row[x * count..][..count]);
            [x > 0 && *own == row[at - count..at], *own == above[at..][..count]]
        };
        (0..row.len() / count).map(equal).collect()
    }
    let count = rows.channels().count();
    match rows.samples() {
        Samples::U8(v) => equal(v, count),
        Samples::U16(v) => equal(v, count),
    }
}

/// Returns the number of sharp edges after runs of equal pixels in the second of two rows. `equal` is what
/// [`equal_neighbours`] returns for them.
pub(super) fn sharp_edges(rows: &Pixels, equal: &[[bool; 2]]) -> usize {
    let (count, width) = (rows.channels().count(), equal.len());
    let value = |i: usize| match rows.samples() {
        Samples::U8(v) => f32::from(v[i]) / 255.0,
        Samples::U16(v) => f32::from(v[i]) / 65_535.0,
    };
    let luma = |x: usize| {
        let at = (width + x) * count;
        if count < 3 { value(at) } else { 0.25 * (value(at) + value(at + 2)) + 0.5 * value(at + 1) }
    };
    let (mut run, mut edges) = (1, 0);
    for x in 1..width {
        if equal[x][0] {
            run += 1;
            continue;
        }
        let ground = luma(x - 1);
        let difference = (luma(x) - ground).abs().max((luma((x + 1).min(width - 1)) - ground).abs());
        edges += usize::from(run >= exact::MIN_EDGE_RUN && difference >= exact::MIN_EDGE_DIFFERENCE);
        run = 1;
    }
    edges
}

/// Returns a picture whose colours under alpha 0 are black, which costs the fewest bytes.
pub(super) fn without_hidden(pixels: Pixels) -> Result<Pixels> {
    fn blacken<T: PartialEq + Default + Copy>(samples: &mut [T], count: usize) {
        samples.chunks_exact_mut(count).filter(|p| p[count - 1] == T::default()).for_each(|p| p.fill(T::default()));
    }
    if pixels.channels().alpha().is_none() {
        return Ok(pixels);
    }
    let (width, height, channels) = (pixels.width(), pixels.height(), pixels.channels());
    let mut samples = pixels.into_samples();
    match &mut samples {
        Samples::U8(v) => blacken(v, channels.count()),
        Samples::U16(v) => blacken(v, channels.count()),
    }
    Pixels::new(width, height, channels, samples)
}
