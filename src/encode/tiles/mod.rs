//! One picture in tiles: each is fitted by itself, in memory that its own size bounds, and all become one file.
//!
//! Background, steps, weights and the price of a bit are those of the whole picture, so that the tiles fit together.
//! Each pass shifts tiles by half, so earlier seams fall in tile interiors. In the first pass each tile is fitted
//! alone, with a margin whose primitives are dropped. Later passes continue the same schedule while the primitives
//! around each tile stay fixed. Sweeps over the integers alternate between the two positions.

mod constant;
mod floats;
mod global;
mod grid;
mod integers;
mod mosaic;
mod narrow;
mod shrunk;
mod task;
mod wire;

use std::collections::VecDeque;
use std::sync::Arc;

use super::channels::widen;
use super::detail::divide::base_in_tiles;
use super::detail::layer_in_parts;
use super::detail::parts::Parts;
use super::device::Chosen;
use super::file;
use super::hidden::Continued;
use super::input::{self, may_leave_out, too_small};
use super::job::{decibels, enough, excess};
use super::rate_control::{count_for, size_asked};
use super::report::{Progress, ReportBuilder};
use super::skipped::SkipReason;
use super::thumbnail;
use super::workers::Executor;
use super::{DEFAULT_TILE_SIDE, EncodeReport, Encoded};
use crate::bitstream;
use crate::bitstream::detail::DetailLayer;
use crate::bitstream::splats::{Layout, Metadata, PackedGaussian, PackedSplats};
use crate::error::{Error, Result};
use crate::fit::model::drawing::project::{self, Primitive};
use crate::fit::model::problem::Scene;
use crate::fit::plan::fraction;
use crate::gaussian::Blend;
use crate::options::{Backend, EncodeOptions, Recipe, Trace};
use crate::parallel;
use crate::pixel_source::PixelSource;
use crate::quantize::Quantizer;
use crate::round::finish::SLOPE;
use crate::round::rounded;
use crate::round::size::{Correction, Size, correction, is_settled};
use crate::target::Target;
use floats::Show;
use global::{GlobalContext, Survey, TileSettings};
use grid::{Grid, Shift, UNIT, Window};
use mosaic::{Mosaic, Placed, TileResult};
use narrow::Narrowed;
use shrunk::Shrunk;
use task::{FloatWork, IntegerWork};
pub use wire::work_on_tile;
use wire::{PendingTile, WireFormat};

