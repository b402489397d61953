//! Encodes a picture in tiles. Each tile is fitted separately, in memory bounded by the size of a tile, and all tiles
//! are written to one file.
//!
//! Background, step sizes, weights and the price of a bit are those of the whole picture, so that the tiles match each
//! other. Passes alternate between two positions of the tiles, half a tile apart, so that the seams of one pass lie in
//! the interiors of the next. In the first pass, each tile is fitted alone, with a margin whose primitives are dropped.
//! Later passes continue the same schedule, while the primitives around each tile stay fixed. Sweeps over the integers
//! alternate between the two positions as well.

mod constant;
mod floats;
mod global;
mod grid;
mod integers;
mod mosaic;
mod narrow;
mod rounding;
mod shrunk;
mod task;
mod wire;

use std::collections::VecDeque;
use std::time::Duration;

use super::clock::Clock;
use super::constant::{constant, is_possible};
use super::device::{Choice, Chosen};
use super::drawn::drawn_part;
use super::hidden::InpaintedSource;
use super::input::{self, may_leave_out};
use super::job::{excess, sufficient_error};
use super::layer::divide::{base_time, is_search};
use super::layer::division::base_without_texture;
use super::layer::layered_in_parts;
use super::layer::parts::error_between;
use super::pipeline::run;
use super::rate_control::count_for;
use super::report::ReportBuilder;
use super::session::{EncodeSession, KeptBase, Outcome, decibels};
use super::skipped::SkipReason;
use super::workers::Executor;
use super::{DEFAULT_TILE_SIDE, Encoded};
use crate::bitstream;
use crate::bitstream::splats::PackedSplats;
use crate::error::{Error, Result};
use crate::fit::model::drawing::project::{self, Primitive};
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::problem::Scene;
use crate::fit::plan::fraction;
use crate::gaussian::{Blend, Channels};
use crate::instant::Instant;
use crate::options::{Detail, EncodeOptions, Recipe};
use crate::parallel;
use crate::parameter::Parameter;
use crate::pixel_source::PixelSource;
use crate::pixels::Depth;
use crate::quantize::Quantizer;
use crate::round::rounded;
use crate::round::size::Size;
#[cfg(feature = "quality-hook")]
use crate::ssimulacra2::ssimulacra2;
use crate::used_range::UsedRange;
use floats::OnProgress;
use global::{GlobalContext, Survey, TileSettings};
use grid::{Grid, Shift, UNIT, Window};
use mosaic::{Mosaic, Placed, TileResult};
use narrow::Narrowed;
use shrunk::Shrunk;
use task::FloatWork;
pub use wire::work_on_tile;
use wire::{PendingTile, WireFormat};

/// Valid sides of a tile, pixels. Each is a multiple of the smallest.
pub(super) const TILE_SIDES: std::ops::RangeInclusive<u32> = 2 * UNIT..=1 << 14;
/// Width of the margin around a tile, in multiples of the scale of a typical primitive.
const MARGIN_SCALES: f64 = 12.0;
/// Maximum number of tiles that are processed at a time, if there are as many threads. Each tile takes memory. Callers
/// choose tiles smaller than the default to save memory, so these are processed one by one.
const MAX_CONCURRENT: usize = 4;
/// Maximum fraction of the primitives that are replaced by candidates, possibly in other tiles, at once.
const MAX_SWAPPED: f64 = 0.2;
/// Fraction of the time for Gaussians that their float fit may use.
const FIT_TIME: f64 = 0.7;
/// Maximum fraction of a file for Gaussians that are kept from an earlier try of a search.
const MAX_KEPT: f64 = 0.9;
/// Maximum number of primitives from which the step sizes are derived. More primitives would not change them.
const MAX_SAMPLED: usize = 1 << 20;

