//! One picture in tiles: each is fitted by itself, in memory that its own size bounds, and all become one file.
//!
//! Background, steps, weights and the price of a bit are the whole picture's, so that the tiles fit together. What keeps
//! seams away is that the tiles of one pass have the seams of the pass before inside: tiles begin their fit by themselves,
//! with a margin whose primitives are dropped; those of a second pass, half a tile further, go on with the same schedule
//! among what lies around them, and sweeps over the integers take turns with both.

mod floats;
mod grid;
mod integers;
mod mosaic;
mod whole;

use super::aim;
use super::file;
use super::job::{decibels, enough, excess};
use super::report::Journal;
use super::subject;
use super::{EncodeReport, Encoded};
use crate::bitstream;
use crate::bitstream::splats::{Layout, PackedGaussian, PackedSplats};
use crate::error::{Error, Result};
use crate::fit::model::problem::Scene;
use crate::fit::model::project::Primitive;
use crate::fit::plan::Plan;
use crate::gaussian::Blend;
use crate::options::{Backend, EncodeOptions, Recipe, Target, Thumbnail, Trace};
use crate::pixel_source::PixelSource;
use crate::quantize::Quantizer;
use crate::round::finish::SLOPE;
use crate::round::rounded;
use crate::round::size::Size;
use grid::{Grid, Shift, UNIT, Window};
use integers::Part;
use mosaic::{Mosaic, Placed};
use whole::Whole;

/// Sides that a tile may have, pixels; a multiple of the least.
pub(super) const SIDES: std::ops::RangeInclusive<u32> = 2 * UNIT..=1 << 14;
/// What is seen around a tile, in scales of a typical primitive.
const MARGIN: f64 = 12.0;
/// Share of the primitives that may change their tile at once.
const SWAPPED: f64 = 0.2;
/// Before so many sweeps the size is corrected.
const CORRECTED: u32 = 3;
/// Sweeps that may be added to those planned, where the file is still not of its size.
const MORE_SWEEPS: u32 = 2;
/// A file that is short of its size by less than this part of it is settled.
const SETTLED: u64 = 200;
/// The steps follow from so many of the primitives: more would not change them.
const SAMPLED: usize = 1 << 20;
/// Share of the room that is filled with new primitives.
const FILLED: f64 = 0.97;

/// Encodes the picture of `source` in tiles of `side` pixels.
pub(super) fn encode(
    source: &dyn PixelSource,
    options: &EncodeOptions,
    side: u32,
    journal: Journal<'_>,
) -> Result<Encoded> {
    check(options)?;
    let blend = options.blend.unwrap_or(Blend::Normalized);
    let blank = subject::empty(source.size(), (source.channels(), source.depth()), blend, options);
    let samples = blank_samples(&blank);
    let fixed = bitstream::to_bytes(&blank)?.len() as u64;
    let (size, count) = aimed(options, samples, fixed)?;
    let scene = Scene { width: blank.width, height: blank.height, blend, background: [0.0; 4] };
    let area = u64::from(blank.width) * u64::from(blank.height);
    let mut plan = Plan::new(options.effort, count, area, None, options.seed);
    plan.enough = enough(options.target, blank.depth);
    let typical = f64::from(scene.typical_scale(count));
    let margin = ((MARGIN * typical) as u32).next_multiple_of(UNIT).clamp(UNIT, side.max(UNIT));
    let grid = Grid { size: [blank.width, blank.height], half: side / 2, margin };
    let mut course = Course { grid, journal, blank, size, fixed, samples };
    let clock = course.journal.seconds();
    let tiles: Vec<Window> = grid.turns(Shift::None).concat();
    let file = (scene, course.blank.clone(), matches!(size, Size::Bytes(_)));
    let whole = Whole::survey(source, file, (plan, count, options.favoured()), &tiles, |done| {
        course.journal.show("survey", done)
    })?;
    course.journal.stage("survey", clock);
    let look = |p: &Primitive| p.to_gaussian();
    let mut floats = Mosaic::new(&grid, &look);
    let error = course.fit(&whole, &mut floats)?;
    course.finish(&whole, floats, error, options.levels)
}

