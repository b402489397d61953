//! Renders a view, at once or band by band, on all threads.

use super::bins::{Bins, TILE_HEIGHT, TILE_WIDTH};
use super::exact::ExactOverlay;
use super::kernel::{Added, Drawing, Job, Scratch, Source, Window};
use super::overlay::Overlay;
use super::project::{Splats, project};
use super::samples::{Sample, SamplesMut};
use super::view::{Filter, MAX_SIDE, View};
use crate::bitstream::detail::levels::TILE;
use crate::budget::Budget;
use crate::detail::supers::Supers;
use crate::error::{Error, Result};
use crate::gaussian::{Blend, Channels, Gaussian, Gaussians};
use crate::limits::Limits;
use crate::options::Layers;
use crate::parallel;
use crate::parameter::{Limit, Parameter};
use crate::pixels::{Depth, Pixels, Samples};
use crate::simd;
use std::sync::Mutex;

/// A view of a picture that can be rendered any number of times.
#[derive(Debug)]
#[doc(alias = "rasterizer")]
pub struct Renderer {
    view: View,
    filter: Filter,
    channels: Channels,
    blend: Blend,
    background: [f32; 4],
    splats: Splats,
    bins: Bins,
    /// Detail layer to add to the Gaussians.
    overlay: Option<Overlay>,
    /// Exact layer to draw over the rest.
    exact: Option<ExactOverlay>,
    /// Memory account for pixels.
    budget: Budget,
    backend: Dispatch,
    /// Working memory of tiles, one for each thread that has rendered in parallel.
    pool: Mutex<Vec<Scratch>>,
}

/// Background, channels and blend onto which the Gaussians of a picture are rendered.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Canvas {
    pub channels: Channels,
    pub blend: Blend,
    /// Encoded values.
    pub background: [f32; 4],
}

/// Colour under the detail layer when it is rendered alone: middle grey, as an encoded value.
const GREY: f32 = 0.5;

impl Canvas {
    /// Returns the canvas onto which `layers` are rendered, and how many of `count` Gaussians are rendered onto it.
    pub(crate) fn showing(mut self, layers: Layers, count: usize) -> (Self, usize) {
        if layers != Layers::Detail {
            return (self, count);
        }
        self.background = [GREY; 4];
        if let Some(alpha) = self.channels.alpha() {
            self.background[alpha] = 1.0;
        }
        (self, 0)
    }
}

/// Selects the instruction set; the output is the same for all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Dispatch {
    /// The best instruction set of the machine.
    Detected,
    /// The instruction set that the crate is compiled for; tests compare the two.
    #[cfg(test)]
    Compiled,
}

/// A tile to render: its band and column, and slices of the rows that it shows.
type Piece<'a, T> = (u32, u32, Vec<&'a mut [T]>);

/// Tiles of the view per tile of the layer along an axis. Each tile of the layer is computed once for the four tiles
/// of the view inside it.
const LAYER_TILE: u32 = (TILE / TILE_WIDTH) as u32;
/// Maximum number of row slices into which a band is cut at a time.
const MAX_SLICES: usize = 4096;
const _: () = assert!(TILE.is_multiple_of(TILE_WIDTH) && TILE_WIDTH == TILE_HEIGHT);

impl Renderer {
    /// Projects the Gaussians of `picture` that `view` shows, and sorts them into tiles. There is no detail layer;
    /// [`SsplatImage::renderer`](crate::SsplatImage::renderer) renders the one of a file.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`] if Gaussians, (Gaussian, tile) pairs, work or memory exceed `limits`; this is checked
    /// before memory is allocated. [`Error::Parameter`] if a Gaussian is not finite or has a scale of zero, or if a
    /// side of the view is 0 or over 2²⁰.
    pub fn new(picture: &Gaussians, view: &View, limits: &Limits) -> Result<Self> {
        let canvas = Canvas { channels: picture.channels, blend: picture.blend, background: picture.background };
        let (canvas, count) = canvas.showing(view.layers, picture.list.len());
        Renderer::of(&canvas, (count, |i| picture.list[i]), view, limits, &Budget::of(limits))
    }