/// Encodes the picture of `source` in tiles of `side` pixels.
pub(super) fn encode(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    side: u32,
    executor: Executor<'_>,
    mut report: ReportBuilder<'_>,
) -> Result<Encoded> {
    check(options)?;
    let clock = Clock::new(options.time);
    let device = &Choice::for_tiles(options, source.size(), &executor)?;
    let start = report.seconds();
    let inpainted = InpaintedSource::new(source, options.hidden, || report.stage_progress("survey", 0.0))?;
    if inpainted.is_some() {
        report.note(SkipReason::HiddenColors, 0, 0.0);
    }
    let source = inpainted.as_ref().map_or(source, |inpainted| inpainted as &dyn PixelSource);
    let windows = Grid { size: source.size(), half: side / 2, margin: UNIT }.windows();
    let surveyed = if may_leave_out(options) { &windows[..] } else { &[] };
    let (narrowed, left_out) = Narrowed::new(source, surveyed, || report.stage_progress("survey", 0.0))?;
    if let Some(reason) = left_out {
        report.note(reason, 0, 0.0);
    }
    let blend = options.blend.unwrap_or(Blend::Normalized);
    let may_be_flat = is_possible(options, blend) && narrowed.channels().alpha().is_none();
    let range = if may_be_flat && options.detail != Detail::Off {
        narrow_range(&narrowed, &windows, || report.stage_progress("survey", 0.0))?
    } else {
        None
    };
    let flat_color = match range {
        Some(range) => {
            report.note(SkipReason::Contrasts { levels: range.levels() }, 0, 0.0);
            Some(constant::mean(&narrowed, &windows, || report.stage_progress("survey", 0.0))?)
        }
        None => None,
    };
    report.stage("survey", start);
    let blank = input::empty(source.size(), (narrowed.channels(), source.depth()), blend, options);
    let kept = None;
    let fitted_source = &narrowed;
    run(TiledSession {
        options,
        source,
        fitted_source,
        device,
        side,
        blank,
        windows,
        flat_color,
        executor,
        clock,
        report,
        kept,
    })
}

/// Returns the range of the samples of `source` if it is narrow. Reads `tiles`, which together cover the picture, and
/// calls `on_progress` for each of them.
fn narrow_range(
    source: &dyn PixelSource,
    tiles: &[Window],
    mut on_progress: impl FnMut() -> Result<()>,
) -> Result<Option<UsedRange>> {
    let mut range: Option<UsedRange> = None;
    if source.depth() == Depth::Eight {
        return Ok(None);
    }
    for tile in tiles {
        on_progress()?;
        let Some(found) = UsedRange::of(&source.part(tile.core.bounds())?) else { continue };
        range = Some(range.map_or(found, |range| range.and(found)));
        if range.and_then(UsedRange::if_narrow).is_none() {
            return Ok(None);
        }
    }
    Ok(range)
}

/// Returns an error if `options` ask for something that tiles do not support.
pub(super) fn check(options: &EncodeOptions) -> Result<()> {
    let bad = |problem: &str| Err(Error::Parameter { parameter: Parameter::Tiles, problem: problem.into() });
    match options {
        o if o.recipe != Recipe::Ssplat => bad("another method's recipe cannot be fitted in tiles"),
        _ => Ok(()),
    }
}

/// Returns the layout of tiles of `side` pixels for a picture of `count` primitives.
fn grid_of(scene: &Scene, count: usize, side: u32) -> Grid {
    let margin = (MARGIN_SCALES * f64::from(scene.typical_scale(count))) as u32;
    let margin = margin.next_multiple_of(UNIT).clamp(UNIT, side.max(UNIT));
    Grid { size: [scene.width, scene.height], half: side / 2, margin }
}

fn samples_of(blank: &PackedSplats) -> f64 {
    f64::from(blank.width) * f64::from(blank.height) * blank.channels.count() as f64
}

/// State of an encode in tiles.
struct TiledSession<'a, 'b, 'c> {
    options: &'b EncodeOptions,
    /// The picture with all its channels.
    source: &'b dyn PixelSource,
    /// The picture without its constant channels.
    fitted_source: &'b dyn PixelSource,
    /// The device that fits the tiles.
    device: &'b Choice,
    /// Side of the tiles, pixels.
    side: u32,
    /// The file of the picture in `fitted_source`, without primitives.
    blank: PackedSplats,
    /// The tiles. The picture is also measured tile by tile.
    windows: Vec<Window>,
    /// The mean colour, if the range of the samples is so narrow that the picture is this colour with a detail layer.
    flat_color: Option<[f32; 4]>,
    executor: Executor<'c>,
    clock: Clock,
    report: ReportBuilder<'a>,
    /// Gaussians under a detail layer from an earlier try of a search.
    kept: Option<KeptBase>,
}

