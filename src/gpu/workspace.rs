//! Working memory of a step: buffers whose sizes depend on the number of primitives, the bands and the lists, and the
//! passes bound to them.

use super::device::Device;
use super::lists::Lists;
use super::scene::Uniforms;
use super::source::Source;
use crate::error::Result;

/// Sets of uniforms per submission.
pub(super) const SLOTS: usize = 1024;

/// Bytes per pair in the slots.
pub(super) const SLOT: u64 = 48;

/// Sizes that the buffers must hold.
#[derive(Debug)]
pub(super) struct BufferSizes {
    pub primitives: u64,
    /// Capacity of the lists in pairs.
    pub capacity: u32,
    /// Pixels of a band.
    pub pixels: u64,
    /// Tiles of a band, and of all bands of the whole picture.
    pub band_tiles: u64,
    pub all_tiles: u64,
}

/// The buffers and the passes.
#[derive(Debug)]
pub(super) struct Workspace {
    pub uniforms: wgpu::Buffer,
    pub lists: Lists,
    pub planes: wgpu::Buffer,
    pub errors: wgpu::Buffer,
    pub moments: wgpu::Buffer,
    pub forward: Vec<wgpu::BindGroup>,
    pub backward: wgpu::BindGroup,
    pub importance: Vec<wgpu::BindGroup>,
    pub gather: wgpu::BindGroup,
    pub adam: wgpu::BindGroup,
    /// Buffer that tests read.
    #[cfg(test)]
    pub tails: wgpu::Buffer,
    #[cfg(test)]
    pub slots: wgpu::Buffer,
}

impl Workspace {
    /// Creates the buffers and passes for the slabs of `source` and the `state` of a fit: its primitives, and Adam's
    /// moments of them.
    ///
    /// # Errors
    /// [`Error::Gpu`](crate::Error::Gpu) if the device does not have enough memory.
    pub(super) fn new(
        device: &Device,
        source: &Source,
        state: [&wgpu::Buffer; 3],
        sizes: &BufferSizes,
    ) -> Result<Self> {
        let [primitives, first, second] = state;
        device.scoped(|| {
            use wgpu::BufferUsages as U;
            let (k, d) = (device.kernels(), device.wgpu().0);
            let uniforms =
                device.buffer("uniforms", SLOTS as u64 * u64::from(Uniforms::STRIDE), U::UNIFORM | U::COPY_DST);
            let lists = Lists::new(device, &uniforms, primitives, sizes.primitives, sizes.band_tiles, sizes.capacity);
            let planes = device.storage("planes", sizes.pixels * 16);
            let tails = device.storage("tails", sizes.pixels * 4);
            let errors = device.storage("errors", sizes.all_tiles * 4);
            let slots = device.storage("slots", u64::from(sizes.capacity) * SLOT);
            let moments = device.storage("moments", sizes.primitives * 36);
            let shared = [&lists.splats, &lists.starts, &lists.sorted, &lists.status];
            let forward = source.slabs.iter().map(|s| {
                let buffers = [&shared[..], &[&s.source, &planes, &tails, &errors]].concat();
                k.forward.bind(d, &uniforms, &buffers)
            });
            let forward = forward.collect();
            let pairs = [&shared[..], &[&planes, &tails, &slots]].concat();
            let importance =
                source.slabs.iter().map(|s| k.importance.bind(d, &uniforms, &[&pairs[..], &[&s.source]].concat()));
            let importance = importance.collect();
            let gathered = [&shared[..], &[&slots, &moments]].concat();
            Workspace {
                forward,
                backward: k.backward.bind(d, &uniforms, &pairs),
                importance,
                gather: k.gather.bind(d, &uniforms, &gathered),
                adam: k.adam.bind(d, &uniforms, &[primitives, &moments, first, second, &lists.status]),
                uniforms,
                lists,
                planes,
                errors,
                moments,
                #[cfg(test)]
                tails,
                #[cfg(test)]
                slots,
            }
        })
    }

    /// Returns the error of the last step or survey, summed over the `tiles` tiles of all bands.
    pub(super) fn error(&self, device: &Device, tiles: u64) -> Result<f64> {
        Ok(device.read_as::<f32>(&self.errors, tiles as usize)?.iter().map(|&e| f64::from(e)).sum())
    }
}
