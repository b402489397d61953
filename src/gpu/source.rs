//! The target picture on the device, in slabs of rows with one binding each.

use super::device::Device;
use super::lists::MAX_TILES;
use super::scene::TILE;
use crate::error::{GpuError, Result};
use crate::fit::model::objective::planes::Planes;
use crate::pixels::{Depth, Pixels, Samples};

/// The target on the device.
#[derive(Debug)]
pub(super) struct Source {
    pub size: [u32; 2],
    pub slab_rows: u32,
    pub slabs: Vec<Slab>,
}

/// A part of the target: rows from `first` on.
#[derive(Debug)]
pub(super) struct Slab {
    pub first: u32,
    pub end: u32,
    pub source: wgpu::Buffer,
}

impl Source {
    /// Copies a picture of `words` words per pixel to the device. `packed` returns the words of rows `first..end`.
    pub(super) fn new(
        device: &Device,
        size: [u32; 2],
        slab_rows: u32,
        packed: impl Fn(u32, u32) -> Vec<u32>,
    ) -> Result<Self> {
        let mut slabs = Vec::new();
        for first in (0..size[1]).step_by(slab_rows as usize) {
            let end = size[1].min(first + slab_rows);
            let packed = packed(first, end);
            let source = device.scoped(|| {
                let source = device.storage("source", packed.len() as u64 * 4);
                device.write(&source, &packed);
                device.wgpu().1.submit([]);
                source
            })?;
            // A pending copy doubles the memory, so copy one slab at a time.
            device.wait()?;
            slabs.push(Slab { first, end, source });
        }
        Ok(Source { size, slab_rows, slabs })
    }
}

/// Returns the rows of a slab of the target and of a band of planes, for pixels of `words` words, so that no binding
/// exceeds `binding` bytes.
pub(super) fn rows_at_a_time(width: u32, height: u32, words: u32, binding: u64) -> Result<[u32; 2]> {
    let (wide, tile) = (u64::from(width), u64::from(TILE));
    let slab = (binding / (4 * u64::from(words) * wide)).min(u64::from(height)) as u32;
    let by_planes = binding / (16 * wide) / tile;
    let by_tiles = MAX_TILES / wide.div_ceil(tile);
    let band = by_planes.min(by_tiles).min(u64::from(height.div_ceil(TILE))) as u32 * TILE;
    if slab == 0 || band == 0 {
        let what = "columns of a picture to fit";
        return Err(GpuError::Overflow { what, requested: wide, allowed: binding / (16 * tile) }.into());
    }
    Ok([slab, band])
}

/// Returns the number of words per pixel of `depth`: its samples, and the amplitude of its error if `target` has one.
pub(super) fn words(target: &Planes, depth: Depth) -> u32 {
    depth.bytes() as u32 + u32::from(!target.amplitude.is_empty())
}

/// Packs rows `first..end` of a target that does not consist of whole code values, in the format of [`pack`].
pub(super) fn pack_target(target: &Planes, depth: Depth, first: u32, end: u32) -> Vec<u32> {
    let count = target.channels.count();
    let white = f32::from(depth.max());
    let mut out = Vec::with_capacity((end - first) as usize * (target.width * words(target, depth)) as usize);
    for y in first..end {
        let (row, amplitude) = (target.row(y), target.amplitude(y));
        for x in 0..target.width as usize {
            let code = |k: usize| {
                if k < count { (row[k * target.stride + x].clamp(0.0, 1.0) * white + 0.5) as u32 } else { 0 }
            };
            match depth {
                Depth::Eight => out.push(code(0) | code(1) << 8 | code(2) << 16 | code(3) << 24),
                Depth::Sixteen => out.extend([code(0) | code(1) << 16, code(2) | code(3) << 16]),
            }
            out.extend(amplitude.map(|a| a[x].to_bits()));
        }
    }
    out
}

/// Packs rows `first..end` of the target, whose samples are `pixels`. A pixel has four channels, in one word with 8
/// bits per sample and two with 16, and another word with the amplitude of its error as a float, if there is one.
pub(super) fn pack(pixels: &Pixels, target: &Planes, first: u32, end: u32) -> Vec<u32> {
    let samples = pack_samples(pixels, first, end);
    if target.amplitude.is_empty() {
        return samples;
    }
    let each = pixels.depth().bytes();
    let width = pixels.width() as usize;
    let mut out = Vec::with_capacity(samples.len() / each * (each + 1));
    for (y, row) in (first..end).zip(samples.chunks_exact(width * each)) {
        let amplitude = target.amplitude(y).expect("one for each row");
        for (words, a) in row.chunks_exact(each).zip(amplitude) {
            out.extend_from_slice(words);
            out.push(a.to_bits());
        }
    }
    out
}

/// Packs the samples alone.
fn pack_samples(pixels: &Pixels, first: u32, end: u32) -> Vec<u32> {
    let count = pixels.channels().count();
    let row = pixels.width() as usize * count;
    let range = first as usize * row..end as usize * row;
    match pixels.samples() {
        Samples::U8(v) => v[range]
            .chunks_exact(count)
            .map(|p| p.iter().enumerate().fold(0, |word, (k, &s)| word | u32::from(s) << (8 * k)))
            .collect(),
        Samples::U16(v) => v[range]
            .chunks_exact(count)
            .flat_map(|p| {
                let s = |k: usize| p.get(k).map_or(0, |&s| u32::from(s));
                [s(0) | s(1) << 16, s(2) | s(3) << 16]
            })
            .collect(),
    }
}
