//! The fit on the device: the steps of `fit`, with all data of the picture's size in the memory of the device.
//!
//! Rows are processed in bands, so that no binding exceeds 128 MiB: the target is stored in slabs of `slab_rows` rows,
//! and the planes of a step hold `band_rows` sampled rows. Both follow from the picture's size. If the lists of a band
//! overflow, the step is discarded, the lists grow or the bands shrink, and the step is repeated.

use super::device::Device;
use super::lists::{MAX_BINDING, check_primitives};
use super::peaks::Peaks;
use super::scene::{NO_ALPHA, Primitive, TILE, Uniforms, spaced};
use super::source::{Source, pack, rows_at_a_time, words};
use super::workspace::{BufferSizes, SLOT, SLOTS, Workspace};
use crate::constants::fit;
use crate::error::{GpuError, Result};
use crate::fit::engine::Engine;
use crate::fit::model::adam::{self, AdamMoments, Bounds, Rates};
use crate::fit::model::drawing::project;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::peaks::{self, Peak};
use crate::fit::model::placing::removal;
use crate::fit::model::problem::{Problem, Scene};
use crate::fit::state::{Progress, State};
use crate::gaussian::Channels;
use crate::pixels::Depth;
use crate::raster::View;

/// Steps per submission.
const BATCH: usize = 8;

/// Number of sampled pixels after which the commands are submitted, so that no driver considers a slow device hung.
const MAX_PIXELS: u64 = 1 << 24;

/// A fit on a device.
#[derive(Debug)]
pub(crate) struct Fitter {
    device: Device,
    base: Uniforms,
    source: Source,
    /// The picture at its own size, while the fit runs at half its size.
    whole: Option<Source>,
    /// Maximum size of a binding of picture-sized data, bytes.
    binding: u64,
    channels: Channels,
    depth: Depth,
    band_rows: u32,
    capacity: u32,
    /// Number of primitives, including those that do not move.
    count: u32,
    /// Number of primitives at the end that do not move.
    frozen: u32,
    primitives: wgpu::Buffer,
    first: wgpu::Buffer,
    second: wgpu::Buffer,
    workspace: Option<Workspace>,
    peaks: Option<Peaks>,
    /// Steps that are queued but not submitted yet.
    pending: Vec<(RowSet, Rates)>,
    /// Penalty for the size of primitives, based on the last known error: see [`adam::price`].
    price: f32,
    /// Whether the objective includes this penalty.
    is_priced: bool,
    /// Number of steps done.
    iteration: u32,
    /// The lowest error over all rows for the current number of primitives and size, and the primitives that had it.
    best: Option<(f64, wgpu::Buffer)>,
}

/// Rows of a step that are processed together: sampled rows `first .. first + rows`, all within one slab.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Band {
    slab: usize,
    first: u32,
    rows: u32,
}

/// Purpose of a pass over the whole picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Wanted {
    /// Only the error, over exactly the requested rows.
    Error,
    /// Also the removal costs and the residual cells.
    All,
}

/// Result of a pass over the whole picture.
#[derive(Debug)]
pub(super) struct Survey {
    /// Squared error over the rows that were visited.
    pub error: f64,
    /// Increase of the squared error when each primitive is removed.
    pub costs: Vec<f32>,
    /// The rows that were visited; they may be fewer than requested.
    rows: RowSet,
}

impl Fitter {
    /// Copies the picture, whose samples have `depth`, the weights of its errors and the state of its fit at full size
    /// to `device`, and continues the fit from there.
    ///
    /// # Errors
    /// [`Error::Gpu`] if the device fails or does not have enough memory.
    pub(crate) fn resuming(device: &Device, problem: &Problem<'_>, depth: Depth, state: &State) -> Result<Self> {
        let all = [&state.primitives[..], &state.frozen].concat();
        let mut fitter = Fitter::new(device, problem, depth, &all, &state.bounds)?;
        let Progress { moments, iteration, price, is_priced } = state.progress();
        (fitter.iteration, fitter.price, fitter.is_priced) = (iteration, price, is_priced);
        fitter.frozen = state.frozen.len() as u32;
        device.scoped(|| {
            let [first, second]: [Vec<_>; 2] = moments.iter().map(|m| (m.first, m.second)).unzip().into();
            device.write(&fitter.first, &first);
            device.write(&fitter.second, &second);
        })?;
        Ok(fitter)
    }