/// Sides that a tile may have, pixels; a multiple of the least.
pub(super) const TILE_SIDES: std::ops::RangeInclusive<u32> = 2 * UNIT..=1 << 14;
/// Width of the margin around a tile, in scales of a typical primitive.
const MARGIN_SCALES: f64 = 12.0;
/// Tiles that are worked on at a time, where there are as many threads. Each takes memory: tiles of a smaller side than the default's, which
/// are asked for to save it, are worked on one by one.
const MAX_CONCURRENT: usize = 4;
/// Share of the primitives that may change their tile at once.
const MAX_SWAPPED: f64 = 0.2;
/// Before so many sweeps the size is corrected.
const CORRECTED_SWEEPS: u32 = 3;
/// Sweeps that may be added to those planned, where the file is still not of its size.
const MAX_ADDED_SWEEPS: u32 = 2;
/// A file that is short of its size by less than this part of it is settled.
const SETTLED_PART: u64 = 200;
/// The steps follow from so many of the primitives: more would not change them.
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
    let continued = Continued::new(source, options.hidden, || report.show("survey", 0.0))?;
    if continued.is_some() {
        report.note(SkipReason::HiddenColors, 0, 0.0);
    }
    let source = continued.as_ref().map_or(source, |continued| continued as &dyn PixelSource);
    let blend = options.blend.unwrap_or(Blend::Normalized);
    let wide = input::empty(source.size(), (source.channels(), source.depth()), blend, options);
    let samples = samples_of(&wide);
    let fixed = bitstream::to_bytes(&wide)?.len() as u64;
    let asked = size_asked(options, samples, fixed);
    let room = match asked {
        Size::Bytes(most) => thumbnail::room(options, source.size(), most),
        Size::Free => 0,
    };
    let both = thumbnail::beside(asked, room);
    let size = match both {
        Size::Bytes(most) => {
            let [width, height] = source.size().map(u64::from);
            let shared = most.saturating_sub(fixed);
            base_in_tiles(options, width * height, samples, shared).map_or(both, |base| Size::Bytes(fixed + base))
        }
        Size::Free => both,
    };
    let has_layer = size != both;
    let count = initial_count(options, size, (samples, fixed)).map_err(|e| thumbnail::counted(e, asked, room))?;
    let scene = Scene { width: wide.width, height: wide.height, blend, background: [0.0; 4] };
    let grid = grid_of(&scene, count, side);
    let clock = report.seconds();
    let looked_at = if may_leave_out(options) { grid.windows() } else { Vec::new() };
    let (narrowed, left_out) = Narrowed::new(source, &looked_at, || report.show("survey", 0.0))?;
    if let Some(what) = left_out {
        report.note(what, 0, 0.0);
    }
    if !looked_at.is_empty()
        && let Some(encoded) = of_one_color((source, &narrowed), (options, asked), &wide, &looked_at, &mut report)?
    {
        return Ok(encoded);
    }
    let metadata = wide.metadata;
    let blank = PackedSplats { channels: narrowed.channels(), metadata: Metadata::default(), ..wide };
    let by = if has_layer { fraction(scene.pixels(), count) } else { 1 };
    let small = Shrunk::new(&narrowed, by, options.hidden);
    let [width, height] = small.size();
    let scene = Scene { width, height, ..scene };
    let blank = PackedSplats { width, height, ..blank };
    let settings = TileSettings {
        effort: options.effort,
        count,
        is_priced: matches!(size, Size::Bytes(_)),
        is_base: has_layer,
        enough: enough(options.target, blank.depth),
        seed: options.seed,
        hidden: options.hidden,
    };
    let survey = Survey { scene, blank, settings, tune: options.favoured() };
    let fitted_grid = grid_of(&scene, count, side);
    let global = survey.of(&small, &fitted_grid.windows(), |done| report.show("survey", done))?;
    report.stage("survey", clock);
    let seen: &dyn PixelSource = &narrowed;
    let mut session = TiledSession {
        options,
        source,
        seen,
        grid: fitted_grid,
        report,
        global,
        executor,
        metadata,
        asked,
        both,
        size,
        layer: None,
        fixed,
    };
    let look = |p: &Primitive| p.to_gaussian();
    let mut floats = Mosaic::new(&fitted_grid, &look);
    let error = session.fit(&mut floats)?;
    let mut floats: Vec<Primitive> = floats.all().map(|p| p.what).collect();
    if by > 1 {
        floats = project::zoomed(floats, by as f32);
        session = TiledSession { grid, global: session.global.at_size_of(seen), ..session };
    }
    session.finish(floats, error * f64::from(by).powi(2))
}

