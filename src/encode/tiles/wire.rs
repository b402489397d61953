//! Wire format of tasks and answers for external workers. Numbers are little-endian. Each task and each answer contains
//! the version of the crate, which must be the same on both sides.
//!
//! The bytes may come from untrusted sources. The length of a task bounds the memory that reading it takes. The
//! contents of an answer are checked like the contents of a file.

use std::ops::ControlFlow;

use super::floats::{JOINED, OnProgress};
use super::global::{GlobalContext, TileSettings, Weights};
use super::grid::{Area, UNIT, Window};
use super::integers;
use super::mosaic::{Placed, TileResult, WindowPrimitives};
use super::task::{FloatWork, IntegerWork, TilePrimitive};
use crate::bitstream;
use crate::bitstream::bytes::Bytes;
use crate::bitstream::checksum::hash;
use crate::bitstream::rules::Rules;
use crate::bitstream::splats::{PackedGaussian, PackedSplats};
use crate::effort::MAX_EFFORT;
use crate::encode::device::Choice;
use crate::encode::primitive_count::MAX_PRIMITIVES;
use crate::encode::report::Progress;
use crate::error::{Error, FormatError, Result};
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::objective::masking::Means;
use crate::fit::model::problem::Scene;
use crate::gaussian::{Channels, MAX_SCALE, MIN_SCALE};
use crate::limits::Limits;
use crate::options::HiddenColors;
use crate::parameter::Parameter;
use crate::pixel_source::{PixelSource, check_area};
use crate::pixels::{Depth, Pixels, Samples};
use crate::rect::Rect;
use crate::strict_math::StrictMath;

/// First bytes of a task, including the version of its layout.
const TASK: &[u8] = b"ssplat task 1, ";
/// First bytes of an answer, including the version of its layout.
const ANSWER: &[u8] = b"ssplat answer 1, ";
/// Version of the crate that wrote the bytes.
const VERSION: &[u8] = env!("CARGO_PKG_VERSION").as_bytes();
/// Maximum magnitude of a number in a primitive. It exceeds the longest side, and is far larger than any colour.
const FAR: f32 = 2_097_152.0;

/// Does the work of `task`, which was submitted to [`Workers`](crate::encode::Workers), and returns the answer. Equal
/// tasks have equal answers. Calls `progress` during the work.
///
/// # Errors
/// [`Error::Parameter`] with the name `task` if the bytes are not a task of this version of the crate;
/// [`Error::Cancelled`] if `progress` returns [`ControlFlow::Break`].
pub fn work_on_tile(task: &[u8], progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>) -> Result<Vec<u8>> {
    let mut on_progress = |done: f32| match progress(&Progress { stage: "tile", done }) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Cancelled),
    };
    on_progress(0.0)?;
    run_task(task, &mut on_progress).map_err(|e| bad(Parameter::Task, e))
}

fn run_task(task: &[u8], on_progress: OnProgress<'_>) -> Result<Vec<u8>> {
    let mut bytes = check_envelope(task, TASK)?;
    let blank = read_blank(&mut bytes)?;
    let window = read_window(&mut bytes, [blank.width, blank.height])?;
    let target = (task_id(task), &window);
    match bytes.array("work")? {
        [0] => run_work::<Primitive>(bytes, blank, FloatWork::Begin, target, on_progress),
        [1] => match bytes.u32("pass")? {
            pass if (pass as usize) < JOINED.len() => {
                run_work::<Primitive>(bytes, blank, FloatWork::Join(pass as usize), target, on_progress)
            }
            pass => Err(refused("pass", pass.into())),
        },
        [2] => run_work::<PackedGaussian>(bytes, blank, IntegerWork::Weigh, target, on_progress),
        [3] => {
            let lambda = read_f64(&mut bytes, "lambda")?;
            run_work::<PackedGaussian>(bytes, blank, IntegerWork::Sweep(lambda), target, on_progress)
        }
        [4] => run_work::<PackedGaussian>(bytes, blank, IntegerWork::Appraise, target, on_progress),
        [other] => Err(refused("work", other.into())),
    }
}

