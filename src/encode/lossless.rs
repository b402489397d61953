//! Encodes pictures without loss: the file has an exact layer that covers the whole picture (spec §12), and neither
//! Gaussians nor a detail layer.

use std::sync::Arc;

use super::drawn::check_opens;
use super::report::ReportBuilder;
use super::{EncodeReport, Encoded, thumbnail};
use crate::bitstream::ExactLayer;
use crate::bitstream::exact::ExactTile;
use crate::bitstream::splats::{Layout, PackedSplats};
use crate::bitstream::{exact, to_bytes};
use crate::encode::input;
use crate::error::{Error, Result};
use crate::gaussian::Blend;
use crate::options::{EncodeOptions, HiddenColors};
use crate::parameter::Parameter;
use crate::pixel_source::PixelSource;
use crate::pixels::{Pixels, Samples};
use crate::rect::Rect;

/// Logarithms of the tiles' sides: for pictures in which neighbouring pixels are often equal, which gain from
/// repetitions far away, and for all others, which gain from parallel decoding.
const SIDES: [u8; 2] = [11, 9];

/// Encodes the picture of `source`.
///
/// # Errors
/// [`Error::Parameter`] for another layout than the coded one, [`Error::Cancelled`] if the caller cancels, and the
/// errors of `source`.
pub(super) fn encode(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    mut report: ReportBuilder<'_>,
) -> Result<Encoded> {
    if options.layout != Layout::Coded {
        let problem = "only the coded layout stores pictures without loss".into();
        return Err(Error::Parameter { parameter: Parameter::Other("layout"), problem });
    }
    let size = source.size();
    let tiles = exact::tile_counts(size, SIDES[0]);
    let mut parts = Vec::new();
    let (mut equal, mut pixels, mut sums) = (0, 0u64, [0; 4]);
    for i in 0..tiles[0] * tiles[1] {
        report.stage_progress("survey", i as f32 / (tiles[0] * tiles[1]) as f32)?;
        let [x, y, width, height] = exact::tile_area(size, SIDES[0], i).map(|v| v as u32);
        let part = source.part(Rect::new(x, y, width, height))?;
        let part = if options.hidden == HiddenColors::Keep { part } else { without_hidden(part)? };
        equal += equal_pixels(&part);
        pixels += u64::from(width) * u64::from(height);
        add_samples(&part, &mut sums);
        parts.push(part);
    }
    let side = SIDES[usize::from(2 * equal < pixels)];
    let count = exact::tile_counts(size, side);
    let tile = |i: usize| {
        let [x, y, width, height] = exact::tile_area(size, side, i);
        let part = &parts[(y >> SIDES[0]) * tiles[0] + (x >> SIDES[0])];
        let corner = [x, y].map(|v| (v % (1 << SIDES[0])) as u32);
        let samples = match side == SIDES[0] {
            true => part.samples().clone(),
            false => part.part(Rect::new(corner[0], corner[1], width as u32, height as u32))?.into_samples(),
        };
        Ok(Some(ExactTile { samples, cells: None }))
    };
    let layer = ExactLayer { side, tiles: (0..count[0] * count[1]).map(tile).collect::<Result<_>>()? };
    drop(parts);
    let mut splats = input::empty(size, (source.channels(), source.depth()), Blend::Normalized, options);
    splats.background = background(&splats, sums.map(|sum| sum as f64 / pixels as f64));
    (splats.metadata.icc, splats.metadata.exif) = (options.icc.clone(), options.exif.clone());
    splats.exact = Some(Arc::new(layer));
    let since = report.seconds();
    report.stage_progress("exact layer", 0.0)?;
    let mut bytes = to_bytes(&splats)?;
    report.stage("exact layer", since);
    if let Some(small) = thumbnail::for_file(&splats, bytes.len() as u64, options, &mut report)? {
        splats.metadata.thumbnail = Some(small);
        bytes = to_bytes(&splats)?;
    }
    check_opens(&splats)?;
    let report = EncodeReport {
        effort: options.effort,
        psnr: f64::INFINITY,
        float_psnr: f64::INFINITY,
        seconds: report.seconds(),
        stages: report.stages,
        skipped: report.skipped,
        ..EncodeReport::default()
    };
    Ok(Encoded { bytes, report })
}

/// Returns the nearest background colour to a mean of samples.
fn background(splats: &PackedSplats, mean: [f64; 4]) -> [i16; 4] {
    let quantizer = splats.quantizer();
    let white = match splats.depth {
        crate::Depth::Eight => 255.0,
        crate::Depth::Sixteen => 65_535.0,
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

/// Returns a picture whose colours under alpha 0 are black, which costs the fewest bytes.
fn without_hidden(pixels: Pixels) -> Result<Pixels> {
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
