//! Records quality over time: measures the picture at growing intervals during the encode, and excludes the time of the
//! measurements.

use std::time::Duration;

use super::channels::widen_pixels;
use crate::error::Result;
use crate::fit::engine::Snapshot;
use crate::fit::model::drawing::field::{Field, Output};
use crate::fit::model::drawing::project::Projected;
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::problem::Problem;
use crate::instant::Instant;
use crate::metrics;
use crate::options::Trace;
use crate::pixels::{Depth, Pixels, Samples};

/// Interval between two points, relative to the duration of the encode so far.
const RELATIVE_INTERVAL: f64 = 0.18;
/// Interval before the second point and minimum of all intervals, seconds.
const FIRST_INTERVAL: f64 = 0.02;

/// Quality at one moment of an encode.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TracePoint {
    /// Name of the stage, as in [`Progress`](crate::Progress).
    pub stage: &'static str,
    /// Seconds since the start of the encode, excluding measurements.
    pub seconds: f64,
    /// Number of steps done within the stage.
    pub step: u32,
    /// Number of primitives at that moment.
    pub primitives: usize,
    /// PSNR in dB over the samples that a decoder would return; infinite if all are equal.
    pub psnr: f64,
    /// Structural similarity; `None` if a side is shorter than 11 pixels or the picture is fitted in tiles.
    pub ssim: Option<f64>,
    /// Multi-scale structural similarity; `None` if a side is shorter than 161 pixels or the picture is fitted in
    /// tiles.
    pub ms_ssim: Option<f64>,
}

/// Records the points of a trace.
pub(crate) struct Tracer {
    start: Instant,
    spent: Duration,
    /// Seconds at which the next point is due; infinite if nothing is traced.
    next: f64,
    points: Vec<TracePoint>,
    step: (&'static str, u32),
}

impl Tracer {
    pub(crate) fn new(trace: Trace) -> Self {
        let next = if trace == Trace::On { 0.0 } else { f64::INFINITY };
        Tracer { start: Instant::now(), spent: Duration::ZERO, next, points: Vec::new(), step: ("", 0) }
    }

    /// Returns the seconds since the start, excluding measurements.
    pub(crate) fn seconds(&self) -> f64 {
        (self.start.elapsed() - self.spent).as_secs_f64()
    }

    /// Counts a step of `stage`, and measures the current state if a point is due. Returns the last PSNR.
    pub(crate) fn step(
        &mut self,
        stage: &'static str,
        pixels: &Pixels,
        target: &Planes,
        snapshot: &mut dyn Snapshot,
    ) -> Result<Option<f64>> {
        let now = self.seconds();
        if self.step.0 != stage {
            self.step = (stage, 0);
            // The first step of each stage is always a point.
            self.next = if self.next.is_finite() { now } else { self.next };
        }
        if now >= self.next {
            let clock = Instant::now();
            let (scene, projected) = snapshot.drawing()?;
            let drawn = draw(&Problem { scene, target }, &projected, pixels.depth());
            let found = metrics::compare(pixels, &widen_pixels(drawn, pixels.channels()))?;
            self.points.push(TracePoint {
                stage,
                seconds: now,
                step: self.step.1,
                primitives: projected.len(),
                psnr: found.psnr,
                ssim: found.ssim,
                ms_ssim: found.ms_ssim,
            });
            self.next = now + (now * RELATIVE_INTERVAL).max(FIRST_INTERVAL);
            self.spent += clock.elapsed();
        }
        self.step.1 += 1;
        Ok(self.points.last().map(|p| p.psnr))
    }

    /// Returns whether anything is traced.
    pub(crate) fn is_on(&self) -> bool {
        self.next.is_finite()
    }

    /// Adds a point whose PSNR the caller has measured. The measurement started at `start`.
    pub(crate) fn add(&mut self, stage: &'static str, psnr: f64, primitives: usize, start: Instant) {
        let seconds = (start - self.start).saturating_sub(self.spent).as_secs_f64();
        let step = if self.step.0 == stage { self.step.1 + 1 } else { 0 };
        self.step = (stage, step);
        self.points.push(TracePoint { stage, seconds, step, primitives, psnr, ssim: None, ms_ssim: None });
        self.spent += start.elapsed();
    }

    pub(crate) fn take_points(&mut self) -> Vec<TracePoint> {
        std::mem::take(&mut self.points)
    }
}

/// Renders `projected` with the kernels of the fit.
fn draw(problem: &Problem<'_>, projected: &[Projected], depth: Depth) -> Pixels {
    let Problem { scene, target } = *problem;
    let mut field = Field::default();
    field.draw(problem, projected, RowSet::ALL, Output::Picture);
    let (width, count) = (scene.width as usize, target.channels.count());
    let white = f32::from(depth.max());
    let codes = (0..scene.height as usize).flat_map(|y| {
        let row = field.row(y, count);
        let stride = field.stride;
        (0..width * count).map(move |i| row[i % count * stride + i / count].clamp(0.0, 1.0) * white + 0.5)
    });
    let samples = match depth {
        Depth::Eight => Samples::U8(codes.map(|v| v as u8).collect()),
        Depth::Sixteen => Samples::U16(codes.map(|v| v as u16).collect()),
    };
    Pixels::new(scene.width, scene.height, target.channels, samples).expect("as many samples as the size says")
}