/// Reads the rest of a task, does its work and writes the answer.
fn run_work<T: WireFormat>(
    mut bytes: Bytes<'_>,
    blank: PackedSplats,
    work: T::Work,
    (id, window): (u32, &Window),
    on_progress: OnProgress<'_>,
) -> Result<Vec<u8>> {
    let pixels = read_pixels(&mut bytes, &blank, T::pixels(window, work))?;
    let device = Choice::cpu();
    let global = read_context(&mut bytes, blank, (&pixels, &device))?;
    let bounds = PrimitiveBounds::new(&global, window);
    let counts = [bytes.u32("Gaussians")?, bytes.u32("other Gaussians")?];
    let mut own = Vec::new();
    for _ in 0..counts[0] {
        let primitive = T::read(&mut bytes, &bounds)?;
        primitive.check_inside(&bounds)?;
        own.push(primitive);
    }
    let neighbours = (0..counts[1]).map(|_| T::read(&mut bytes, &bounds)).collect::<Result<_>>()?;
    bytes.finish()?;
    answer(id, &T::work(&global, (window, work), WindowPrimitives { own, neighbours }, on_progress)?)
}

/// Converts an error in the bytes of `parameter` to an [`Error::Parameter`].
fn bad(parameter: Parameter, error: Error) -> Error {
    let problem = match error {
        Error::Format(e) => e.to_string(),
        Error::Parameter { problem, .. } => problem,
        e @ (Error::LimitExceeded { .. } | Error::UnsupportedVersion { .. }) => e.to_string(),
        e => return e,
    };
    Error::Parameter { parameter, problem }
}

fn refused(field: &'static str, value: u64) -> Error {
    FormatError::BadValue { field, value }.into()
}

/// A task that has been submitted and not yet answered.
pub(super) struct PendingTile {
    id: u32,
    window: Window,
    max_primitives: usize,
}

impl PendingTile {
    /// Records a submitted `task`. Its answer has at most `max_primitives` primitives, and as many candidates.
    pub(super) fn new(task: &[u8], window: &Window, max_primitives: usize) -> Self {
        PendingTile { id: task_id(task), window: *window, max_primitives }
    }

    /// Reads the answer to the task.
    ///
    /// # Errors
    /// [`Error::Parameter`] with the name `answer`, and the position of the tile in its text.
    pub(super) fn answer<T: WireFormat>(&self, global: &GlobalContext<'_>, bytes: &[u8]) -> Result<TileResult<T>> {
        self.read(global, bytes).map_err(|e| match bad(Parameter::Answer, e) {
            Error::Parameter { parameter, problem } => {
                let [x, y, width, height] = self.window.core.bounds().into();
                let problem = format!("for the tile of {width} × {height} at {x}, {y}: {problem}");
                Error::Parameter { parameter, problem }
            }
            e => e,
        })
    }

    fn read<T: WireFormat>(&self, global: &GlobalContext<'_>, bytes: &[u8]) -> Result<TileResult<T>> {
        let mut bytes = check_envelope(bytes, ANSWER)?;
        let id = bytes.u32("id of the task")?;
        if id != self.id {
            let problem = format!("the answer belongs to task {id:08x}, not to task {:08x}", self.id);
            return Err(Error::Parameter { parameter: Parameter::Answer, problem });
        }
        let error = read_f64(&mut bytes, "error")?;
        let counts = [bytes.u32("Gaussians")?, bytes.u32("other Gaussians")?];
        let bounds = PrimitiveBounds::new(global, &self.window);
        let mut placed = [Vec::new(), Vec::new()];
        for (placed, count) in placed.iter_mut().zip(counts) {
            if count as usize > self.max_primitives {
                return Err(refused("number of Gaussians", count.into()));
            }
            for _ in 0..count {
                let cost = bytes.f32("cost")?;
                if cost.is_nan() {
                    return Err(refused("cost", cost.to_bits().into()));
                }
                placed.push(Placed { primitive: T::read(&mut bytes, &bounds)?, cost });
            }
        }
        bytes.finish()?;
        let [own, candidates] = placed;
        Ok(TileResult { own, candidates, error })
    }
}