    /// Returns a renderer of `count` Gaussians that are computed on demand, so that they need not all be in memory.
    pub(crate) fn of(
        canvas: &Canvas,
        (count, gaussian): (usize, impl Fn(usize) -> Gaussian + Sync + Send),
        view: &View,
        limits: &Limits,
        budget: &Budget,
    ) -> Result<Self> {
        if [view.width, view.height].iter().any(|&side| side == 0 || side > MAX_SIDE) {
            return Err(Error::Parameter {
                parameter: Parameter::View,
                problem: format!("{view:?} has a side outside 1..={MAX_SIDE}"),
            });
        }
        if !canvas.background.iter().all(|v| v.is_finite()) {
            return Err(Error::Parameter {
                parameter: Parameter::Background,
                problem: format!("{:?}", canvas.background),
            });
        }
        let filter = view.filter();
        let fine = view.refined(filter.parts);
        Limits::check(Limit::Gaussians, count as u64, limits.gaussians.min(u64::from(u32::MAX)))?;
        let splats = project((count, gaussian), &fine, filter.variance, budget)?;
        let bins = Bins::new(&splats, &fine, limits, budget)?;
        Ok(Renderer {
            view: *view,
            filter,
            channels: canvas.channels,
            blend: canvas.blend,
            background: canvas.background,
            splats,
            bins,
            overlay: None,
            exact: None,
            budget: budget.clone(),
            backend: Dispatch::Detected,
            pool: Mutex::new(Vec::new()),
        })
    }

    /// Adds a detail layer to the renderer.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`] if Gaussians and layer together take too much memory or work.
    pub(crate) fn with(mut self, overlay: Overlay, limits: &Limits) -> Result<Self> {
        let both = self.bins.work.saturating_add(overlay.work(&self.view, limits)?);
        Limits::check(Limit::Work, both, limits.work)?;
        let rows = (0..self.bands()).map(|band| self.band_rows(band).len() as u32).max().unwrap_or(0);
        let (stride, rows) = (self.stride(), rows.max(overlay.rows_at_once(self.stride()).min(self.view.height)));
        overlay.check(&self.view, stride, rows, &self.budget)?;
        self.overlay = Some(overlay);
        Ok(self)
    }

    /// Adds an exact layer to the renderer.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`] if drawing it takes too much memory or work.
    pub(crate) fn with_exact(mut self, exact: ExactOverlay, limits: &Limits) -> Result<Self> {
        exact.check(&self.view, limits, &self.budget)?;
        self.exact = Some(exact);
        Ok(self)
    }

    /// Returns the view to render.
    #[must_use]
    pub fn view(&self) -> &View {
        &self.view
    }

    /// Returns the channels of the output.
    #[must_use]
    pub fn channels(&self) -> Channels {
        self.channels
    }

    /// Returns the number of samples in a row of the output.
    #[must_use]
    pub fn row_len(&self) -> usize {
        self.view.width as usize * self.channels.count()
    }

    /// Returns the number of bands. A band is a row of tiles that the view touches.
    #[must_use]
    pub fn bands(&self) -> u32 {
        self.bins.tiles.count[1]
    }

    /// Returns the number of output columns and rows in a tile.
    fn tile(&self) -> [u32; 2] {
        [TILE_WIDTH as u32 / self.filter.parts[0], TILE_HEIGHT as u32 / self.filter.parts[1]]
    }

    /// Returns the number of output columns in all tiles of a band, including those that the view does not show.
    fn stride(&self) -> usize {
        self.bins.tiles.count[0] as usize * self.tile()[0] as usize
    }

    /// Returns the rows of the view in band `band`: 128, or fewer if the view is reduced. The first and the last band
    /// may have fewer.
    ///
    /// # Panics
    /// If `band` is not below [`Renderer::bands`].
    #[must_use]
    pub fn band_rows(&self, band: u32) -> std::ops::Range<u32> {
        assert!(band < self.bands(), "band {band} of {}", self.bands());
        let height = self.tile()[1];
        let tile = (self.bins.tiles.first[1] + band) * height;
        let end = tile + height.min(self.view.offset[1] + self.view.height - tile);
        tile.max(self.view.offset[1]) - self.view.offset[1]..end - self.view.offset[1]
    }

