//! Fits Gaussians in tiles: passes over the tiles, in turns of tiles that do not depend on each other.

use std::collections::VecDeque;
use std::time::Duration;

use super::DEFAULT_TILE_SIDE;
use super::floats::{self, OnProgress};
use super::global::{GlobalContext, Survey, TileSettings};
use super::grid::{Grid, Shift, UNIT, Window};
use super::mosaic::{Mosaic, Placed, TileResult};
use super::picture::TiledPicture;
use super::shrunk::Shrunk;
use super::task::FloatWork;
use super::wire::{self, PendingTile, WireFormat};
use crate::bitstream;
use crate::bitstream::splats::PackedSplats;
use crate::constants::tiles;
use crate::encode::fit_whole::sufficient_error;
use crate::encode::primitive_count::{bytes_per_primitive, count_in};
use crate::encode::state::{FitRequest, decibels};
use crate::encode::workers::Executor;
use crate::error::Result;
use crate::fit::model::drawing::project::{self, Primitive};
use crate::fit::model::problem::Scene;
use crate::fit::plan::reduction;
use crate::instant::Instant;
use crate::parallel;
use crate::pixel_source::PixelSource;
use crate::quantize::Quantizer;
use crate::rdo::rounded;
use crate::rdo::size::Size;

/// Maximum number of tiles that are processed at a time, if there are as many threads. Each tile takes memory. Callers
/// choose tiles smaller than the default to save memory, so these are processed one by one.
const MAX_CONCURRENT: usize = 4;

/// Returns the layout of tiles of `side` pixels for a picture of `count` primitives.
fn grid_of(scene: &Scene, count: usize, side: u32) -> Grid {
    let margin = (tiles::MARGIN_SCALES * f64::from(scene.typical_scale(count))) as u32;
    let margin = margin.next_multiple_of(UNIT).clamp(UNIT, side.max(UNIT));
    Grid { size: [scene.width, scene.height], half: side / 2, margin }
}

fn samples_of(blank: &PackedSplats) -> f64 {
    f64::from(blank.width) * f64::from(blank.height) * blank.channels.count() as f64
}

/// A fit of Gaussians in tiles, or their rounding to integers.
pub(super) struct TiledFit<'s, 'a, 'g> {
    pub picture: &'s mut TiledPicture<'a>,
    pub grid: Grid,
    pub global: GlobalContext<'g>,
    /// Requested size of the file with the Gaussians alone.
    pub size: Size,
    /// Bytes of the file without primitives.
    pub fixed: u64,
    /// Time at which the file should be complete.
    pub until: Option<Instant>,
}

/// Gaussians that were fitted in tiles.
pub(in crate::encode) struct FittedTiles<'a> {
    pub(super) primitives: Vec<Primitive>,
    /// Their squared error.
    pub(super) error: f64,
    pub(super) grid: Grid,
    pub(super) global: GlobalContext<'a>,
    /// Time at which the file should be complete.
    pub(super) until: Option<Instant>,
}

/// Fits about `count` Gaussians to `picture`.
pub(in crate::encode) fn fit<'a>(
    picture: &mut TiledPicture<'a>,
    count: usize,
    request: &FitRequest,
) -> Result<FittedTiles<'a>> {
    let clock = picture.state.report.seconds();
    let has_layer = request.under_layer.is_some();
    let (options, fitted_source, device) = (picture.state.options, picture.fitted_source, picture.state.device);
    let fixed = picture.state.fixed()?;
    let blank = picture.state.blank.clone();
    let scene = Scene { width: blank.width, height: blank.height, blend: blank.blend, background: [0.0; 4] };
    let by = if has_layer { reduction(&picture.state.settings.fit.base.reduction, scene.pixels(), count) } else { 1 };
    let small = Shrunk::new(fitted_source, by, options.hidden);
    let grid = grid_of(&scene, count, picture.side);
    let [width, height] = small.size();
    let scene = Scene { width, height, ..scene };
    let blank = PackedSplats { width, height, ..blank };
    let settings = TileSettings {
        effort: options.effort,
        count,
        is_priced: matches!(request.size, Size::Bytes(_)),
        is_base: has_layer,
        sufficient_error: sufficient_error(options.target, blank.depth),
        seed: options.seed,
        hidden: options.hidden,
        seconds: None,
    };
    let survey = Survey { scene, blank, settings, tune: options.favoured() };
    let fitted_grid = grid_of(&scene, count, picture.side);
    let report = &mut picture.state.report;
    let on_progress = |done| report.stage_progress("survey", done);
    let global = survey.of((&small, device), &fitted_grid.windows(), on_progress)?;
    report.stage("survey", clock);
    let until = request.time.or(picture.state.clock.left()).and_then(|time| Instant::now().checked_add(time));
    let mut fit = TiledFit { picture, grid: fitted_grid, global, size: request.size, fixed, until };
    let to_gaussian = |p: &Primitive| p.to_gaussian();
    let mut mosaic = Mosaic::new(&fitted_grid, &to_gaussian);
    let error = fit.fit(&mut mosaic)?;
    let global = fit.global.at_size_of(fitted_source, device);
    let mut primitives: Vec<Primitive> = mosaic.all().map(|p| p.primitive).collect();
    if by > 1 {
        primitives = project::zoomed(primitives, by as f32);
    }
    Ok(FittedTiles { primitives, error: error * f64::from(by).powi(2), grid, global, until })
}