/// Writes an answer.
fn answer<T: WireFormat>(id: u32, results: &TileResult<T>) -> Result<Vec<u8>> {
    let mut out = message(ANSWER);
    out.extend(id.to_le_bytes());
    out.extend(results.error.to_le_bytes());
    put_counts(&mut out, [results.own.len(), results.candidates.len()])?;
    for placed in results.own.iter().chain(&results.candidates) {
        out.extend(placed.cost.to_le_bytes());
        placed.primitive.put(&mut out);
    }
    Ok(with_checksum(out))
}

/// Writes the task for a window.
pub(super) fn task<T: WireFormat>(
    global: &GlobalContext<'_>,
    (window, work): (&Window, T::Work),
    primitives: &WindowPrimitives<T>,
) -> Result<Vec<u8>> {
    let mut out = message(TASK);
    let blank = bitstream::to_bytes(&global.blank)?;
    out.extend((blank.len() as u32).to_le_bytes());
    out.extend(blank);
    for v in [window.core, window.padded].into_iter().flat_map(|area| <[u32; 4]>::from(area.bounds())) {
        out.extend(v.to_le_bytes());
    }
    out.extend(window.index.to_le_bytes());
    T::put_work(work, &mut out);
    match global.source.part(T::pixels(window, work).bounds())?.into_samples() {
        Samples::U8(v) => out.extend(v),
        Samples::U16(v) => v.iter().for_each(|v| out.extend(v.to_le_bytes())),
    }
    global.scene.background.iter().for_each(|v| out.extend(v.to_le_bytes()));
    out.push(global.settings.effort);
    out.extend((global.settings.count as u64).to_le_bytes());
    out.extend(global.settings.seed.to_le_bytes());
    out.extend(global.settings.sufficient_error.to_le_bytes());
    let TileSettings { is_priced, is_base, hidden, seconds, .. } = global.settings;
    let flags = [is_priced, is_base, hidden == HiddenColors::Keep, seconds.is_some()];
    out.push(flags.iter().enumerate().map(|(k, &flag)| u8::from(flag) << k).sum());
    seconds.iter().for_each(|v| out.extend(v.to_le_bytes()));
    let (tag, means) = match &global.weights {
        Weights::Alike => (0, &[][..]),
        Weights::Masking(means) => (1, &means[..]),
    };
    out.push(tag);
    means.iter().chain([&global.detail]).for_each(|v| out.extend(v.to_le_bytes()));
    put_counts(&mut out, [primitives.own.len(), primitives.neighbours.len()])?;
    primitives.own.iter().chain(&primitives.neighbours).for_each(|p| p.put(&mut out));
    Ok(with_checksum(out))
}

fn put_counts(out: &mut Vec<u8>, counts: [usize; 2]) -> Result<()> {
    for count in counts {
        let count = u32::try_from(count).map_err(|_| refused("Gaussians", count as u64))?;
        out.extend(count.to_le_bytes());
    }
    Ok(())
}

fn message(kind: &[u8]) -> Vec<u8> {
    [kind, VERSION, b"\n"].concat()
}

fn with_checksum(mut out: Vec<u8>) -> Vec<u8> {
    let checksum = hash(&out);
    out.extend(checksum.to_le_bytes());
    out
}

/// Returns the id of a task, which is its checksum.
fn task_id(task: &[u8]) -> u32 {
    task.last_chunk().map_or(0, |c| u32::from_le_bytes(*c))
}