impl<'a> EncodeSession<'a> for TiledSession<'a, '_, '_> {
    fn options(&self) -> &EncodeOptions {
        self.options
    }

    fn clock(&mut self) -> &mut Clock {
        &mut self.clock
    }

    fn report(&mut self) -> &mut ReportBuilder<'a> {
        &mut self.report
    }

    fn chosen(&self) -> Chosen {
        self.device.chosen().clone()
    }

    fn channels(&self) -> Channels {
        self.source.channels()
    }

    fn blank(&self) -> &PackedSplats {
        &self.blank
    }

    fn constant(&mut self) -> Result<Option<PackedSplats>> {
        let report = &mut self.report;
        let color = constant::color(self.fitted_source, &self.windows, |done| report.stage_progress("survey", done))?;
        Ok(color.map(|color| {
            let mut splats = self.blank.clone();
            constant(&mut splats, color);
            splats
        }))
    }

    fn at_size(&mut self, size: Size, share: Option<Duration>) -> Result<Outcome> {
        let Size::Bytes(max_bytes) = size else { return self.gaussians(0, [size; 2], share) };
        if let Some(color) = self.flat_color {
            let mut splats = self.blank.clone();
            constant(&mut splats, color);
            let base = self.flat_base(splats, max_bytes)?;
            return layered_in_parts(self, self.fitted_source, base, max_bytes);
        }
        let fixed = self.fixed()?;
        let area = self.fitted_source.size().map(u64::from).iter().product();
        let Some(budget) = base_without_texture(self.options, area, self.samples(), max_bytes.saturating_sub(fixed))
        else {
            let count = count_for(self.options, max_bytes, fixed, self.samples())?;
            return self.gaussians(count, [size; 2], share);
        };
        let until = share.or(self.clock.left()).and_then(|time| Instant::now().checked_add(time));
        let room = (MAX_KEPT * max_bytes as f64).floor();
        let base = match self.kept.as_ref().and_then(|kept| kept.for_budget(budget as f64, room)) {
            Some(base) => base,
            None => {
                let count = count_for(self.options, fixed + budget, fixed, self.samples())?;
                let time = base_time(self.options.effort, until);
                let base = self.gaussians(count, [Size::Bytes(fixed + budget), size], time)?;
                if is_search(self.options.target) {
                    self.kept = Some(KeptBase { base: base.clone(), base_budget: budget as f64 });
                }
                base
            }
        };
        let clock = self.report.seconds();
        let outcome = layered_in_parts(self, self.fitted_source, base, max_bytes)?;
        self.report.stage("detail", clock);
        Ok(outcome)
    }

    fn at_count(&mut self, count: usize) -> Result<Outcome> {
        self.gaussians(count, [Size::Free; 2], None)
    }

    fn fitted_error(&mut self, splats: &PackedSplats) -> Result<f64> {
        self.measured(self.fitted_source, splats)
    }

    fn error(&mut self, splats: &PackedSplats) -> Result<f64> {
        let wide = self.widened(splats);
        self.measured(self.source, &wide)
    }

    fn trace_end(&mut self, splats: &PackedSplats, error: f64) -> Result<()> {
        if self.report.tracer.is_on() {
            let start = Instant::now();
            let psnr = decibels(error, self.samples());
            self.report.tracer.add("written", psnr, splats.gaussians.len(), start);
        }
        Ok(())
    }

    /// Scores large pictures tile by tile. Returns the mean of the scores, weighted by the number of pixels.
    #[cfg(feature = "quality-hook")]
    fn score(&mut self, splats: &PackedSplats) -> Result<f64> {
        let wide = self.widened(splats);
        let (mut sum, mut area) = (0.0, 0.0);
        for (i, window) in self.windows.iter().enumerate() {
            self.report.stage_progress("measure", i as f32 / self.windows.len() as f32)?;
            let core = &window.core;
            let drawn = drawn_part(&wide, core.bounds(), wide.depth)?;
            let score = ssimulacra2(&self.source.part(core.bounds())?, &drawn)?;
            (sum, area) = (sum + score * core.pixels(), area + core.pixels());
        }
        Ok(sum / area)
    }
}