/// A stage of an encode, and the part of it that is in progress.
#[derive(Clone, Copy)]
pub(super) struct ProgressRange {
    pub stage: &'static str,
    pub from: f32,
    pub to: f32,
}

impl ProgressRange {
    /// Returns part `part`, counted from 0, of `parts` equal parts.
    pub(super) fn part(stage: &'static str, part: usize, parts: usize) -> Self {
        let [from, to] = [part, part + 1].map(|k| k as f32 / parts as f32);
        ProgressRange { stage, from, to }
    }

    fn at(&self, done: f32) -> f32 {
        self.from + (self.to - self.from) * done
    }
}

impl TiledFit<'_, '_, '_> {
    /// Runs `work` on every window of a pass, one turn at a time. Returns candidate primitives, and the squared error
    /// of all tiles.
    pub(super) fn pass<T: WireFormat>(
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
    pub(super) fn turn<T: WireFormat>(
        &mut self,
        stretch: ProgressRange,
        windows: &[Window],
        work: T::Work,
        mosaic: &Mosaic<'_, T>,
    ) -> Result<Vec<TileResult<T>>> {
        let concurrency = self.concurrent();
        let TiledFit { picture, global, .. } = self;
        let TiledPicture { state, executor, .. } = &mut **picture;
        let report = &mut state.report;
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
        let clock = self.picture.state.report.seconds();
        let windows = self.grid.windows();
        let time = self.until.map(|end| end.saturating_duration_since(Instant::now()).mul_f64(tiles::FIT_TIME_SHARE));
        let mut last = tiles::ALONE_SHARE;
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
        let have = mosaic.count();
        let wanted = match self.size {
            Size::Free => self.global.settings.count,
            Size::Bytes(max_bytes) => {
                let each = self.price(mosaic, error)?;
                count_in(max_bytes, self.fixed as f64, each, have).min(2 * self.global.settings.count)
            }
        };
        mosaic.balance(&mut candidates, wanted, (tiles::MAX_SWAPPED_SHARE * have as f64) as usize);
        for (pass, (to, shift)) in floats::JOINED.iter().enumerate() {
            self.give_time(time.map(|time| time.mul_f32(to - last)), windows.len());
            last = *to;
            let stretch = ProgressRange::part("join", pass, floats::JOINED.len());
            (_, error) = self.pass((stretch, *shift), FloatWork::Join(pass), mosaic)?;
        }
        self.picture.state.report.stage("fit", clock);
        Ok(error)
    }

    /// Sets the time limit for the work on one window, given the `time` for all `windows` of a pass.
    fn give_time(&mut self, time: Option<Duration>, windows: usize) {
        let concurrency = match &self.picture.executor {
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

    /// Returns the average number of bytes per primitive in the file.
    fn price(&mut self, mosaic: &Mosaic<'_, Primitive>, error: f64) -> Result<f64> {
        let every = mosaic.count() / tiles::MAX_SAMPLED_PRIMITIVES + 1;
        let some: Vec<Primitive> = mosaic.all().step_by(every).map(|p| p.primitive).collect();
        let quantizer = self.set_steps(&some, error);
        let blank = &mut self.global.blank;
        let fixed = bitstream::to_bytes(blank)?.len();
        blank.gaussians = mosaic.all().map(|p| quantizer.quantize(&p.primitive.to_gaussian())).collect();
        let bytes = bitstream::to_bytes(blank)?.len();
        blank.gaussians = Vec::new();
        Ok(bytes_per_primitive(bytes.saturating_sub(fixed) as f64, mosaic.count()))
    }

    /// Chooses the step sizes of the file, given a sample of its primitives and the squared error of all. Returns its
    /// quantizer.
    pub(super) fn set_steps(&mut self, some: &[Primitive], error: f64) -> Quantizer {
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
