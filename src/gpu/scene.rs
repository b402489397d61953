//! Uniforms of all stages: the Rust equivalent of `Scene` in `common.wgsl`.

use bytemuck::{Pod, Zeroable};

use crate::gaussian::{Blend, Channels};
use crate::raster::View;

/// Columns and rows of a tile.
pub(super) const TILE: u32 = 16;

/// The fields have the order of the shader; a test compares the layouts.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Uniforms {
    pub background: [f32; 4],
    pub rates: [f32; 4],
    pub channel_amplitude: [f32; 4],
    pub origin_high: [f32; 2],
    pub origin_low: [f32; 2],
    pub step: [f32; 2],
    pub size: [f32; 2],
    pub widening: [f32; 2],
    pub decay: [f32; 2],
    pub min_log_scale: f32,
    pub max_log_scale: f32,
    pub max_log_aspect: f32,
    pub correction_first: f32,
    pub correction_second: f32,
    pub least_gain: f32,
    pub variance: f32,
    pub longest: f32,
    pub primitives: u32,
    pub capacity: u32,
    pub width: u32,
    pub height: u32,
    pub across: u32,
    pub down: u32,
    pub row_step: u32,
    pub row_phase: u32,
    pub band_first: u32,
    pub band_rows: u32,
    pub tiles_x: u32,
    pub tiles_y: u32,
    pub tile_base: u32,
    pub blend: u32,
    pub channels: u32,
    pub alpha: u32,
    pub source_words: u32,
    pub source_first: u32,
    pub mode: u32,
    pub cells_x: u32,
    pub cells_y: u32,
    pub cell: u32,
    pub stride: u32,
    pub level: u32,
    pub price: f32,
    pub weighted: u32,
    pub detail: u32,
    /// Number of primitives at the end of the list that do not move.
    pub frozen: u32,
}

/// Value of [`Uniforms::alpha`] for pictures without alpha.
pub(super) const NO_ALPHA: u32 = 4;

impl Uniforms {
    /// Distance of sets of uniforms in their buffer, bytes: an alignment that every device supports.
    pub(super) const STRIDE: u32 = 256;

    /// Returns the uniforms that all stages of rendering `view` share. For a reduced view, the stages render the
    /// samples that are averaged to pixels.
    pub(super) fn new(view: &View, blend: Blend, channels: Channels, background: [f32; 4], primitives: u32) -> Self {
        let filter = view.filter();
        let [across, down] = filter.parts;
        let view = view.refined(filter.parts);
        let step = view.step();
        let first = view.position(0, 0);
        let origin: [f64; 2] = std::array::from_fn(|k| first[k] - 0.5 * step[k]);
        let high = origin.map(|v| v as f32);
        Uniforms {
            background,
            channel_amplitude: [1.0; 4],
            origin_high: high,
            origin_low: std::array::from_fn(|k| (origin[k] - f64::from(high[k])) as f32),
            step: step.map(|v| v as f32),
            size: [view.width() as f32, view.height() as f32],
            widening: filter.variance.map(|v| v as f32),
            primitives,
            width: view.width(),
            height: view.height(),
            across,
            down,
            row_step: 1,
            tiles_x: view.width().div_ceil(TILE),
            blend: match blend {
                Blend::Normalized => 0,
                Blend::Sum => 1,
            },
            channels: channels.count() as u32,
            alpha: channels.alpha().map_or(NO_ALPHA, |a| a as u32),
            source_words: 1,
            ..Zeroable::zeroed()
        }
    }

    /// Returns the uniforms for the sampled rows `first .. first + rows`.
    pub(super) fn band(self, first: u32, rows: u32) -> Self {
        Uniforms { band_first: first, band_rows: rows, tiles_y: rows.div_ceil(TILE), ..self }
    }

    /// Returns the number of tiles of the band.
    pub(super) fn tiles(&self) -> u64 {
        u64::from(self.tiles_x) * u64::from(self.tiles_y)
    }
}

/// Returns the bytes of `uniforms`, each at a multiple of [`Uniforms::STRIDE`].
pub(super) fn spaced(uniforms: &[Uniforms]) -> Vec<u8> {
    let mut bytes = vec![0; uniforms.len() * Uniforms::STRIDE as usize];
    for (space, u) in bytes.chunks_exact_mut(Uniforms::STRIDE as usize).zip(uniforms) {
        space[..size_of::<Uniforms>()].copy_from_slice(bytemuck::bytes_of(u));
    }
    bytes
}

/// A Gaussian as the shaders store it: `Primitive` in `project.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Primitive {
    pub mean: [f32; 2],
    /// Natural logarithms of the scales.
    pub log_scale: [f32; 2],
    pub rotation: f32,
    pub color: [f32; 4],
}

/// A projected Gaussian: `Splat` in `common.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Splat {
    pub place: [f32; 4],
    pub shape: [f32; 4],
    pub extent: [f32; 4],
    pub color: [f32; 4],
}