    /// Copies the picture and `primitives` to `device`, at the start of a fit.
    pub(super) fn new(
        device: &Device,
        problem: &Problem<'_>,
        depth: Depth,
        primitives: &[project::Primitive],
        bounds: &Bounds,
    ) -> Result<Self> {
        Fitter::within(device, problem, depth, primitives, bounds, MAX_BINDING)
    }

    /// Creates a fitter whose picture-sized buffers are divided into bindings of at most `binding` bytes.
    pub(super) fn within(
        device: &Device,
        problem: &Problem<'_>,
        depth: Depth,
        primitives: &[project::Primitive],
        bounds: &Bounds,
        binding: u64,
    ) -> Result<Self> {
        check_primitives(primitives.len() as u64)?;
        let Problem { scene, target } = problem;
        let (channels, words) = (target.channels, words(target, depth));
        let weighted = !target.amplitude.is_empty();
        let base = Uniforms {
            source_words: words,
            weighted: weighted.into(),
            channel_amplitude: target.channel_amplitude,
            // The channel that weights the errors of colours.
            alpha: target.opacity.map_or(NO_ALPHA, |a| a as u32),
            ..base(scene, channels, bounds)
        };
        let size = [scene.width, scene.height];
        let [slab_rows, band_rows] = rows_at_a_time(size[0], size[1], words, binding)?;
        let source = Source::new(device, size, slab_rows, |first, end| pack(target, depth, first, end))?;
        let count = primitives.len() as u32;
        let capacity = capacity_for(count);
        let [primitives, first, second] = upload(device, primitives, None)?;
        Ok(Fitter {
            device: device.clone(),
            base,
            source,
            whole: None,
            binding,
            channels,
            depth,
            band_rows,
            capacity,
            count,
            frozen: 0,
            primitives,
            first,
            second,
            workspace: None,
            peaks: None,
            pending: Vec::new(),
            price: 0.0,
            is_priced: true,
            iteration: 0,
            best: None,
        })
    }

    /// Returns the number of rows of a slab and of a band, and the number of pairs that the lists of a band hold.
    #[cfg_attr(not(any(test, feature = "unstable")), allow(dead_code, reason = "for tools"))]
    pub(super) fn sizes(&self) -> [u32; 3] {
        [self.source.slab_rows, self.band_rows, self.capacity]
    }

    /// Runs one step and returns its intermediate results, for tests.
    #[cfg(test)]
    pub(super) fn inspect<T>(
        &mut self,
        rows: RowSet,
        rates: Rates,
        look: impl FnOnce(&Device, &Workspace, &[&wgpu::Buffer; 3], Uniforms) -> T,
    ) -> Result<T> {
        self.prepare()?;
        let bands = self.bands(rows);
        assert_eq!(bands.len(), 1, "tests look at one band");
        self.submit(&[(rows, rates)])?;
        let workspace = self.workspace.as_ref().expect("prepared");
        let scene = self.uniforms(rows, rates, 0, &bands[0], 0);
        Ok(look(&self.device, workspace, &[&self.primitives, &self.first, &self.second], scene))
    }

    /// Runs a survey and returns its intermediate results, for tests.
    #[cfg(test)]
    pub(super) fn inspect_survey<T>(
        &mut self,
        rows: RowSet,
        look: impl FnOnce(&Device, &Workspace, &Survey, &Peaks) -> T,
    ) -> Result<T> {
        let survey = self.survey(rows, Wanted::All)?;
        let (workspace, peaks) = (self.workspace.as_ref(), self.peaks.as_ref());
        Ok(look(&self.device, workspace.expect("prepared"), &survey, peaks.expect("prepared")))
    }