/// Returns the file of a picture of one colour, where that is what there is and the file may be as large; `wide` is the file
/// without primitives.
fn of_one_color(
    (source, narrowed): (&dyn PixelSource, &Narrowed<'_>),
    (options, asked): (&EncodeOptions, Size),
    wide: &PackedSplats,
    tiles: &[Window],
    report: &mut ReportBuilder<'_>,
) -> Result<Option<Encoded>> {
    if wide.blend != Blend::Normalized || options.target == Target::Primitives(0) {
        return Ok(None);
    }
    let Some(color) = constant::color(narrowed, tiles, |done| report.show("survey", done))? else { return Ok(None) };
    let blank = PackedSplats { channels: narrowed.channels(), ..wide.clone() };
    let (splats, error) = constant::stored(narrowed, &blank, (color, options.hidden), tiles)?;
    let bytes = bitstream::to_bytes(&widen(&splats, source.channels()))?;
    if matches!(asked, Size::Bytes(most) if bytes.len() as u64 > most) {
        return Ok(None);
    }
    report.note(SkipReason::Fit, 0, 0.0);
    let psnr = decibels(error, samples_of(&blank));
    let report = EncodeReport {
        primitives: splats.gaussians.len(),
        psnr,
        float_psnr: psnr,
        seconds: report.seconds(),
        skipped: std::mem::take(&mut report.skipped),
        chosen: Chosen::for_tiles(options.backend),
        ..EncodeReport::default()
    };
    Ok(Some(Encoded { bytes, report }))
}

/// Checks that what `options` ask for can be kept in tiles.
pub(super) fn check(options: &EncodeOptions) -> Result<()> {
    let bad = |problem: &str| Err(Error::Parameter { name: "tiles", problem: problem.into() });
    match options {
        o if o.recipe != Recipe::Ssplat => bad("another method's recipe cannot be fitted in tiles"),
        o if o.layout != Layout::Coded => bad("only the coded layout is written in tiles"),
        o if matches!(o.target, Target::Psnr(_)) => bad("a PSNR cannot be aimed at in tiles"),
        #[cfg(feature = "quality")]
        o if matches!(o.target, Target::Quality(_)) => bad("a quality cannot be aimed at in tiles"),
        o if o.time.is_some() => bad("a budget of time cannot be kept in tiles"),
        o if o.backend == Backend::Gpu => bad("tiles are fitted on the CPU"),
        o if o.trace == Trace::On => bad("a fit in tiles cannot be traced"),
        _ => Ok(()),
    }
}

/// Returns the tiles of `side` pixels for a picture of `count` primitives.
fn grid_of(scene: &Scene, count: usize, side: u32) -> Grid {
    let margin = (MARGIN_SCALES * f64::from(scene.typical_scale(count))) as u32;
    let margin = margin.next_multiple_of(UNIT).clamp(UNIT, side.max(UNIT));
    Grid { size: [scene.width, scene.height], half: side / 2, margin }
}

fn samples_of(blank: &PackedSplats) -> f64 {
    f64::from(blank.width) * f64::from(blank.height) * blank.channels.count() as f64
}

/// Returns the number of primitives that the fit begins with, for a file of `size` that takes `fixed` bytes without any.
fn initial_count(options: &EncodeOptions, size: Size, (samples, fixed): (f64, u64)) -> Result<usize> {
    match (size, options.target) {
        (Size::Bytes(most), _) => count_for(options, most, fixed, samples),
        (Size::Free, Target::Primitives(count)) => Ok(count as usize),
        (Size::Free, _) => Ok(0),
    }
}

/// An encode in tiles on its way.
struct TiledSession<'a, 'b, 'c> {
    grid: Grid,
    report: ReportBuilder<'a>,
    global: GlobalContext<'b>,
    executor: Executor<'c>,
    metadata: Metadata,
    options: &'b EncodeOptions,
    /// The picture with all its channels.
    source: &'b dyn PixelSource,
    /// The picture without its constant channels.
    seen: &'b dyn PixelSource,
    /// Size asked for.
    asked: Size,
    /// Size left without the thumbnail.
    both: Size,
    /// Size left without the thumbnail and the detail layer.
    size: Size,
    /// Detail layer over the Gaussians, once they are final.
    layer: Option<Arc<DetailLayer>>,
    /// Bytes of the file without primitives.
    fixed: u64,
}

/// A stage of an encode, and the part of it that is worked on.
#[derive(Clone, Copy)]
struct ProgressRange {
    stage: &'static str,
    from: f32,
    to: f32,
}

impl ProgressRange {
    /// The `part`th of `parts` that are as long.
    fn part(stage: &'static str, part: usize, parts: usize) -> Self {
        let [from, to] = [part, part + 1].map(|k| k as f32 / parts as f32);
        ProgressRange { stage, from, to }
    }

    fn at(&self, done: f32) -> f32 {
        self.from + (self.to - self.from) * done
    }
}