    /// Renders the consecutive bands `bands` into `out`: all of their rows, [`Renderer::row_len`] samples each.
    ///
    /// # Panics
    /// If `bands` is empty or exceeds [`Renderer::bands`], or if `out` does not have exactly that length.
    #[inline(always)]
    pub fn render_bands(&self, bands: std::ops::Range<u32>, out: SamplesMut<'_>) {
        match out {
            SamplesMut::U8(out) => self.draw(bands, out),
            SamplesMut::U16(out) => self.draw(bands, out),
        }
    }

    /// Renders the whole view.
    ///
    /// # Errors
    /// [`Error::LimitExceeded`] if the output would take more memory than the limits allow.
    pub fn render(&self, depth: Depth) -> Result<Pixels> {
        let samples = self.row_len() as u64 * u64::from(self.view.height);
        self.budget.check(samples * depth.bytes() as u64)?;
        let bands = 0..self.bands();
        let samples = match depth {
            Depth::Eight => {
                let mut out = vec![0u8; samples as usize];
                self.draw(bands, &mut out);
                Samples::U8(out)
            }
            Depth::Sixteen => {
                let mut out = vec![0u16; samples as usize];
                self.draw(bands, &mut out);
                Samples::U16(out)
            }
        };
        Pixels::new(self.view.width, self.view.height, self.channels, samples)
    }

    /// Renders the whole view into `out`, row by row with interleaved channels.
    ///
    /// # Panics
    /// If `out` does not have exactly [`Renderer::row_len`] × height samples.
    #[inline(always)]
    pub fn render_into(&self, out: SamplesMut<'_>) {
        self.render_bands(0..self.bands(), out);
    }

    /// Renders at a depth that is chosen at compile time, so that a program that uses one depth does not contain the
    /// kernels of the other.
    #[inline(never)]
    fn draw<T: Sample>(&self, bands: std::ops::Range<u32>, out: &mut [T]) {
        assert!(bands.start < bands.end, "no bands in {bands:?}");
        let rows = self.band_rows(bands.start).start..self.band_rows(bands.end - 1).end;
        let want = rows.len() * self.row_len();
        assert_eq!(out.len(), want, "samples for bands {bands:?}");
        let Some(exact) = &self.exact else {
            self.draw_below(bands, out);
            return;
        };
        if !exact.hides(&self.view, &rows) {
            self.draw_below(bands, out);
        }
        exact.draw(&self.view, rows, out);
    }

    /// Renders the Gaussians and the detail layer.
    fn draw_below<T: Sample>(&self, bands: std::ops::Range<u32>, mut out: &mut [T]) {
        let mut parts = Vec::with_capacity(bands.len());
        for band in bands {
            let (part, rest) = out.split_at_mut(self.band_rows(band).len() * self.row_len());
            parts.push((band, part));
            out = rest;
        }
        let Some(overlay) = &self.overlay else {
            self.draw_bands(parts, None);
            return;
        };
        let mut parts = parts.into_iter().peekable();
        if overlay.is_direct(&self.view) {
            let most = overlay.tile_rows_at_once(&self.view);
            let [first, count] = [self.bins.tiles.first, self.bins.tiles.count];
            let layer_row = |band: u32| (first[1] + band) / LAYER_TILE;
            let left = first[0] / LAYER_TILE;
            let columns = (first[0] + count[0]).div_ceil(LAYER_TILE) - left;
            while let Some(&(band, _)) = parts.peek() {
                let start = layer_row(band);
                let mut groups = Vec::new();
                while let Some(&(band, _)) = parts.peek()
                    && layer_row(band) - start < most
                {
                    // Group the pieces by tile of the layer.
                    let mut row: Vec<Vec<Piece<'_, T>>> = (0..columns).map(|_| Vec::new()).collect();
                    while let Some((band, part)) = parts.next_if(|part| layer_row(part.0) == layer_row(band)) {
                        let mut rows: Vec<&mut [T]> = part.chunks_exact_mut(self.row_len()).collect();
                        for piece in self.split(band, 0..count[0], &mut rows) {
                            row[((first[0] + piece.1) / LAYER_TILE - left) as usize].push(piece);
                        }
                    }
                    groups.extend(row);
                }
                self.draw_groups(groups, &|group| self.draw_within(group, overlay));
            }
            return;
        }
        // Process as many bands at a time as the budget for additions allows.
        let most = overlay.rows_at_once(self.stride());
        while let Some(first) = parts.next() {
            let mut rows = self.band_rows(first.0);
            let mut bands = vec![first];
            while let Some(part) = parts.next_if(|&(band, _)| self.band_rows(band).end - rows.start <= most) {
                rows.end = self.band_rows(part.0).end;
                bands.push(part);
            }
            // Additions cover the first tile's first column to the last tile's last column, so that strips of eight
            // may start anywhere.
            let width = self.tile()[0];
            let left = i64::from(self.bins.tiles.first[0] * width) - i64::from(self.view.offset[0]);
            let additions = overlay.additions(&self.view, left, self.stride(), rows);
            self.draw_bands(bands, Some(Source::Rows(&additions)));
            overlay.recycle_additions(additions);
        }
    }