    /// Sets the penalty for the size of primitives, for tests.
    #[cfg(test)]
    pub(super) fn set_price(&mut self, price: f32) {
        self.price = price;
    }

    /// Makes the lists shorter than necessary, for tests.
    #[cfg(test)]
    pub(super) fn limit_lists(&mut self, capacity: u32) {
        self.capacity = capacity;
    }

    /// Copies a target to the device.
    fn source_of(&self, target: &Planes) -> Result<Source> {
        let size = [target.width, target.height];
        let [slab_rows, _] = rows_at_a_time(size[0], size[1], self.base.source_words, self.binding)?;
        Source::new(&self.device, size, slab_rows, |first, end| pack(target, self.depth, first, end))
    }

    /// Switches to `scene`, which has the size of the source. Buffers of another size are dropped.
    fn set_scene(&mut self, scene: &Scene) -> Result<()> {
        let Uniforms { source_words, weighted, channel_amplitude, alpha, .. } = self.base;
        [_, self.band_rows] = rows_at_a_time(scene.width, scene.height, source_words, self.binding)?;
        let bounds = Bounds::new(scene.width, scene.height);
        self.base =
            Uniforms { source_words, weighted, channel_amplitude, alpha, ..base(scene, self.channels, &bounds) };
        self.workspace = None;
        self.peaks = None;
        Ok(())
    }

    /// Stores the current state if its error over all rows is the lowest so far.
    fn remember_if_best(&mut self) -> Result<()> {
        self.flush()?;
        if self.moving() == 0 {
            return Ok(());
        }
        let error = self.survey(RowSet::ALL, Wanted::Error)?.error;
        if self.best.as_ref().is_none_or(|b| error < b.0) {
            let (device, from) = (&self.device, &self.primitives);
            let size = u64::from(self.count) * size_of::<Primitive>() as u64;
            let copy = device.scoped(|| {
                let (d, queue) = device.wgpu();
                let copy = device.storage("best primitives", size);
                let mut encoder = d.create_command_encoder(&Default::default());
                encoder.copy_buffer_to_buffer(from, 0, &copy, 0, size);
                queue.submit([encoder.finish()]);
                copy
            })?;
            self.best = Some((error, copy));
        }
        Ok(())
    }

    /// Returns the bands of a step over `rows`.
    fn bands(&self, rows: RowSet) -> Vec<Band> {
        let mut bands = Vec::new();
        for (slab, s) in self.source.slabs.iter().enumerate() {
            let (mut first, end) = (rows.index(s.first) as u32, rows.index(s.end) as u32);
            while first < end {
                let rows = self.band_rows.min(end - first);
                bands.push(Band { slab, first, rows });
                first += rows;
            }
        }
        bands
    }

    /// Returns the uniforms of one band of the step that follows `ahead` others.
    fn uniforms(&self, rows: RowSet, rates: Rates, ahead: u32, band: &Band, tile_base: u64) -> Uniforms {
        let [correction_first, correction_second] = adam::corrections(rates.decay, self.iteration + ahead);
        Uniforms {
            rates: [rates.mean, rates.log_scale, rates.rotation, rates.color],
            decay: rates.decay,
            price: self.price / rows.step as f32,
            correction_first,
            correction_second,
            primitives: self.count,
            frozen: self.frozen,
            capacity: self.capacity,
            row_step: rows.step,
            row_phase: rows.phase,
            tile_base: tile_base as u32,
            source_first: self.source.slabs[band.slab].first,
            ..self.base.band(band.first, band.rows)
        }
    }