impl TiledSession<'_, '_, '_> {
    /// Has `work` done for every window of a pass in turns. Returns others that would help, and the squared error of all tiles.
    fn pass<T: WireFormat>(
        &mut self,
        (stretch, shift): (ProgressRange, Shift),
        work: T::Work,
        mosaic: &mut Mosaic<'_, T>,
    ) -> Result<(Vec<Placed<T>>, f64)> {
        let turns = self.grid.turns(shift);
        let count = turns.iter().map(Vec::len).sum::<usize>() as f32;
        let (mut others, mut error, mut through) = (Vec::new(), 0.0, 0);
        for turn in turns {
            let [from, to] = [through, through + turn.len()].map(|n| stretch.at(n as f32 / count));
            through += turn.len();
            let results = self.turn(ProgressRange { from, to, ..stretch }, &turn, work, mosaic)?;
            let mut placed = Vec::with_capacity(turn.len());
            for (window, result) in turn.iter().zip(results) {
                others.extend(result.others);
                error += result.error;
                placed.push((window.core, result.own));
            }
            mosaic.replace(placed);
        }
        Ok((others, error))
    }

    /// Has `work` done for windows that do not wait for each other; returns what came of it.
    fn turn<T: WireFormat>(
        &mut self,
        stretch: ProgressRange,
        windows: &[Window],
        work: T::Work,
        mosaic: &Mosaic<'_, T>,
    ) -> Result<Vec<TileResult<T>>> {
        let at_once = if 2 * self.grid.half < DEFAULT_TILE_SIDE { 1 } else { MAX_CONCURRENT };
        let TiledSession { report, global, executor, .. } = self;
        let mut show = |done: f32| report.show(stretch.stage, stretch.at(done / windows.len().max(1) as f32));
        show(0.0)?;
        let mut results = Vec::new();
        match executor {
            Executor::Own => {
                let arounds = windows.iter().map(|window| T::around(mosaic, window, work)).collect();
                let global = &*global;
                let work = |i: usize, around, tell: Show<'_>| {
                    let result = T::work(global, (&windows[i], work), around, tell)?;
                    tell(1.0)?;
                    Ok(result)
                };
                results = parallel::map_watched(at_once, arounds, work, &mut show)?;
            }
            Executor::Others(workers) => {
                let most = workers.capacity().max(1);
                let mut left = windows.iter();
                let mut out = VecDeque::new();
                loop {
                    for window in left.by_ref().take(most - out.len()) {
                        let around = T::around(mosaic, window, work);
                        let task = wire::task(global, (window, work), &around)?;
                        out.push_back(PendingTile::new(&task, window, T::most(work, around.own.len())));
                        workers.submit(task)?;
                    }
                    let Some(sent) = out.pop_front() else { break };
                    results.push(sent.answer(global, &workers.next()?)?);
                    show(results.len() as f32)?;
                }
            }
        }
        Ok(results)
    }

    /// Fits floats and puts them into `mosaic`; returns their squared error.
    fn fit(&mut self, mosaic: &mut Mosaic<'_, Primitive>) -> Result<f64> {
        let clock = self.report.seconds();
        let windows = self.grid.windows();
        // By itself no tile waits for another.
        let initial_count = self.turn(ProgressRange::part("fit", 0, 1), &windows, FloatWork::Begin, mosaic)?;
        let mut error = initial_count.iter().map(|b| b.error).sum();
        let mut others = Vec::new();
        let mut placed = Vec::with_capacity(windows.len());
        for (window, result) in windows.iter().zip(initial_count) {
            others.extend(result.others);
            placed.push((window.core, result.own));
        }
        mosaic.replace(placed);
        let have = mosaic.count();
        let wanted = match self.size {
            Size::Free => self.global.settings.count,
            Size::Bytes(most) => {
                let each = self.price(mosaic, error)?;
                let room = most as f64 * excess(have) - self.fixed as f64;
                ((room / each).max(0.0) as usize).min(2 * self.global.settings.count)
            }
        };
        mosaic.balance(others, wanted, (MAX_SWAPPED * have as f64) as usize);
        for (pass, (_, shift)) in floats::JOINED.iter().enumerate() {
            let stretch = ProgressRange::part("join", pass, floats::JOINED.len());
            (_, error) = self.pass((stretch, *shift), FloatWork::Join(pass), mosaic)?;
        }
        self.report.stage("fit", clock);
        Ok(error)
    }

    /// Returns the bytes that a primitive takes.
    fn price(&mut self, mosaic: &Mosaic<'_, Primitive>, error: f64) -> Result<f64> {
        let every = mosaic.count() / MAX_SAMPLED + 1;
        let some: Vec<Primitive> = mosaic.all().step_by(every).map(|p| p.what).collect();
        let quantizer = self.set_steps(&some, error);
        let blank = &mut self.global.blank;
        let fixed = bitstream::to_bytes(blank)?.len();
        blank.gaussians = mosaic.all().map(|p| quantizer.quantize(&p.what.to_gaussian())).collect();
        let bytes = bitstream::to_bytes(blank)?.len();
        blank.gaussians = Vec::new();
        Ok((bytes.saturating_sub(fixed) as f64 / mosaic.count().max(1) as f64).max(0.5))
    }

    /// Chooses the steps of the file for `some` of its primitives, whose squared error is `error`.
    fn set_steps(&mut self, some: &[Primitive], error: f64) -> Quantizer {
        let blank = &self.global.blank;
        let mut steps = rounded::steps(some, blank.layout, decibels(error, samples_of(blank)));
        // Parts begin at whole steps.
        let too_coarse = steps.coarsest - UNIT.ilog2() as i8;
        if too_coarse > 0 {
            (steps.coarsest, steps.range) = (steps.coarsest - too_coarse, steps.range - too_coarse as u8);
        }
        self.global.blank.steps = steps;
        let quantizer = self.global.blank.quantizer();
        self.global.blank.background = quantizer.quantize_color(self.global.scene.background);
        quantizer
    }

    /// Rounds `floats`, whose squared error is `error`, and brings them to the size that is asked for.
    fn finish(mut self, floats: Vec<Primitive>, error: f64) -> Result<Encoded> {
        let clock = self.report.seconds();
        let float_error = error;
        let some: Vec<Primitive> = floats.iter().copied().step_by(floats.len() / MAX_SAMPLED + 1).collect();
        let quantizer = self.set_steps(&some, error);
        let look = |p: &PackedGaussian| quantizer.dequantize(p);
        let mut mosaic = Mosaic::new(&self.grid, &look);
        for p in &floats {
            mosaic.insert(Placed { what: quantizer.quantize(&p.to_gaussian()), cost: 0.0 });
        }
        drop(floats);
        let sweeps = self.global.plan().sweeps.max(2);
        let mut bytes = self.write(&mosaic)?;
        let mut error = self.weighted_error(&mosaic)?;
        for round in 0..sweeps + MAX_ADDED_SWEEPS {
            let lambda = SLOPE * error / (8.0 * bytes.len() as f64);
            let shift = if round.is_multiple_of(2) { Shift::None } else { Shift::Half };
            let stretch = ProgressRange::part("finish", round as usize, (sweeps + MAX_ADDED_SWEEPS) as usize);
            let others;
            (others, error) = self.pass((stretch, shift), IntegerWork::Sweep(lambda), &mut mosaic)?;
            bytes = self.write(&mosaic)?;
            // The layer takes what its base leaves of the bytes, few or many.
            let (Size::Bytes(most), false) = (self.size, self.global.settings.is_base) else {
                if round + 1 == sweeps {
                    break;
                }
                continue;
            };
            let length = bytes.len() as u64;
            let is_settled = is_settled(length, most, SETTLED_PART);
            if round + 1 >= sweeps && (is_settled || length > most || round + 1 == sweeps + MAX_ADDED_SWEEPS) {
                break;
            }
            if round + 1 + CORRECTED_SWEEPS >= sweeps && !is_settled {
                let count = mosaic.count();
                let wanted = match correction(count, length.saturating_sub(self.fixed), length, most) {
                    Correction::Remove(cheapest) => count.saturating_sub(cheapest),
                    Correction::Add(more) => count + more,
                };
                mosaic.balance(others, wanted, 0);
                bytes = self.write(&mosaic)?;
            }
        }
        bytes = self.within(&mut mosaic, bytes)?;
        self.report.stage("finish", clock);
        bytes = self.with_layer(&mosaic, bytes)?;
        bytes = self.with_thumbnail(&mosaic, bytes)?;
        self.report(&mosaic, bytes, float_error)
    }

    /// Writes the file.
    fn write(&self, mosaic: &Mosaic<'_, PackedGaussian>) -> Result<Vec<u8>> {
        let mut splats = self.splats(mosaic);
        let bytes = file::smallest(&mut splats, self.options.levels)?;
        match (&self.layer, self.source.channels()) {
            (None, all) if all == splats.channels => Ok(bytes),
            (layer, _) => {
                splats.detail.clone_from(layer);
                input::file(&splats, self.source.channels())
            }
        }
    }

    /// Lays a detail layer over the Gaussians, where they were fitted for one; `bytes` is the file without it.
    fn with_layer(&mut self, mosaic: &Mosaic<'_, PackedGaussian>, bytes: Vec<u8>) -> Result<Vec<u8>> {
        let Size::Bytes(most) = self.both else { return Ok(bytes) };
        if self.both == self.size {
            return Ok(bytes);
        }
        let clock = self.report.seconds();
        let mut splats = self.splats(mosaic);
        file::smallest(&mut splats, self.options.levels)?;
        let (source, channels, tune) = (self.seen, self.source.channels(), self.options.favoured());
        let parts = Parts { source, splats: &splats, channels, tune, hidden: self.options.hidden };
        let file = |empty: &PackedSplats| input::file(empty, channels);
        self.layer = layer_in_parts(parts, most, file, &mut |done| self.report.show("detail", done))?;
        self.report.stage("detail", clock);
        if self.layer.is_some() { self.write(mosaic) } else { Ok(bytes) }
    }

    /// Returns what is fitted.
    fn splats(&self, mosaic: &Mosaic<'_, PackedGaussian>) -> PackedSplats {
        let gaussians = mosaic.all().map(|p| p.what).collect();
        PackedSplats { gaussians, metadata: self.metadata.clone(), ..self.global.blank.clone() }
    }

    /// Returns the file with its thumbnail, where it is to have one; `bytes` is that without.
    fn with_thumbnail(&mut self, mosaic: &Mosaic<'_, PackedGaussian>, bytes: Vec<u8>) -> Result<Vec<u8>> {
        let length = match self.asked {
            Size::Bytes(most) => most,
            Size::Free => bytes.len() as u64,
        };
        let most = thumbnail::room(self.options, self.source.size(), length);
        if most == 0 {
            return Ok(bytes);
        }
        let clock = self.report.seconds();
        let splats = widen(&self.splats(mosaic), self.source.channels());
        let progress = &mut *self.report.progress;
        let small = thumbnail::of(&splats, most, self.options, &mut |done| {
            progress(&Progress { stage: "thumbnail", done, psnr: None })
        })?;
        self.metadata.thumbnail = Some(small);
        self.report.stage("thumbnail", clock);
        self.write(mosaic)
    }

    /// Takes away what is too much.
    fn within(&self, mosaic: &mut Mosaic<'_, PackedGaussian>, mut bytes: Vec<u8>) -> Result<Vec<u8>> {
        let Size::Bytes(most) = self.both else { return Ok(bytes) };
        while bytes.len() as u64 > most {
            let count = mosaic.count();
            if count == 0 {
                return Err(too_small(self.options, most, bytes.len() as u64));
            }
            let each = (bytes.len() as f64 / count as f64).max(1.0);
            mosaic.remove_cheapest(((bytes.len() as u64 - most) as f64 / each).ceil() as usize);
            bytes = self.write(mosaic)?;
        }
        Ok(bytes)
    }

    fn weighted_error(&mut self, mosaic: &Mosaic<'_, PackedGaussian>) -> Result<f64> {
        let stretch = ProgressRange { stage: "finish", from: 0.0, to: 0.0 };
        Ok(self.turn(stretch, &self.grid.windows(), IntegerWork::Weigh, mosaic)?.iter().map(|b| b.error).sum())
    }

    fn report(mut self, mosaic: &Mosaic<'_, PackedGaussian>, bytes: Vec<u8>, float_error: f64) -> Result<Encoded> {
        let clock = self.report.seconds();
        if let Some(layer) = self.layer.take() {
            return self.report_of_layers(mosaic, bytes, layer, float_error);
        }
        let is_whole = self.source.channels() == self.global.blank.channels;
        let parts = if is_whole { 1 } else { 2 };
        let mut error = self.measured(ProgressRange::part("measure", 0, parts), mosaic)?;
        let mut float_error = float_error;
        if !is_whole {
            // The channels that were left out weigh as they do in the file.
            let wide = widen(&self.splats(mosaic), self.source.channels());
            (self.global.source, self.global.blank) =
                (self.source, PackedSplats { gaussians: Vec::new(), ..wide.clone() });
            let quantizer = self.global.blank.quantizer();
            let look = |p: &PackedGaussian| quantizer.dequantize(p);
            let mut all = Mosaic::new(&self.grid, &look);
            wide.gaussians.into_iter().for_each(|what| all.insert(Placed { what, cost: 0.0 }));
            let fitted = std::mem::replace(&mut error, self.measured(ProgressRange::part("measure", 1, parts), &all)?);
            float_error *= if fitted > 0.0 { error / fitted } else { 1.0 };
        }
        let samples = samples_of(&self.global.blank);
        self.report.stage("measure", clock);
        Ok(self.encoded(mosaic, bytes, [decibels(error, samples), decibels(float_error, samples)]))
    }

    /// The file and its report, with the PSNR of what is stored and of the floats.
    fn encoded(self, mosaic: &Mosaic<'_, PackedGaussian>, bytes: Vec<u8>, [psnr, float_psnr]: [f64; 2]) -> Encoded {
        let report = EncodeReport {
            primitives: mosaic.count(),
            psnr,
            float_psnr,
            seconds: self.report.seconds(),
            stages: self.report.stages,
            skipped: self.report.skipped,
            chosen: Chosen::for_tiles(self.options.backend),
            ..EncodeReport::default()
        };
        Encoded { bytes, report }
    }

    /// The report of a file with a layer.
    fn report_of_layers(
        mut self,
        mosaic: &Mosaic<'_, PackedGaussian>,
        bytes: Vec<u8>,
        layer: Arc<DetailLayer>,
        float_error: f64,
    ) -> Result<Encoded> {
        let clock = self.report.seconds();
        let (source, channels, tune) = (self.source, self.source.channels(), self.options.favoured());
        let mut splats = self.splats(mosaic);
        let fitted = samples_of(&splats);
        splats.detail = Some(layer);
        let splats = if splats.channels == channels { splats } else { widen(&splats, channels) };
        let parts = Parts { source, splats: &splats, channels, tune, hidden: self.options.hidden };
        let error = parts.error(&mut |done| self.report.show("measure", done))?;
        self.report.stage("measure", clock);
        Ok(self.encoded(mosaic, bytes, [decibels(error, samples_of(&splats)), decibels(float_error, fitted)]))
    }

    /// Returns the squared error of what is stored.
    fn measured(&mut self, stretch: ProgressRange, mosaic: &Mosaic<'_, PackedGaussian>) -> Result<f64> {
        let measured = self.turn(stretch, &self.grid.windows(), IntegerWork::Measure, mosaic)?;
        Ok(measured.iter().map(|b| b.error).sum())
    }
}
