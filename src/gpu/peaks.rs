//! Finds the largest errors on the device: cells of the residual, blurred and halved level by level.

use super::device::Device;
use super::kernels::Kernels;
use super::scene::{Uniforms, spaced};
use super::workspace::Workspace;
use crate::error::{GpuError, Result};
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::peaks::Peak;
use crate::fit::model::placing::ridge::{self, Shape};
use bytemuck::{Pod, Zeroable};

/// Maximum number of levels.
const LEVELS: u32 = 12;

/// Sets of uniforms: three per level and an additional pass in the first.
const SLOTS: u64 = 4 * LEVELS as u64;

/// A peak as written by `peaks.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Found {
    /// Mean residual under its shape.
    pub residual: [f32; 4],
    pub level: u32,
    /// Number of its ridge, from 1 on; 0 for a round peak.
    pub ridge: u32,
    pub x: u32,
    pub y: u32,
}

impl Found {
    pub(super) fn shape(&self) -> Shape {
        Shape::new((self.ridge as usize).checked_sub(1), self.residual)
    }
}

/// The buffers, and the stages that are bound to them.
#[derive(Debug)]
pub(super) struct Peaks {
    /// Number of cells that the buffers can hold.
    capacity: u64,
    uniforms: wgpu::Buffer,
    found: wgpu::Buffer,
    count: wgpu::Buffer,
    residual: Vec<wgpu::BindGroup>,
    /// From the first cell buffer to the second and back.
    blur: [wgpu::BindGroup; 2],
    halve: [wgpu::BindGroup; 2],
    find: [wgpu::BindGroup; 2],
    /// Cells, and their blurred or halved copies, which tests read.
    #[cfg(test)]
    pub cells: [wgpu::Buffer; 2],
}

/// One level of the search.
#[derive(Debug, Clone, Copy)]
struct Level {
    size: [u32; 2],
    /// Cell size, pixels.
    cell: f32,
    variance: f32,
    passes: u32,
}

impl Peaks {
    /// Returns the number of cells of a picture whose sampled rows are `rows`.
    pub(super) fn cells(base: &Uniforms, rows: RowSet) -> u64 {
        u64::from(base.width.div_ceil(rows.step)) * rows.count(base.height) as u64
    }

    /// Creates the buffers for the cells of `rows`.
    pub(super) fn new(
        device: &Device,
        base: &Uniforms,
        rows: RowSet,
        sources: &[&wgpu::Buffer],
        workspace: &Workspace,
    ) -> Result<Self> {
        let capacity = Self::cells(base, rows);
        device.scoped(|| {
            use wgpu::BufferUsages as U;
            let (k, d) = (device.kernels(), device.wgpu().0);
            let uniforms = device.buffer("uniforms", SLOTS * u64::from(Uniforms::STRIDE), U::UNIFORM | U::COPY_DST);
            let cells = ["cells", "blurred"].map(|name| device.storage(name, capacity * 16));
            let found = device.storage("peaks", most_peaks(capacity) * size_of::<Found>() as u64);
            let count = device.storage("peak count", 4);
            let ridges = device.storage("ridges", size_of_val(&ridge::all()) as u64);
            device.write(&ridges, ridge::all().as_flattened());
            let status = &workspace.lists.status;
            let residual = sources.iter();
            let residual = residual
                .map(|s| k.residual.bind(d, &workspace.uniforms, &[&workspace.planes, s, &cells[0], status]))
                .collect();
            let both = [[&cells[0], &cells[1]], [&cells[1], &cells[0]]];
            Peaks {
                capacity,
                residual,
                blur: both.map(|b| k.blur.bind(d, &uniforms, &b)),
                halve: both.map(|b| k.halve.bind(d, &uniforms, &b)),
                find: both.map(|b| k.find_peaks.bind(d, &uniforms, &[b[0], &found, &count, &ridges])),
                uniforms,
                found,
                count,
                #[cfg(test)]
                cells,
            }
        })
    }

    /// Returns the number of cells that fit.
    pub(super) fn capacity(&self) -> u64 {
        self.capacity
    }