    /// Returns the uniforms of all bands of a step, each with mode 0 and with mode 1.
    fn slots(&self, rows: RowSet, rates: Rates, ahead: u32) -> Vec<Uniforms> {
        let mut tiles = 0;
        let mut slots = Vec::new();
        for band in self.bands(rows) {
            let u = self.uniforms(rows, rates, ahead, &band, tiles);
            tiles += u.tiles();
            slots.extend([u, Uniforms { mode: 1, ..u }]);
        }
        slots
    }

    /// Creates the buffers unless they exist.
    fn prepare(&mut self) -> Result<()> {
        if self.workspace.is_some() {
            return Ok(());
        }
        let tiles_x = u64::from(self.base.tiles_x);
        let tiles = |rows: u32| tiles_x * u64::from(rows.div_ceil(TILE));
        let sizes = BufferSizes {
            primitives: self.count.into(),
            capacity: self.capacity,
            pixels: u64::from(self.base.width) * u64::from(self.band_rows),
            band_tiles: tiles(self.band_rows),
            all_tiles: self.bands(RowSet::ALL).iter().map(|b| tiles(b.rows)).sum(),
        };
        let workspace =
            Workspace::new(&self.device, &self.source, [&self.primitives, &self.first, &self.second], &sizes)?;
        self.workspace = Some(workspace);
        Ok(())
    }

    /// Submits the pending steps.
    fn flush(&mut self) -> Result<()> {
        if self.moving() == 0 {
            self.pending.clear();
        }
        while !self.pending.is_empty() {
            self.prepare()?;
            let mut steps = Vec::new();
            let mut slots = 0;
            for &(rows, rates) in self.pending.iter().take(BATCH) {
                slots += 2 * self.bands(rows).len();
                if slots > SLOTS && !steps.is_empty() {
                    break;
                }
                steps.push((rows, rates));
            }
            self.submit(&steps)?;
            let [_, missing, taken, _] = self.workspace.as_ref().expect("prepared").lists.status(&self.device)?;
            self.iteration += taken;
            self.pending.drain(..taken as usize);
            if missing > 0 {
                self.grow_lists(missing)?;
            }
        }
        Ok(())
    }

    /// Submits `steps`.
    fn submit(&self, steps: &[(RowSet, Rates)]) -> Result<()> {
        let workspace = self.workspace.as_ref().expect("prepared");
        let (device, k, count) = (&self.device, self.device.kernels(), u64::from(self.count));
        let sets: Vec<Vec<Uniforms>> =
            steps.iter().enumerate().map(|(i, &(rows, rates))| self.slots(rows, rates, i as u32)).collect();
        device.scoped(|| {
            device.write(&workspace.uniforms, &spaced(&sets.concat()));
            let mut work = Work::new(device);
            work.encoder.clear_buffer(&workspace.lists.status, 0, None);
            let mut slot = 0;
            for (set, &(rows, _)) in sets.iter().zip(steps) {
                let start = slot;
                workspace.lists.project(k, &mut work.encoder, start, count);
                for (u, band) in set.chunks_exact(2).zip(self.bands(rows)) {
                    workspace.lists.fill(k, &mut work.encoder, slot, &u[0]);
                    let mut pass = work.encoder.begin_compute_pass(&Default::default());
                    k.forward.groups(&mut pass, &workspace.forward[band.slab], slot, u[0].tiles());
                    k.backward.each(&mut pass, &workspace.backward, slot, self.capacity.into());
                    k.gather.each(&mut pass, &workspace.gather, slot + u32::from(slot > start), count);
                    drop(pass);
                    slot += 2;
                    work.record_band(&u[0]);
                }
                let mut pass = work.encoder.begin_compute_pass(&Default::default());
                k.adam.each(&mut pass, &workspace.adam, start, self.moving().into());
            }
            work.submit();
        })
    }