/// Checks the version and the checksum of a task or an answer, and returns its contents.
fn check_envelope<'a>(bytes: &'a [u8], kind: &'static [u8]) -> Result<Bytes<'a>> {
    let wrong = |problem: String| Err(Error::Parameter { parameter: Parameter::Bytes, problem });
    let Some(rest) = bytes.strip_prefix(kind) else {
        let kind = String::from_utf8_lossy(kind);
        let found = String::from_utf8_lossy(&bytes[..bytes.len().min(kind.len())]);
        return wrong(format!("the {} bytes begin with {found:?}, not with {kind:?}", bytes.len()));
    };
    let head = &rest[..rest.len().min(64)];
    let end = head.iter().position(|&b| b == b'\n');
    let version = &head[..end.unwrap_or(head.len())];
    if version != VERSION || end.is_none() {
        let [found, own] = [version, VERSION].map(|v| String::from_utf8_lossy(v).into_owned());
        let state = if end.is_none() { "truncated in the line of the version" } else { "written by version" };
        return wrong(format!("{state} {found:?}, but this is version {own:?}"));
    }
    let start = kind.len() + version.len() + 1;
    let Some((contents, stored)) = bytes[start..].split_last_chunk() else {
        return Err(FormatError::Truncated { what: "checksum", offset: bytes.len() as u64 }.into());
    };
    let (stored, computed) = (u32::from_le_bytes(*stored), hash(&bytes[..bytes.len() - 4]));
    if stored != computed {
        return Err(FormatError::Checksum { what: "the bytes", stored, computed }.into());
    }
    Ok(Bytes::new(contents, start as u64))
}

/// Reads a finite number that is not negative.
fn read_f64(bytes: &mut Bytes<'_>, field: &'static str) -> Result<f64> {
    let value = bytes.f64(field)?;
    if value.is_finite() && value >= 0.0 { Ok(value) } else { Err(refused(field, value.to_bits())) }
}

fn read_f32(bytes: &mut Bytes<'_>, field: &'static str) -> Result<f32> {
    let value = f32::from_le_bytes(bytes.array(field)?);
    if value.abs() <= FAR { Ok(value) } else { Err(refused(field, value.to_bits().into())) }
}

/// The pixels of a task, at their position in the picture.
struct TaskPixels {
    size: [u32; 2],
    area: Area,
    pixels: Pixels,
}

impl PixelSource for TaskPixels {
    fn width(&self) -> u32 {
        self.size[0]
    }

    fn height(&self) -> u32 {
        self.size[1]
    }

    fn channels(&self) -> Channels {
        self.pixels.channels()
    }

    fn depth(&self) -> Depth {
        self.pixels.depth()
    }

    fn part(&self, area: Rect) -> Result<Pixels> {
        self.pixels.part(self.area.inward(area))
    }
}

fn read_pixels(bytes: &mut Bytes<'_>, blank: &PackedSplats, area: Area) -> Result<TaskPixels> {
    let [width, height] = area.size;
    let samples = u64::from(width) * u64::from(height) * blank.channels.count() as u64;
    let samples = bytes.take(samples * blank.depth.bytes() as u64, "samples")?;
    let samples = match blank.depth {
        Depth::Eight => Samples::U8(samples.to_vec()),
        Depth::Sixteen => Samples::U16(samples.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect()),
    };
    let pixels = Pixels::new(width, height, blank.channels, samples)?;
    Ok(TaskPixels { size: [blank.width, blank.height], area, pixels })
}

fn read_blank(bytes: &mut Bytes<'_>) -> Result<PackedSplats> {
    let length = bytes.u32("file without Gaussians")?;
    let blank = bitstream::read(bytes.take(length.into(), "file without Gaussians")?, &Limits::default())?;
    if !blank.gaussians.is_empty() {
        return Err(refused("number of Gaussians", blank.gaussians.len() as u64));
    }
    // The corners of windows must be multiples of the coarsest step.
    if blank.steps.coarsest > UNIT.ilog2() as i8 {
        return Err(refused("coarsest step", blank.steps.coarsest as u64));
    }
    Ok(blank)
}