    fn draw_bands<T: Sample>(&self, bands: Vec<(u32, &mut [T])>, source: Option<Source<'_>>) {
        parallel::map_each(bands.into_iter(), |_, band| self.draw_band(band, source));
    }

    /// Renders a band, some of its tiles at a time. For pictures with small tiles, the slices of all their rows
    /// together would take as much memory as the samples.
    fn draw_band<T: Sample>(&self, (band, part): (u32, &mut [T]), source: Option<Source<'_>>) {
        let mut rows: Vec<&mut [T]> = part.chunks_exact_mut(self.row_len()).collect();
        let tiles = 0..self.bins.tiles.count[0];
        for first in tiles.clone().step_by(MAX_SLICES / TILE_HEIGHT) {
            let some = first..(first + (MAX_SLICES / TILE_HEIGHT) as u32).min(tiles.end);
            self.draw_group(self.split(band, some, &mut rows), source);
        }
    }

    fn draw_groups<'a, T: Sample>(&self, groups: Vec<Vec<Piece<'a, T>>>, draw: &(impl Fn(Vec<Piece<'a, T>>) + Sync)) {
        parallel::map_each(groups.into_iter(), |_, group| draw(group));
    }

    /// Renders tiles that lie in one tile of the layer.
    fn draw_within<T: Sample>(&self, group: Vec<Piece<'_, T>>, overlay: &Overlay) {
        let (Some(first), Some(last)) = (group.first(), group.last()) else { return };
        let [column, row] = [first.1, first.0];
        let tile = [0, 1].map(|k| (self.bins.tiles.first[k] + [column, row][k]) / LAYER_TILE);
        let [left, top] = tile.map(|at| at * TILE as u32);
        let offset = self.view.offset;
        let (start, end) = (self.band_rows(first.0).start, self.band_rows(last.0).end);
        let rows = (offset[1] + start - top) as usize..(offset[1] + end - top) as usize;
        let columns =
            offset[0].saturating_sub(left) as usize..(offset[0] + self.view.width - left).min(TILE as u32) as usize;
        let planes = overlay.tile(tile.map(|at| at as usize), Supers::of(columns, rows));
        self.draw_group(group, planes.as_ref().map(Source::Tile));
        planes.into_iter().for_each(|planes| overlay.recycle_planes(planes));
    }

    fn draw_group<T: Sample>(&self, group: Vec<Piece<'_, T>>, source: Option<Source<'_>>) {
        parallel::map_each(group.into_iter(), |_, (band, column, mut rows)| {
            self.draw_tile((band, column), source, &mut rows);
        });
    }

    /// Returns the columns of the output within a tile that the view shows.
    fn columns(&self, column: u32) -> std::ops::Range<usize> {
        let width = self.tile()[0];
        let tile = (self.bins.tiles.first[0] + column) * width;
        let start = self.view.offset[0].max(tile) - tile;
        let end = width.min(self.view.offset[0] + self.view.width - tile);
        start as usize..end as usize
    }

    /// Splits the slices of the next tiles, whose columns are `tiles`, off the remaining rows of a band.
    fn split<'a, T>(&self, band: u32, tiles: std::ops::Range<u32>, rows: &mut [&'a mut [T]]) -> Vec<Piece<'a, T>> {
        let mut pieces: Vec<Piece<'a, T>> =
            tiles.map(|column| (band, column, Vec::with_capacity(rows.len()))).collect();
        for row in rows {
            for (_, column, piece) in &mut pieces {
                let (part, rest) =
                    std::mem::take(row).split_at_mut(self.columns(*column).len() * self.channels.count());
                piece.push(part);
                *row = rest;
            }
        }
        pieces
    }

    fn draw_tile<T: Sample>(&self, (band, column): (u32, u32), source: Option<Source<'_>>, out: &mut [&mut [T]]) {
        let (columns, rows) = (self.columns(column), self.band_rows(band));
        let [across, down] = self.filter.parts.map(|k| k as usize);
        let top = (self.bins.tiles.first[1] + band) * self.tile()[1];
        let in_tile = |row: u32| (row + self.view.offset[1] - top) as usize * down;
        let window = Window {
            corner: [
                f64::from(self.bins.tiles.first[0] + column) * TILE_WIDTH as f64,
                f64::from(self.bins.tiles.first[1] + band) * TILE_HEIGHT as f64,
            ],
            columns: columns.start * across..columns.end * across,
            rows: in_tile(rows.start)..in_tile(rows.end),
        };
        let scene = Drawing {
            splats: &self.splats,
            blend: self.blend,
            background: self.background,
            channels: self.channels.count(),
            parts: [across, down],
        };
        let added = source.map(|source| match source {
            Source::Rows(_) => Added { source, row: rows.start as usize, column: (column * self.tile()[0]) as usize },
            Source::Tile(_) => Added {
                source,
                row: (rows.start + self.view.offset[1]) as usize % TILE,
                column: (self.bins.tiles.first[0] + column) as usize * TILE_WIDTH % TILE,
            },
        });
        let members = self.bins.members(column, band);
        let mut scratch = self.pool.lock().expect("no tile panics").pop().unwrap_or_default();
        let job = Job { scene, members, window, scratch: &mut scratch, out, added };
        match self.backend {
            Dispatch::Detected => simd::dispatch(job),
            #[cfg(test)]
            Dispatch::Compiled => simd::Task::run(job, simd::Plain),
        }
        self.pool.lock().expect("no tile panics").push(scratch);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussian::Gaussian;

    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        let gaussians: Vec<Gaussian> = (0..1500u32)
            .map(|i| {
                let f = |k: u32| (f64::from(i) * f64::from(k).sqrt()).fract() as f32;
                Gaussian {
                    mean: [300.0 * f(2), 200.0 * f(3)],
                    scale: [0.25 + 30.0 * f(5), 0.25 + 9.0 * f(7) * f(11)],
                    rotation: 3.0 * f(13),
                    color: [f(17), 2.0 * f(19), f(23) - 0.5, f(29)],
                }
            })
            .collect();
        for (channels, blend) in [(Channels::Rgb, Blend::Normalized), (Channels::Rgba, Blend::Sum)] {
            let picture = Gaussians {
                width: 300,
                height: 200,
                channels,
                depth: Depth::Eight,
                blend,
                background: [0.5; 4],
                list: gaussians.clone(),
            };
            let full = View::new(picture.width, picture.height);
            for view in [full, full.resized(110, 35).unwrap(), full.resized(7, 5).unwrap()] {
                let mut renderer = Renderer::new(&picture, &view, &Limits::default()).unwrap();
                for depth in [Depth::Eight, Depth::Sixteen] {
                    renderer.backend = Dispatch::Detected;
                    let detected = renderer.render(depth).unwrap();
                    renderer.backend = Dispatch::Compiled;
                    assert_eq!(detected, renderer.render(depth).unwrap());
                }
            }
        }
    }
}