    /// Makes the lists longer, or the bands lower if the lists have their maximum length. `missing` is the number of
    /// pairs of a band that did not fit, or a lower bound of it.
    fn grow_lists(&mut self, missing: u32) -> Result<()> {
        let most = (MAX_BINDING / SLOT) as u32;
        if self.capacity < most {
            self.capacity = self.capacity.saturating_mul(2).max(missing).min(most);
        } else if self.band_rows > TILE {
            self.band_rows = (self.band_rows / 2).next_multiple_of(TILE);
        } else {
            let what = "(Gaussian, tile) pairs in a row of tiles";
            return Err(GpuError::Overflow { what, requested: missing.into(), allowed: most.into() }.into());
        }
        self.workspace = None;
        self.peaks = None;
        Ok(())
    }

    /// Renders the picture over `rows`, and leaves the residual in the cells of `peaks`.
    fn survey(&mut self, mut rows: RowSet, wanted: Wanted) -> Result<Survey> {
        // Cells are as wide as the distance of the rows. If they do not fit into a binding, use coarser ones.
        while wanted == Wanted::All && Peaks::cells(&self.base, rows) > self.binding / 16 {
            rows.step += 1;
        }
        let still = Rates { mean: 0.0, log_scale: 0.0, rotation: 0.0, color: 0.0, decay: [0.9, 0.95] };
        loop {
            self.prepare()?;
            let workspace = self.workspace.as_ref().expect("prepared");
            if wanted == Wanted::All
                && self.peaks.as_ref().is_none_or(|p| p.capacity() < Peaks::cells(&self.base, rows))
            {
                let sources: Vec<&wgpu::Buffer> = self.source.slabs.iter().map(|s| &s.source).collect();
                self.peaks = Some(Peaks::new(&self.device, &self.base, rows, &sources, workspace)?);
            }
            let peaks = self.peaks.as_ref().filter(|_| wanted == Wanted::All);
            let (device, k, count) = (&self.device, self.device.kernels(), u64::from(self.count));
            let bands = self.bands(rows);
            let mut set = self.slots(rows, still, 0);
            for u in &mut set {
                u.cell = rows.step;
                u.cells_x = self.base.width.div_ceil(rows.step);
            }
            let tiles: u64 = set.iter().step_by(2).map(Uniforms::tiles).sum();
            if set.len() > SLOTS {
                let (requested, allowed) = (set.len() as u64 / 2, SLOTS as u64 / 2);
                return Err(GpuError::Overflow { what: "bands", requested, allowed }.into());
            }
            device.scoped(|| {
                device.write(&workspace.uniforms, &spaced(&set));
                let mut work = Work::new(device);
                work.encoder.clear_buffer(&workspace.lists.status, 0, None);
                workspace.lists.project(k, &mut work.encoder, 0, count);
                let mut slot = 0;
                for (u, band) in set.chunks_exact(2).zip(&bands) {
                    workspace.lists.fill(k, &mut work.encoder, slot, &u[0]);
                    let mut pass = work.encoder.begin_compute_pass(&Default::default());
                    k.forward.groups(&mut pass, &workspace.forward[band.slab], slot + 1, u[0].tiles());
                    if let Some(peaks) = peaks {
                        k.importance.each(&mut pass, &workspace.importance[band.slab], slot, self.capacity.into());
                        k.gather.each(&mut pass, &workspace.gather, slot + u32::from(slot > 0), count);
                        peaks.residual(k, &mut pass, band.slab, slot, &u[0]);
                    }
                    drop(pass);
                    slot += 2;
                    work.record_band(&u[0]);
                }
                work.submit();
            })?;
            let [_, missing, ..] = workspace.lists.status(device)?;
            if missing > 0 {
                self.grow_lists(missing)?;
                continue;
            }
            let error = workspace.error(device, tiles)?;
            let costs = match wanted {
                Wanted::Error => Vec::new(),
                Wanted::All => device.read_as(&workspace.moments, self.moving() as usize)?,
            };
            if wanted == Wanted::All && self.is_priced {
                self.price = adam::price(error, [self.base.width, self.base.height], rows, self.count as usize);
            }
            return Ok(Survey { error, costs, rows });
        }
    }