impl TiledSession<'_, '_, '_> {
    /// Returns the squared error of the stored picture against `source`, which has the same channels.
    fn measured(&mut self, source: &dyn PixelSource, splats: &PackedSplats) -> Result<f64> {
        let clock = self.report.seconds();
        let report = &mut self.report;
        let on_progress = &mut |done| report.stage_progress("measure", done);
        let error = squared_error(source, &self.windows, splats, on_progress)?;
        self.report.stage("measure", clock);
        Ok(error)
    }

    /// Fits about `count` Gaussians and rounds them to a file of `size`. If a detail layer follows, `limit` differs
    /// from `size`, and the file may have any size up to `limit`. The fit may take `time`.
    fn gaussians(&mut self, count: usize, [size, limit]: [Size; 2], time: Option<Duration>) -> Result<Outcome> {
        let clock = self.report.seconds();
        let has_layer = size != limit;
        let (options, fitted_source) = (self.options, self.fitted_source);
        let fixed = self.fixed()?;
        let blank = self.blank.clone();
        let scene = Scene { width: blank.width, height: blank.height, blend: blank.blend, background: [0.0; 4] };
        let by = if has_layer { fraction(scene.pixels(), count) } else { 1 };
        let small = Shrunk::new(fitted_source, by, options.hidden);
        let grid = grid_of(&scene, count, self.side);
        let [width, height] = small.size();
        let scene = Scene { width, height, ..scene };
        let blank = PackedSplats { width, height, ..blank };
        let settings = TileSettings {
            effort: options.effort,
            count,
            is_priced: matches!(size, Size::Bytes(_)),
            is_base: has_layer,
            sufficient_error: sufficient_error(options.target, blank.depth),
            seed: options.seed,
            hidden: options.hidden,
            seconds: None,
        };
        let survey = Survey { scene, blank, settings, tune: options.favoured() };
        let fitted_grid = grid_of(&scene, count, self.side);
        let report = &mut self.report;
        let on_progress = |done| report.stage_progress("survey", done);
        let global = survey.of((&small, self.device), &fitted_grid.windows(), on_progress)?;
        report.stage("survey", clock);
        let until = time.or(self.clock.left()).and_then(|time| Instant::now().checked_add(time));
        let mut fit = TiledFit { session: self, grid: fitted_grid, global, size, limit, fixed, until };
        let to_gaussian = |p: &Primitive| p.to_gaussian();
        let mut floats = Mosaic::new(&fitted_grid, &to_gaussian);
        let error = fit.fit(&mut floats)?;
        let mut floats: Vec<Primitive> = floats.all().map(|p| p.primitive).collect();
        if by > 1 {
            floats = project::zoomed(floats, by as f32);
            fit = TiledFit { grid, global: fit.global.at_size_of(fitted_source), ..fit };
        }
        fit.round(floats, error * f64::from(by).powi(2))
    }
}

/// Returns the squared error between a picture that is read in parts and the stored picture, weighted as
/// [`metrics::psnr`](crate::metrics::psnr) does.
fn squared_error(
    source: &dyn PixelSource,
    parts: &[Window],
    splats: &PackedSplats,
    on_progress: OnProgress<'_>,
) -> Result<f64> {
    let mut error = 0.0;
    for (i, part) in parts.iter().enumerate() {
        on_progress(i as f32 / parts.len() as f32)?;
        let area = part.core.bounds();
        let wanted = Planes::new(&source.part(area)?);
        // The rounding error of 16 bits is smaller than any error worth reporting.
        error += error_between(&wanted, &Planes::new(&drawn_part(splats, area, Depth::Sixteen)?));
    }
    Ok(error)
}

/// A fit of Gaussians in tiles, and their rounding to integers.
struct TiledFit<'s, 'a, 'b, 'c, 'g> {
    session: &'s mut TiledSession<'a, 'b, 'c>,
    grid: Grid,
    global: GlobalContext<'g>,
    /// Requested size of the file with the Gaussians alone.
    size: Size,
    /// Size that the file must not exceed.
    limit: Size,
    /// Bytes of the file without primitives.
    fixed: u64,
    /// Time at which the file should be complete.
    until: Option<Instant>,
}

/// A stage of an encode, and the part of it that is in progress.
#[derive(Clone, Copy)]
struct ProgressRange {
    stage: &'static str,
    from: f32,
    to: f32,
}

impl ProgressRange {
    /// Returns part `part`, counted from 0, of `parts` equal parts.
    fn part(stage: &'static str, part: usize, parts: usize) -> Self {
        let [from, to] = [part, part + 1].map(|k| k as f32 / parts as f32);
        ProgressRange { stage, from, to }
    }

    fn at(&self, done: f32) -> f32 {
        self.from + (self.to - self.from) * done
    }
}