fn check(options: &EncodeOptions) -> Result<()> {
    let bad = |problem: &str| Err(Error::Parameter { name: "tiles", problem: problem.into() });
    match options {
        o if o.recipe != Recipe::Ssplat => bad("another method's recipe cannot be fitted in tiles"),
        o if o.layout != Layout::Coded => bad("only the coded layout is written in tiles"),
        o if matches!(o.target, Target::Psnr(_)) => bad("a PSNR cannot be aimed at in tiles"),
        o if o.time.is_some() => bad("a budget of time cannot be kept in tiles"),
        o if o.backend == Backend::Gpu => bad("tiles are fitted on the CPU"),
        o if matches!(o.thumbnail, Thumbnail::Bytes(_)) => bad("a file of tiles carries no thumbnail"),
        o if o.trace == Trace::On => bad("a fit in tiles cannot be traced"),
        _ => Ok(()),
    }
}

fn blank_samples(blank: &PackedSplats) -> f64 {
    f64::from(blank.width) * f64::from(blank.height) * blank.channels.count() as f64
}

/// Returns the size of the file that is asked for, and with how many primitives the fit begins.
fn aimed(options: &EncodeOptions, samples: f64, fixed: u64) -> Result<(Size, usize)> {
    let bytes = match options.target {
        Target::Primitives(count) => return Ok((Size::Free, count as usize)),
        Target::Bytes(bytes) => bytes,
        Target::Ratio(ratio) => (samples / ratio).floor() as u64,
        _ => {
            let length = |metadata: Option<&Vec<u8>>| metadata.map_or(0, |m| m.len() as u64);
            let metadata = length(options.icc.as_ref()) + length(options.exif.as_ref());
            ((samples / aim::RATIO) as u64 + metadata).max(fixed + aim::LEAST)
        }
    };
    if bytes < fixed {
        let problem = format!("{bytes} bytes cannot hold the picture: {fixed} are needed without any primitive");
        return Err(Error::Parameter { name: "bytes", problem });
    }
    let count = ((bytes - fixed) as f64 * 8.0 / aim::CODED_BITS) as u64;
    Ok((Size::Bytes(bytes), count.min(aim::MAX_PRIMITIVES).min(samples as u64) as usize))
}

/// An encode in tiles on its way.
struct Course<'a> {
    grid: Grid,
    journal: Journal<'a>,
    /// The file without primitives.
    blank: PackedSplats,
    size: Size,
    /// Bytes of that file.
    fixed: u64,
    samples: f64,
}