    /// Returns the best `count` peaks after a survey with a gain of at least `least`, for a picture of `among`
    /// primitives.
    fn best_peaks(&self, scene: &Scene, survey: &Survey, count: usize, among: usize, least: f32) -> Result<Vec<Peak>> {
        let spacing = peaks::spacing(scene, count, among);
        let search = self.peaks.as_ref().expect("surveyed");
        let candidates = search.find(&self.device, &self.base, survey.rows, spacing, least)?;
        Ok(peaks::best(candidates, count, scene))
    }

    /// Returns the number of primitives that move.
    fn moving(&self) -> u32 {
        self.count - self.frozen
    }

    /// Returns the first and second moments of the primitives that move.
    fn moments(&self) -> Result<[Vec<[f32; 9]>; 2]> {
        let read = |buffer| self.device.read_as::<[f32; 9]>(buffer, self.moving() as usize);
        Ok([read(&self.first)?, read(&self.second)?])
    }

    /// Returns all primitives, those that do not move last.
    fn download(&self) -> Result<Vec<project::Primitive>> {
        let read: Vec<Primitive> = self.device.read_as(&self.primitives, self.count as usize)?;
        Ok(read.into_iter().map(unpacked).collect())
    }
}

impl Engine for Fitter {
    /// The errors of steps arrive too late to save the states that had them.
    const REMEMBERS_WHOLE_STEPS: bool = false;

    fn count(&self) -> usize {
        self.moving() as usize
    }

    fn primitives(&mut self) -> Result<Vec<project::Primitive>> {
        self.flush()?;
        let mut primitives = self.download()?;
        primitives.truncate(self.moving() as usize);
        Ok(primitives)
    }

    fn settle(&mut self) -> Result<()> {
        self.flush()?;
        self.device.wait()
    }

    fn error(&mut self, whole: &Problem<'_>) -> Result<f64> {
        self.flush()?;
        let Some(source) = self.whole.take() else {
            return Ok(self.survey(RowSet::ALL, Wanted::Error)?.error);
        };
        // The steps use a smaller picture; replace it by the whole one for a single survey.
        let [width, height] = self.source.size;
        let half = Scene { width, height, ..whole.scene };
        let by = whole.scene.width.div_ceil(width) as f32;
        let zoomed = project::zoomed(self.download()?, by);
        let [zoomed, ..] = upload(&self.device, &zoomed, None)?;
        let primitives = std::mem::replace(&mut self.primitives, zoomed);
        let small = std::mem::replace(&mut self.source, source);
        let survey = self.set_scene(&whole.scene).and_then(|()| self.survey(RowSet::ALL, Wanted::Error));
        self.primitives = primitives;
        self.whole = Some(std::mem::replace(&mut self.source, small));
        self.set_scene(&half)?;
        Ok(survey?.error)
    }

    fn descend(&mut self, _: &Problem<'_>, rows: RowSet, rates: Rates) -> Result<Option<f64>> {
        self.pending.push((rows, rates));
        if self.pending.len() < BATCH {
            return Ok(None);
        }
        self.flush()?;
        let tiles: u64 = self.slots(rows, rates, 0).iter().step_by(2).map(Uniforms::tiles).sum();
        let workspace = self.workspace.as_ref().expect("prepared");
        Ok(Some(workspace.error(&self.device, tiles)?))
    }

    fn remember(&mut self, _: &Problem<'_>) -> Result<()> {
        self.remember_if_best()
    }