    /// Converts the planes of a band to cells.
    pub(super) fn residual(
        &self,
        kernels: &Kernels,
        pass: &mut wgpu::ComputePass<'_>,
        slab: usize,
        slot: u32,
        band: &Uniforms,
    ) {
        let cells = u64::from(band.cells_x) * u64::from(band.band_rows);
        kernels.residual.each(pass, &self.residual[slab], slot, cells);
    }

    /// Returns all peaks of the cells with a gain of at least `least`, with their levels, at scales up to `spacing`.
    /// Overwrites the cells.
    pub(super) fn find(
        &self,
        device: &Device,
        base: &Uniforms,
        rows: RowSet,
        spacing: f32,
        least: f32,
    ) -> Result<Vec<(Peak, u32)>> {
        let levels = levels(base, rows, spacing);
        let mut set = Vec::new();
        let at = |level: &Level, i: usize| Uniforms {
            cells_x: level.size[0],
            cells_y: level.size[1],
            variance: level.variance,
            longest: ridge::max_aspect(spacing, level.variance.sqrt()),
            least_gain: least,
            level: i as u32,
            capacity: most_peaks(self.capacity) as u32,
            ..*base
        };
        for (i, level) in levels.iter().enumerate() {
            let u = at(level, i);
            set.extend([u, Uniforms { mode: 1, ..u }]);
        }
        let k = device.kernels();
        device.scoped(|| {
            let (d, queue) = device.wgpu();
            device.write(&self.uniforms, &spaced(&set));
            let mut encoder = d.create_command_encoder(&Default::default());
            encoder.clear_buffer(&self.count, 0, None);
            let mut pass = encoder.begin_compute_pass(&Default::default());
            for (i, level) in levels.iter().enumerate() {
                // Halving moves the cells to the other buffer.
                let (from, slot) = (i % 2, 2 * i as u32);
                let cells = u64::from(level.size[0]) * u64::from(level.size[1]);
                for _ in 0..level.passes {
                    k.blur.each(&mut pass, &self.blur[from], slot, cells);
                    k.blur.each(&mut pass, &self.blur[1 - from], slot + 1, cells);
                }
                k.find_peaks.each(&mut pass, &self.find[from], slot, cells);
                let half = level.size.map(|s| u64::from(s.div_ceil(2)));
                k.halve.each(&mut pass, &self.halve[from], slot, half[0] * half[1]);
            }
            drop(pass);
            queue.submit([encoder.finish()]);
        })?;
        let found: u64 = device.read_as::<u32>(&self.count, 1)?[0].into();
        let allowed = most_peaks(self.capacity);
        if found > allowed {
            return Err(GpuError::Overflow { what: "peaks", requested: found, allowed }.into());
        }
        let found: Vec<Found> = device.read_as(&self.found, found as usize)?;
        let peak = |f: Found| {
            let level = &levels[f.level as usize];
            let mean = [f.x, f.y].map(|v| (v as f32 + 0.5) * level.cell);
            (Peak::new(mean, level.variance.sqrt(), &f.shape()), f.level)
        };
        Ok(found.into_iter().map(peak).collect())
    }
}

/// Returns an upper bound of the number of peaks: peaks are never adjacent, and each level has a quarter of the cells
/// of the previous one.
fn most_peaks(cells: u64) -> u64 {
    cells / 2 + 64 * u64::from(LEVELS)
}

/// Returns the levels of the search, the same as in `fit::model::placing::peaks::peaks`.
fn levels(base: &Uniforms, rows: RowSet, spacing: f32) -> Vec<Level> {
    let mut size = [base.width.div_ceil(rows.step), rows.count(base.height) as u32];
    let mut cell = rows.step as f32;
    let mut variance = 0.0f32;
    let mut levels = Vec::new();
    for i in 0..LEVELS {
        let passes = if i == 0 { 2 } else { 1 };
        variance += passes as f32 * cell * cell;
        if i > 0 && variance.sqrt() > spacing {
            break;
        }
        levels.push(Level { size, cell, variance, passes });
        if size[0] < 4 || size[1] < 4 {
            break;
        }
        // The box filter of the halving adds a quarter of a cell.
        variance += 0.25 * cell * cell;
        size = size.map(|s| s.div_ceil(2));
        cell *= 2.0;
    }
    levels
}
