//! The lists of Gaussians per tile on the device: projected, counted, scanned, scattered and sorted, band by band.

use super::device::Device;
use super::kernels::Kernels;
use super::scene::{Primitive, Splat, Uniforms};
use crate::error::{GpuError, Result};

/// Largest binding that every device supports, bytes.
pub(super) const MAX_BINDING: u64 = 128 << 20;

/// Maximum number of tiles of a band, which the three levels of the scan can sum.
pub(super) const MAX_TILES: u64 = 1 << 20;

/// Words of the status: pairs of the band, maximum number of pairs that did not fit, steps done, and one unused word.
pub(super) const STATUS: usize = 4;

/// The buffers, and the stages that are bound to them.
#[derive(Debug)]
pub(super) struct Lists {
    pub splats: wgpu::Buffer,
    pub starts: wgpu::Buffer,
    pub sorted: wgpu::Buffer,
    pub status: wgpu::Buffer,
    cursors: wgpu::Buffer,
    project: wgpu::BindGroup,
    bin: wgpu::BindGroup,
    scan: [wgpu::BindGroup; 3],
    sort: wgpu::BindGroup,
    /// Pairs before sorting, for tests.
    #[cfg(test)]
    pub unsorted: wgpu::Buffer,
}

impl Lists {
    /// Creates the buffers for `count` primitives, bands of `tiles` tiles and `capacity` pairs. Call it within a
    /// scope.
    pub(super) fn new(
        device: &Device,
        uniforms: &wgpu::Buffer,
        primitives: &wgpu::Buffer,
        count: u64,
        tiles: u64,
        capacity: u32,
    ) -> Self {
        let (k, d) = (device.kernels(), device.wgpu().0);
        let splats = device.storage("splats", count * size_of::<Splat>() as u64);
        let cursors = device.storage("cursors", tiles * 4);
        let starts = device.storage("starts", (tiles + 1) * 4);
        let blocks = device.storage("blocks", tiles.div_ceil(1024) * 4);
        let lists = device.storage("lists", u64::from(capacity) * 4);
        let sorted = device.storage("sorted", u64::from(capacity) * 4);
        let status = device.storage("status", (STATUS * 4) as u64);
        let scanned = [&cursors, &starts, &blocks, &status];
        Lists {
            project: k.project.bind(d, uniforms, &[primitives, &splats]),
            bin: k.bin.bind(d, uniforms, &[&splats, &cursors, &lists, &status]),
            scan: [&k.scan_sum, &k.scan_top, &k.scan_spread].map(|s| s.bind(d, uniforms, &scanned)),
            sort: k.sort.bind(d, uniforms, &[&starts, &lists, &sorted, &status]),
            splats,
            starts,
            sorted,
            status,
            cursors,
            #[cfg(test)]
            unsorted: lists,
        }
    }

    /// Projects all primitives with the uniforms at `slot`.
    pub(super) fn project(&self, kernels: &Kernels, encoder: &mut wgpu::CommandEncoder, slot: u32, count: u64) {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        kernels.project.each(&mut pass, &self.project, slot, count);
    }

    /// Fills the lists of one band. The uniforms at `slot` are those of the band with mode 0, and those at `slot + 1`
    /// with mode 1.
    pub(super) fn fill(&self, kernels: &Kernels, encoder: &mut wgpu::CommandEncoder, slot: u32, band: &Uniforms) {
        encoder.clear_buffer(&self.cursors, 0, None);
        encoder.clear_buffer(&self.status, 0, Some(4));
        let count = u64::from(band.primitives);
        let blocks = band.tiles().div_ceil(1024);
        let mut pass = encoder.begin_compute_pass(&Default::default());
        kernels.bin.each(&mut pass, &self.bin, slot, count);
        kernels.scan_sum.groups(&mut pass, &self.scan[0], slot, blocks);
        kernels.scan_top.groups(&mut pass, &self.scan[1], slot, 1);
        kernels.scan_spread.groups(&mut pass, &self.scan[2], slot, blocks);
        kernels.bin.each(&mut pass, &self.bin, slot + 1, count);
        kernels.sort.groups(&mut pass, &self.sort, slot, band.tiles());
    }

    /// Reads the status words.
    pub(super) fn status(&self, device: &Device) -> Result<[u32; STATUS]> {
        let words = device.read_as::<u32>(&self.status, STATUS)?;
        Ok(std::array::from_fn(|k| words[k]))
    }
}

/// Checks that a binding of `count` items of `size` bytes is within the limits of every device.
pub(super) fn check_binding(what: &'static str, count: u64, size: usize) -> Result<()> {
    let allowed = MAX_BINDING / size as u64;
    if count > allowed {
        return Err(GpuError::Overflow { what, requested: count, allowed }.into());
    }
    Ok(())
}

/// Checks that `count` primitives fit into bindings.
pub(super) fn check_primitives(count: u64) -> Result<()> {
    check_binding("primitives", count, size_of::<Splat>().max(size_of::<Primitive>()))
}