    fn relocate(&mut self, problem: &Problem<'_>, rows: RowSet, most: usize) -> Result<usize> {
        self.flush()?;
        if self.moving() == 0 {
            return Ok(0);
        }
        let survey = self.survey(rows, Wanted::All)?;
        let order = removal::cheapest(&survey.costs, most);
        let Some(&first) = order.first() else { return Ok(0) };
        let least = survey.costs[first];
        let mut moves: Vec<u32> = Vec::new();
        for (peak, i) in self.best_peaks(&problem.scene, &survey, most, self.count(), least)?.iter().zip(order) {
            if peak.gain < survey.costs[i] {
                break;
            }
            moves.push(i as u32);
            let [p] = [packed(&peaks::at_peak(peak, problem))];
            moves.extend(bytemuck::cast_slice::<_, u32>(std::slice::from_ref(&p)));
        }
        let count = (moves.len() / 10) as u32;
        let (device, k) = (&self.device, self.device.kernels());
        let workspace = self.workspace.as_ref().expect("prepared");
        device.scoped(|| {
            let (d, queue) = device.wgpu();
            let list = device.storage("moves", moves.len() as u64 * 4);
            device.write(&list, &moves);
            let u = Uniforms { primitives: self.count, capacity: count, ..self.base };
            device.write(&workspace.uniforms, &spaced(&[u]));
            let bound = k.relocate.bind(d, &workspace.uniforms, &[&list, &self.primitives, &self.first, &self.second]);
            let mut encoder = d.create_command_encoder(&Default::default());
            let mut pass = encoder.begin_compute_pass(&Default::default());
            k.relocate.each(&mut pass, &bound, 0, count.into());
            drop(pass);
            queue.submit([encoder.finish()]);
        })?;
        Ok(count as usize)
    }

    fn resize(&mut self, problem: &Problem<'_>, rows: RowSet, wanted: usize) -> Result<()> {
        self.flush()?;
        check_primitives(wanted as u64 + u64::from(self.frozen))?;
        let survey = self.survey(rows, Wanted::All)?;
        let have = self.count();
        if wanted == have {
            return Ok(());
        }
        self.best = None;
        let mut primitives = self.download()?;
        let frozen = primitives.split_off(have);
        let mut moments = self.moments()?;
        if wanted < have {
            let mut keep = vec![true; have];
            for i in removal::cheapest_first(&survey.costs).into_iter().take(have - wanted) {
                keep[i] = false;
            }
            primitives = kept(&primitives, &keep);
            moments = moments.map(|m| kept(&m, &keep));
        } else {
            let peaks = self.best_peaks(&problem.scene, &survey, wanted - have, wanted, 0.0)?;
            primitives.extend(peaks.iter().map(|peak| peaks::at_peak(peak, problem)));
        }
        primitives.extend(frozen);
        self.count = primitives.len() as u32;
        // Moments that are not given are zero.
        [self.primitives, self.first, self.second] = upload(&self.device, &primitives, Some(moments.each_ref()))?;
        self.capacity = self.capacity.max(capacity_for(self.count));
        self.workspace = None;
        self.peaks = None;
        Ok(())
    }

    fn keep_best(&mut self) -> Result<()> {
        self.flush()?;
        let Some((least, best)) = self.best.take() else { return Ok(()) };
        if self.survey(RowSet::ALL, Wanted::Error)?.error > fit::CLEARLY_WORSE * least {
            self.primitives = best;
            // The moments belong to the state that is dropped.
            let zeros = vec![[0.0f32; 9]; self.count as usize];
            self.device.scoped(|| [&self.first, &self.second].map(|moments| self.device.write(moments, &zeros)))?;
            self.iteration = 0;
            self.workspace = None;
            self.peaks = None;
        }
        Ok(())
    }

    fn zoom(&mut self, problem: &Problem<'_>, by: f32) -> Result<()> {
        let Problem { scene, target } = problem;
        self.flush()?;
        self.best = None;
        let size = [scene.width, scene.height];
        let source = match self.whole.take().filter(|s| s.size == size) {
            Some(whole) => whole,
            None => self.source_of(target)?,
        };
        let before = std::mem::replace(&mut self.source, source);
        self.whole = (by < 1.0).then_some(before);
        let bounds = Bounds::new(scene.width, scene.height);
        let mut primitives = project::zoomed(self.download()?, by);
        primitives[..self.count()].iter_mut().for_each(|p| bounds.apply(p));
        [self.primitives, self.first, self.second] = upload(&self.device, &primitives, None)?;
        self.set_scene(scene)
    }