impl TiledFit<'_, '_, '_, '_, '_> {
    /// Runs `work` on every window of a pass, one turn at a time. Returns candidate primitives, and the squared error
    /// of all tiles.
    fn pass<T: WireFormat>(
        &mut self,
        (stretch, shift): (ProgressRange, Shift),
        work: T::Work,
        mosaic: &mut Mosaic<'_, T>,
    ) -> Result<(Vec<Placed<T>>, f64)> {
        let turns = self.grid.turns(shift);
        let count = turns.iter().map(Vec::len).sum::<usize>() as f32;
        let (mut candidates, mut error, mut through) = (Vec::new(), 0.0, 0);
        for turn in turns {
            let [from, to] = [through, through + turn.len()].map(|n| stretch.at(n as f32 / count));
            through += turn.len();
            let results = self.turn(ProgressRange { from, to, ..stretch }, &turn, work, mosaic)?;
            let mut placed = Vec::with_capacity(turn.len());
            for (window, result) in turn.iter().zip(results) {
                candidates.extend(result.candidates);
                error += result.error;
                placed.push((window.core, result.own));
            }
            mosaic.replace(placed);
        }
        Ok((candidates, error))
    }

    /// Runs `work` on windows that do not depend on each other, and returns the results.
    fn turn<T: WireFormat>(
        &mut self,
        stretch: ProgressRange,
        windows: &[Window],
        work: T::Work,
        mosaic: &Mosaic<'_, T>,
    ) -> Result<Vec<TileResult<T>>> {
        let concurrency = self.concurrent();
        let TiledFit { session, global, .. } = self;
        let TiledSession { report, executor, .. } = &mut **session;
        let mut on_progress =
            |done: f32| report.stage_progress(stretch.stage, stretch.at(done / windows.len().max(1) as f32));
        on_progress(0.0)?;
        let mut results = Vec::new();
        match executor {
            Executor::Own => {
                let inputs = windows.iter().map(|window| T::window_primitives(mosaic, window, work)).collect();
                let global = &*global;
                let work = |i: usize, primitives, on_tile_progress: OnProgress<'_>| {
                    let result = T::work(global, (&windows[i], work), primitives, on_tile_progress)?;
                    on_tile_progress(1.0)?;
                    Ok(result)
                };
                results = parallel::map_watched(concurrency, inputs, work, &mut on_progress)?;
            }
            Executor::External(workers) => {
                let capacity = workers.capacity().max(1);
                let mut left = windows.iter();
                let mut out = VecDeque::new();
                loop {
                    for window in left.by_ref().take(capacity - out.len()) {
                        let primitives = T::window_primitives(mosaic, window, work);
                        let task = wire::task(global, (window, work), &primitives)?;
                        out.push_back(PendingTile::new(&task, window, T::max_primitives(work, primitives.own.len())));
                        workers.submit(task)?;
                    }
                    let Some(pending) = out.pop_front() else { break };
                    results.push(pending.answer(global, &workers.receive()?)?);
                    on_progress(results.len() as f32)?;
                }
            }
        }
        Ok(results)
    }

    /// Fits floats and puts them into `mosaic`. Returns their squared error.
    fn fit(&mut self, mosaic: &mut Mosaic<'_, Primitive>) -> Result<f64> {
        let clock = self.session.report.seconds();
        let windows = self.grid.windows();
        let time = self.until.map(|end| end.saturating_duration_since(Instant::now()).mul_f64(FIT_TIME));
        let mut last = floats::ALONE;
        self.give_time(time.map(|time| time.mul_f32(last)), windows.len());
        // In the first pass, no tile depends on another.
        let initial_count = self.turn(ProgressRange::part("fit", 0, 1), &windows, FloatWork::Begin, mosaic)?;
        let mut error = initial_count.iter().map(|b| b.error).sum();
        let mut candidates = Vec::new();
        let mut placed = Vec::with_capacity(windows.len());
        for (window, result) in windows.iter().zip(initial_count) {
            candidates.extend(result.candidates);
            placed.push((window.core, result.own));
        }
        mosaic.replace(placed);
        self.trace_floats("fit", mosaic, error)?;
        let have = mosaic.count();
        let wanted = match self.size {
            Size::Free => self.global.settings.count,
            Size::Bytes(max_bytes) => {
                let each = self.price(mosaic, error)?;
                let room = max_bytes as f64 * excess(have) - self.fixed as f64;
                ((room / each).max(0.0) as usize).min(2 * self.global.settings.count)
            }
        };
        mosaic.balance(&mut candidates, wanted, (MAX_SWAPPED * have as f64) as usize);
        for (pass, (to, shift)) in floats::JOINED.iter().enumerate() {
            self.give_time(time.map(|time| time.mul_f32(to - last)), windows.len());
            last = *to;
            let stretch = ProgressRange::part("join", pass, floats::JOINED.len());
            (_, error) = self.pass((stretch, *shift), FloatWork::Join(pass), mosaic)?;
            self.trace_floats("join", mosaic, error)?;
        }
        self.session.report.stage("fit", clock);
        Ok(error)
    }

    /// Sets the time limit for the work on one window, given the `time` for all `windows` of a pass.
    fn give_time(&mut self, time: Option<Duration>, windows: usize) {
        let concurrency = match &self.session.executor {
            Executor::Own => self.concurrent().min(parallel::threads()),
            Executor::External(workers) => workers.capacity(),
        };
        let turns = windows.div_ceil(concurrency.max(1)).max(1);
        self.global.settings.seconds = time.map(|time| time.as_secs_f64() / turns as f64);
    }

    /// Returns the number of windows that the encoder's own threads process at a time.
    fn concurrent(&self) -> usize {
        if 2 * self.grid.half < DEFAULT_TILE_SIDE { 1 } else { MAX_CONCURRENT }
    }

    /// Adds a point to the trace: the floats in `mosaic`, whose squared error is `error`, rounded to the nearest
    /// integers.
    fn trace_floats(&mut self, stage: &'static str, mosaic: &Mosaic<'_, Primitive>, error: f64) -> Result<()> {
        if !self.session.report.tracer.is_on() {
            return Ok(());
        }
        let PackedSplats { steps, background, .. } = self.global.blank;
        let all: Vec<Primitive> = mosaic.all().map(|p| p.primitive).collect();
        let quantizer = self.set_steps(&all, error);
        let gaussians = all.iter().map(|p| quantizer.quantize(&p.to_gaussian())).collect();
        let splats = PackedSplats { gaussians, ..self.global.blank.clone() };
        (self.global.blank.steps, self.global.blank.background) = (steps, background);
        self.trace(stage, &splats)
    }

    /// Adds a point to the trace if tracing is on.
    fn trace(&mut self, stage: &'static str, splats: &PackedSplats) -> Result<()> {
        if !self.session.report.tracer.is_on() {
            return Ok(());
        }
        let start = Instant::now();
        let error = squared_error(self.global.source, &self.grid.windows(), splats, &mut |_| Ok(()))?;
        let psnr = decibels(error, samples_of(splats));
        self.session.report.tracer.add(stage, psnr, splats.gaussians.len(), start);
        Ok(())
    }

    /// Returns the average number of bytes per primitive in the file.
    fn price(&mut self, mosaic: &Mosaic<'_, Primitive>, error: f64) -> Result<f64> {
        let every = mosaic.count() / MAX_SAMPLED + 1;
        let some: Vec<Primitive> = mosaic.all().step_by(every).map(|p| p.primitive).collect();
        let quantizer = self.set_steps(&some, error);
        let blank = &mut self.global.blank;
        let fixed = bitstream::to_bytes(blank)?.len();
        blank.gaussians = mosaic.all().map(|p| quantizer.quantize(&p.primitive.to_gaussian())).collect();
        let bytes = bitstream::to_bytes(blank)?.len();
        blank.gaussians = Vec::new();
        Ok((bytes.saturating_sub(fixed) as f64 / mosaic.count().max(1) as f64).max(0.5))
    }

    /// Chooses the step sizes of the file, given a sample of its primitives and the squared error of all. Returns its
    /// quantizer.
    fn set_steps(&mut self, some: &[Primitive], error: f64) -> Quantizer {
        let blank = &self.global.blank;
        let mut steps = rounded::steps(some, blank.layout, decibels(error, samples_of(blank)));
        // The corners of windows must be multiples of the coarsest step.
        let too_coarse = steps.coarsest - UNIT.ilog2() as i8;
        if too_coarse > 0 {
            (steps.coarsest, steps.range) = (steps.coarsest - too_coarse, steps.range - too_coarse as u8);
        }
        self.global.blank.steps = steps;
        let quantizer = self.global.blank.quantizer();
        self.global.blank.background = quantizer.quantize_color(self.global.scene.background);
        quantizer
    }
}