fn read_context<'a>(
    bytes: &mut Bytes<'_>,
    blank: PackedSplats,
    (pixels, device): (&'a TaskPixels, &'a Choice),
) -> Result<GlobalContext<'a>> {
    let mut background = [0.0; 4];
    for v in &mut background {
        *v = read_f32(bytes, "background")?;
    }
    let [effort] = bytes.array("effort")?;
    if !(1..=MAX_EFFORT).contains(&effort) {
        return Err(refused("effort", effort.into()));
    }
    let count = u64::from_le_bytes(bytes.array("number of Gaussians")?);
    if count > MAX_PRIMITIVES {
        return Err(refused("number of Gaussians", count));
    }
    let count = count as usize;
    let seed = u64::from_le_bytes(bytes.array("seed")?);
    let sufficient_error = read_f64(bytes, "sufficient error")?;
    // The flags: whether bits have a price, whether a detail layer follows, whether hidden colours count, and whether
    // there is a time budget.
    let [is_priced, is_base, keeps_hidden, is_timed] = match bytes.array("flags")? {
        [flags @ 0..=15] => [0, 1, 2, 3].map(|k| flags >> k & 1 != 0),
        [other] => return Err(refused("flags", other.into())),
    };
    let seconds = if is_timed { Some(read_f64(bytes, "seconds")?) } else { None };
    let weights = match bytes.array("weights")? {
        [0] => Weights::Alike,
        [1] => {
            let mut means = Means::default();
            for mean in &mut means {
                *mean = read_f64(bytes, "weights")?;
            }
            Weights::Masking(means)
        }
        [other] => return Err(refused("weights", other.into())),
    };
    let detail = read_f64(bytes, "detail")?;
    let scene = Scene { width: blank.width, height: blank.height, blend: blank.blend, background };
    let hidden = if keeps_hidden { HiddenColors::Keep } else { HiddenColors::Continue };
    let settings = TileSettings { effort, count, is_priced, is_base, sufficient_error, seed, hidden, seconds };
    Ok(GlobalContext { source: pixels, scene, settings, blank, weights, detail, device })
}

fn read_window(bytes: &mut Bytes<'_>, size: [u32; 2]) -> Result<Window> {
    let mut areas = [[0; 4]; 2];
    for (area, field) in areas.iter_mut().zip(["tile", "pixels around the tile"]) {
        for v in area.iter_mut() {
            *v = bytes.u32(field)?;
        }
        check_area((*area).into(), size)?;
    }
    let [core, padded] = areas.map(|[x, y, width, height]| Area { corner: [x, y], size: [width, height] });
    check_area(padded.inward(core.bounds()), padded.size)?;
    if let Some(&corner) = padded.corner.iter().find(|&v| v % UNIT != 0) {
        return Err(refused("corner", corner.into()));
    }
    Ok(Window { core, padded, index: u64::from_le_bytes(bytes.array("number of the tile")?) })
}

/// Bounds for the primitives of a task or an answer.
pub(super) struct PrimitiveBounds {
    size: [u32; 2],
    global: Rules,
    /// Rules for a file of the window alone.
    part: Rules,
    corner: [u32; 2],
}

impl PrimitiveBounds {
    fn new(global: &GlobalContext<'_>, window: &Window) -> Self {
        PrimitiveBounds {
            size: [global.blank.width, global.blank.height],
            global: Rules::of(&global.blank),
            part: Rules::of(&global.draft(&window.padded)),
            corner: window.padded.corner,
        }
    }
}

/// Primitives that can be sent to workers.
pub(super) trait WireFormat: TilePrimitive {
    /// Writes the kind of work.
    fn put_work(work: Self::Work, out: &mut Vec<u8>);
    fn put(&self, out: &mut Vec<u8>);
    /// Reads a primitive. Returns an error if no encode produces its values.
    fn read(bytes: &mut Bytes<'_>, bounds: &PrimitiveBounds) -> Result<Self>;
    /// Returns an error if the primitive lies outside the window of the tile.
    fn check_inside(&self, bounds: &PrimitiveBounds) -> Result<()>;
    /// Returns the maximum number of primitives, and of candidates, in an answer to work on `own` primitives.
    fn max_primitives(work: Self::Work, own: usize) -> usize;
}

impl WireFormat for Primitive {
    fn put_work(work: FloatWork, out: &mut Vec<u8>) {
        match work {
            FloatWork::Begin => out.push(0),
            FloatWork::Join(pass) => {
                out.push(1);
                out.extend((pass as u32).to_le_bytes());
            }
        }
    }

