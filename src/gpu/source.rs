//! The target picture on the device, in slabs of rows with one binding each.

use super::device::Device;
use super::lists::MAX_TILES;
use super::scene::TILE;
use crate::error::{GpuError, Result};
use crate::fit::model::objective::planes::Planes;
use crate::parallel;
use crate::pixels::Depth;

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

/// Packs rows `first..end` of `target`, rounded to code values of `depth`. A pixel has four channels, in one word with
/// 8 bits per sample and two with 16, and another word with the amplitude of its error as a float, if there is one.
pub(super) fn pack(target: &Planes, depth: Depth, first: u32, end: u32) -> Vec<u32> {
    let (count, width, each) = (target.channels.count(), target.width as usize, words(target, depth) as usize);
    let white = f32::from(depth.max());
    let mut out = vec![0; (end - first) as usize * width * each];
    parallel::map_chunks(&mut out, (width * each).max(1), |i, out| {
        let y = first + i as u32;
        let (row, amplitude) = (target.row(y), target.amplitude(y));
        for (x, out) in out.chunks_exact_mut(each).enumerate() {
            let code = |k: usize| {
                if k < count { (row[k * target.stride + x].clamp(0.0, 1.0) * white + 0.5) as u32 } else { 0 }
            };
            match depth {
                Depth::Eight => out[0] = code(0) | code(1) << 8 | code(2) << 16 | code(3) << 24,
                Depth::Sixteen => [out[0], out[1]] = [code(0) | code(1) << 16, code(2) | code(3) << 16],
            }
            if let Some(a) = amplitude {
                out[each - 1] = a[x].to_bits();
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussian::Channels;
    use crate::pixels::{Pixels, Samples};

    #[test]
    fn all_code_values_are_packed_exactly() {
        let all = Samples::U8((0..=255).collect());
        let target = Planes::new(&Pixels::new(64, 1, Channels::Rgba, all).unwrap());
        let want: Vec<u32> = (0..64).map(|i| u32::from_le_bytes([4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 3])).collect();
        assert_eq!(pack(&target, Depth::Eight, 0, 1), want);
        let all = Samples::U16((0..=u16::MAX).collect());
        let target = Planes::new(&Pixels::new(256, 256, Channels::Grey, all).unwrap());
        let want: Vec<u32> = (256 * 5..256 * 256).flat_map(|code| [code, 0]).collect();
        assert_eq!(pack(&target, Depth::Sixteen, 5, 256), want);
    }
}