impl Course<'_> {
    /// Does `work` for every window of a pass, which is the part `span` of a stage, in turns; `done` takes what came of a turn. Tiles of a turn do not wait for
    /// each other: whoever has several machines can share them.
    fn pass<T>(
        &mut self,
        (stage, shift, span): (&'static str, Shift, [f32; 2]),
        mut work: impl FnMut(&Window, &Mosaic<'_, T>, &mut dyn FnMut(f32) -> Result<()>) -> Result<Vec<Placed<T>>>,
        mosaic: &mut Mosaic<'_, T>,
    ) -> Result<()>
    where
        T: Copy,
    {
        let turns = self.grid.turns(shift);
        let count = turns.iter().map(Vec::len).sum::<usize>();
        let mut through = 0;
        for turn in turns {
            let mut became = Vec::with_capacity(turn.len());
            for window in &turn {
                let mut show = |done: f32| {
                    let done = (through as f32 + done) / count as f32;
                    self.journal.show(stage, span[0] + (span[1] - span[0]) * done)
                };
                show(0.0)?;
                became.push((window.core, work(window, mosaic, &mut show)?));
                through += 1;
            }
            mosaic.replace(became);
        }
        Ok(())
    }

    /// Fits floats and puts them into `mosaic`; returns their squared error.
    fn fit(&mut self, whole: &Whole<'_>, mosaic: &mut Mosaic<'_, Primitive>) -> Result<f64> {
        let clock = self.journal.seconds();
        let (mut others, mut error) = (Vec::new(), 0.0);
        let begin = |window: &Window, _: &Mosaic<'_, Primitive>, show: &mut dyn FnMut(f32) -> Result<()>| {
            let begun = floats::begin(whole, window, show)?;
            others.extend(begun.others);
            error += begun.error;
            Ok(begun.own)
        };
        self.pass(("fit", Shift::None, [0.0, 1.0]), begin, mosaic)?;
        let have = mosaic.count();
        let wanted = match self.size {
            Size::Free => whole.count,
            Size::Bytes(most) => {
                let each = self.price(whole, mosaic, error)?;
                let room = most as f64 * excess(have) - self.fixed as f64;
                ((room / each).max(0.0) as usize).min(2 * whole.count)
            }
        };
        mosaic.balance(others, wanted, (SWAPPED * have as f64) as usize);
        for (pass, (_, shift)) in floats::JOINED.iter().enumerate() {
            error = 0.0;
            let join = |window: &Window, mosaic: &Mosaic<'_, Primitive>, show: &mut dyn FnMut(f32) -> Result<()>| {
                let around = (mosaic.own(&window.core), mosaic.others(&window.core, &window.seen));
                let (own, of_tile) = floats::join(whole, (pass, window), around, show)?;
                error += of_tile;
                Ok(own)
            };
            let span = [pass, pass + 1].map(|p| p as f32 / floats::JOINED.len() as f32);
            self.pass(("join", *shift, span), join, mosaic)?;
        }
        self.journal.stage("fit", clock);
        Ok(error)
    }

    /// Returns the bytes that a primitive takes.
    fn price(&mut self, whole: &Whole<'_>, mosaic: &Mosaic<'_, Primitive>, error: f64) -> Result<f64> {
        let quantizer = self.set_steps(whole, mosaic, error);
        self.blank.gaussians = mosaic.all().map(|p| quantizer.quantize(&p.what.to_gaussian())).collect();
        let bytes = bitstream::to_bytes(&self.blank)?.len() as u64;
        self.blank.gaussians = Vec::new();
        Ok((bytes.saturating_sub(self.fixed) as f64 / mosaic.count().max(1) as f64).max(0.5))
    }

    /// Chooses the steps of the file.
    fn set_steps(&mut self, whole: &Whole<'_>, mosaic: &Mosaic<'_, Primitive>, error: f64) -> Quantizer {
        let every = mosaic.count() / SAMPLED + 1;
        let some: Vec<Primitive> = mosaic.all().step_by(every).map(|p| p.what).collect();
        let mut steps = rounded::steps(&some, self.blank.layout, decibels(error, self.samples));
        // Parts begin at whole steps.
        let too_coarse = steps.coarsest - UNIT.ilog2() as i8;
        if too_coarse > 0 {
            (steps.coarsest, steps.range) = (steps.coarsest - too_coarse, steps.range - too_coarse as u8);
        }
        self.blank.steps = steps;
        let quantizer = self.blank.quantizer();
        self.blank.background = quantizer.quantize_color(whole.scene.background);
        quantizer
    }

    /// Rounds `floats`, whose squared error is `error`, and brings them to the size that is asked for.
    fn finish(mut self, whole: &Whole<'_>, floats: Mosaic<'_, Primitive>, error: f64, levels: u8) -> Result<Encoded> {
        let clock = self.journal.seconds();
        let float_psnr = decibels(error, self.samples);
        let quantizer = self.set_steps(whole, &floats, error);
        let look = |p: &PackedGaussian| quantizer.dequantize(p);
        let mut mosaic = Mosaic::new(&self.grid, &look);
        for p in floats.all() {
            mosaic.insert(Placed { what: quantizer.quantize(&p.what.to_gaussian()), cost: 0.0 });
        }
        drop(floats);
        let sweeps = whole.plan.sweeps.max(2);
        let mut bytes = self.write(&mosaic, levels)?;
        let mut error = self.weighted_error(whole, &mosaic)?;
        for round in 0..sweeps + MORE_SWEEPS {
            let lambda = SLOPE * error / (8.0 * bytes.len() as f64);
            let shift = if round.is_multiple_of(2) { Shift::None } else { Shift::Half };
            let blank = self.blank.clone();
            let mut others = Vec::new();
            error = 0.0;
            let sweep = |window: &Window, mosaic: &Mosaic<'_, PackedGaussian>, _: &mut dyn FnMut(f32) -> Result<()>| {
                let around = (mosaic.own(&window.core), mosaic.others(&window.core, &window.seen));
                let swept = Part::new(whole, window, &blank, around).sweep(lambda)?;
                others.extend(swept.others);
                error += swept.error;
                Ok(swept.own)
            };
            let span = [round, round + 1].map(|r| r as f32 / (sweeps + MORE_SWEEPS) as f32);
            self.pass(("finish", shift, span), sweep, &mut mosaic)?;
            bytes = self.write(&mosaic, levels)?;
            let Size::Bytes(most) = self.size else {
                if round + 1 == sweeps {
                    break;
                }
                continue;
            };
            let length = bytes.len() as u64;
            let is_settled = length <= most && most - length <= (most / SETTLED).max(4);
            if round + 1 >= sweeps && (is_settled || length > most || round + 1 == sweeps + MORE_SWEEPS) {
                break;
            }
            if round + 1 + CORRECTED >= sweeps && !is_settled {
                let count = mosaic.count();
                let each = ((length - self.fixed.min(length)) as f64 / count.max(1) as f64).max(1.0);
                let wanted = match length > most {
                    true => count.saturating_sub(((length - most) as f64 / each).ceil() as usize),
                    false => count + ((most - length) as f64 / each * FILLED) as usize,
                };
                mosaic.balance(others, wanted, 0);
                bytes = self.write(&mosaic, levels)?;
            }
        }
        bytes = self.within(&mut mosaic, bytes, levels)?;
        self.journal.stage("finish", clock);
        self.report(whole, &mosaic, bytes, float_psnr)
    }

    /// Writes the file.
    fn write(&self, mosaic: &Mosaic<'_, PackedGaussian>, levels: u8) -> Result<Vec<u8>> {
        let gaussians = mosaic.all().map(|p| p.what).collect();
        file::smallest(&mut PackedSplats { gaussians, ..self.blank.clone() }, levels)
    }

    /// Takes away what is too much.
    fn within(&self, mosaic: &mut Mosaic<'_, PackedGaussian>, mut bytes: Vec<u8>, levels: u8) -> Result<Vec<u8>> {
        let Size::Bytes(most) = self.size else { return Ok(bytes) };
        while bytes.len() as u64 > most {
            let count = mosaic.count();
            if count == 0 {
                let problem = format!("{most} bytes cannot hold the picture: {} are needed", bytes.len());
                return Err(Error::Parameter { name: "bytes", problem });
            }
            let each = (bytes.len() as f64 / count as f64).max(1.0);
            mosaic.remove_cheapest(((bytes.len() as u64 - most) as f64 / each).ceil() as usize);
            bytes = self.write(mosaic, levels)?;
        }
        Ok(bytes)
    }

    fn weighted_error(&mut self, whole: &Whole<'_>, mosaic: &Mosaic<'_, PackedGaussian>) -> Result<f64> {
        let mut error = 0.0;
        for window in self.grid.turns(Shift::None).concat() {
            self.journal.show("finish", 0.0)?;
            let around = (mosaic.own(&window.core), mosaic.others(&window.core, &window.seen));
            error += Part::new(whole, &window, &self.blank, around).error()?;
        }
        Ok(error)
    }

    fn report(
        mut self,
        whole: &Whole<'_>,
        mosaic: &Mosaic<'_, PackedGaussian>,
        bytes: Vec<u8>,
        float_psnr: f64,
    ) -> Result<Encoded> {
        let clock = self.journal.seconds();
        let mut error = 0.0;
        let quantizer = self.blank.quantizer();
        let background = quantizer.dequantize_color(self.blank.background);
        for window in self.grid.turns(Shift::None).concat() {
            self.journal.show("measure", 0.0)?;
            let seen = [mosaic.own(&window.core), mosaic.others(&window.core, &window.core)].concat();
            let seen = seen.iter().map(|p| Primitive::from_gaussian(&quantizer.dequantize(p))).collect();
            error += floats::plain_error(whole, &window.core, background, seen)?;
        }
        self.journal.stage("measure", clock);
        let report = EncodeReport {
            primitives: mosaic.count(),
            psnr: decibels(error, self.samples),
            float_psnr,
            seconds: self.journal.seconds(),
            stages: self.journal.stages,
            left_out: self.journal.left_out,
            ..EncodeReport::default()
        };
        Ok(Encoded { bytes, report })
    }
}