    fn put(&self, out: &mut Vec<u8>) {
        let Primitive { mean, log_scale, rotation, color } = self;
        let all = mean.iter().chain(log_scale).chain([rotation]).chain(color);
        all.for_each(|v| out.extend(v.to_le_bytes()));
    }

    fn read(bytes: &mut Bytes<'_>, bounds: &PrimitiveBounds) -> Result<Self> {
        let mut next = |field| read_f32(bytes, field);
        let mean = [next("x")?, next("y")?];
        let log_scale = [next("scale")?, next("scale")?];
        let rotation = next("angle")?;
        let mut color = [0.0; 4];
        for v in &mut color {
            *v = next("colour")?;
        }
        for k in 0..2 {
            // Rounding may move a mean on the edge slightly beyond it.
            if !(-1.0..=bounds.size[k] as f32 + 1.0).contains(&mean[k]) {
                return Err(refused(["x", "y"][k], mean[k].to_bits().into()));
            }
            if !(MIN_SCALE.strict_ln()..=MAX_SCALE.strict_ln()).contains(&log_scale[k]) {
                return Err(refused("scale", log_scale[k].to_bits().into()));
            }
        }
        Ok(Primitive { mean, log_scale, rotation, color })
    }

    /// Accepts any position, because the fit moves primitives into the window.
    fn check_inside(&self, _: &PrimitiveBounds) -> Result<()> {
        Ok(())
    }

    fn max_primitives(work: FloatWork, own: usize) -> usize {
        match work {
            FloatWork::Begin => MAX_PRIMITIVES as usize,
            FloatWork::Join(_) => own,
        }
    }
}

impl WireFormat for PackedGaussian {
    fn put_work(work: IntegerWork, out: &mut Vec<u8>) {
        match work {
            IntegerWork::Weigh => out.push(2),
            IntegerWork::Sweep(lambda) => {
                out.push(3);
                out.extend(lambda.to_le_bytes());
            }
            IntegerWork::Appraise => out.push(4),
        }
    }

    fn put(&self, out: &mut Vec<u8>) {
        let PackedGaussian { x, y, major, minor, angle, color } = self;
        [x, y].into_iter().for_each(|v| out.extend(v.to_le_bytes()));
        out.extend([*major, *minor]);
        out.extend(angle.to_le_bytes());
        color.iter().for_each(|v| out.extend(v.to_le_bytes()));
    }

    fn read(bytes: &mut Bytes<'_>, bounds: &PrimitiveBounds) -> Result<Self> {
        let [x, y] = [bytes.u32("x")?, bytes.u32("y")?];
        let [major, minor] = bytes.array("scales")?;
        let angle = u16::from_le_bytes(bytes.array("angle")?);
        let mut color = [0; 4];
        for v in &mut color {
            *v = i16::from_le_bytes(bytes.array("colour")?);
        }
        let p = PackedGaussian { x, y, major, minor, angle, color };
        bounds.global.gaussian(&p)?;
        Ok(p)
    }

    fn check_inside(&self, bounds: &PrimitiveBounds) -> Result<()> {
        let exponents = bounds.global.lattice.exponents(self.major, self.minor, self.angle);
        let inside = |v: u32, k: usize| v.checked_sub(integers::steps(bounds.corner[k], exponents[k]));
        let (Some(x), Some(y)) = (inside(self.x, 0), inside(self.y, 1)) else {
            return Err(refused("position", self.x.into()));
        };
        Ok(bounds.part.position([x, y], exponents)?)
    }

    fn max_primitives(work: IntegerWork, own: usize) -> usize {
        match work {
            IntegerWork::Sweep(_) | IntegerWork::Appraise => own.max(integers::candidate_count(own)),
            IntegerWork::Weigh => 0,
        }
    }
}