    fn reweigh(&mut self, problem: &Problem<'_>) -> Result<()> {
        self.flush()?;
        (self.best, self.whole) = (None, None);
        self.source = self.source_of(problem.target)?;
        // Both are bound to the previous source.
        (self.workspace, self.peaks) = (None, None);
        Ok(())
    }

    fn finish(mut self) -> Result<State> {
        self.flush()?;
        let mut primitives = self.download()?;
        let frozen = primitives.split_off(self.count());
        let [first, second] = self.moments()?;
        let moments = first.into_iter().zip(second).map(|(first, second)| AdamMoments { first, second }).collect();
        let Fitter { iteration, price, is_priced, .. } = self;
        let progress = Progress { moments, iteration, price, is_priced };
        let bounds = Bounds::new(self.base.width, self.base.height);
        Ok(State::resumed(primitives, frozen, bounds, progress))
    }
}

/// Commands that are submitted in parts.
struct Work<'a> {
    device: &'a Device,
    encoder: wgpu::CommandEncoder,
    pixels: u64,
}

impl<'a> Work<'a> {
    fn new(device: &'a Device) -> Self {
        let encoder = device.wgpu().0.create_command_encoder(&Default::default());
        Work { device, encoder, pixels: 0 }
    }

    /// Records that the commands of a band are complete.
    fn record_band(&mut self, band: &Uniforms) {
        self.pixels += u64::from(band.width) * u64::from(band.band_rows);
        if self.pixels > MAX_PIXELS {
            self.pixels = 0;
            let next = self.device.wgpu().0.create_command_encoder(&Default::default());
            self.device.wgpu().1.submit([std::mem::replace(&mut self.encoder, next).finish()]);
        }
    }

    fn submit(self) {
        self.device.wgpu().1.submit([self.encoder.finish()]);
    }
}

/// Returns the uniforms that are the same in all steps.
fn base(scene: &Scene, channels: Channels, bounds: &Bounds) -> Uniforms {
    let view = View::new(scene.width, scene.height);
    Uniforms {
        min_log_scale: bounds.min_log_scale,
        max_log_scale: bounds.max_log_scale,
        max_log_aspect: bounds.max_log_aspect,
        ..Uniforms::new(&view, scene.blend, channels, scene.background, 0)
    }
}

/// Returns the initial capacity of the lists in pairs: that of fitted pictures, with a margin.
fn capacity_for(count: u32) -> u32 {
    count.saturating_mul(24).max(1 << 14).min((MAX_BINDING / SLOT) as u32)
}

fn kept<T: Copy>(all: &[T], keep: &[bool]) -> Vec<T> {
    all.iter().zip(keep).filter(|(_, k)| **k).map(|(v, _)| *v).collect()
}

/// Copies the primitives to the device, with buffers for the first and second moments of their gradients.
fn upload(
    device: &Device,
    primitives: &[project::Primitive],
    memory: Option<[&Vec<[f32; 9]>; 2]>,
) -> Result<[wgpu::Buffer; 3]> {
    let bytes = primitives.len() as u64 * size_of::<Primitive>() as u64;
    let primitives: Vec<Primitive> = primitives.iter().map(packed).collect();
    device.scoped(|| {
        // New buffers contain zeros.
        let buffers = ["primitives", "first moments", "second moments"].map(|name| device.storage(name, bytes));
        device.write(&buffers[0], &primitives);
        if let Some([first, second]) = memory {
            device.write(&buffers[1], first);
            device.write(&buffers[2], second);
        }
        buffers
    })
}

pub(super) fn packed(p: &project::Primitive) -> Primitive {
    Primitive { mean: p.mean, log_scale: p.log_scale, rotation: p.rotation, color: p.color }
}

fn unpacked(p: Primitive) -> project::Primitive {
    project::Primitive { mean: p.mean, log_scale: p.log_scale, rotation: p.rotation, color: p.color }
}
