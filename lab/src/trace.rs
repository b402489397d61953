//! Quality over the time of an encode: measures the picture at growing intervals, and excludes the time of the
//! measurements.

use std::sync::Mutex;

use ssplat::unstable::fit::engine::{Inspect, Inspector, Moment, Snapshot};
use ssplat::unstable::fit::model::drawing::field::{Field, Output};
use ssplat::unstable::fit::model::drawing::project::Projected;
use ssplat::unstable::fit::model::objective::rows::RowSet;
use ssplat::unstable::fit::model::problem::Problem;
use ssplat::unstable::{EncodeOptions, metrics};
use ssplat::{Channels, Depth, Pixels, Result, Samples};

/// Interval between two points, relative to the duration of the encode so far.
const RELATIVE_INTERVAL: f64 = 0.18;
/// Interval before the second point and minimum of all intervals, seconds.
const FIRST_INTERVAL: f64 = 0.02;

/// Quality at one moment of an encode.
#[derive(Debug, Clone, PartialEq)]
pub struct TracePoint {
    /// Name of the stage, as in [`ssplat::Progress`], or "written".
    pub stage: &'static str,
    /// Seconds since the start of the encode, excluding measurements.
    pub seconds: f64,
    /// Number of steps done within the stage.
    pub step: u32,
    /// Number of primitives at that moment.
    pub primitives: usize,
    /// PSNR in dB over the samples that a decoder would return; infinite if all are equal.
    pub psnr: f64,
    /// Structural similarity; `None` if a side is shorter than 11 pixels.
    pub ssim: Option<f64>,
    /// Multi-scale structural similarity; `None` if a side is shorter than 161 pixels.
    pub ms_ssim: Option<f64>,
}

/// Records the points of a trace.
#[derive(Debug, Default)]
struct Tracer {
    /// Seconds at which the next point is due.
    next: f64,
    points: Vec<TracePoint>,
    step: (&'static str, u32),
}

/// A tracer that the threads of an encode share.
#[derive(Debug, Default)]
struct Shared(Mutex<Tracer>);

impl Inspect for Shared {
    fn inspect(&self, moment: &Moment<'_>, now: &mut dyn Snapshot) -> Result<()> {
        self.0.lock().expect("no inspection panics").step(moment, now)
    }
}

impl Tracer {
    /// Counts a step, and measures the current state if a point is due.
    fn step(&mut self, moment: &Moment<'_>, now: &mut dyn Snapshot) -> Result<()> {
        let &Moment { stage, seconds, original, target } = moment;
        if self.step.0 != stage {
            // The first step of each stage is always a point.
            (self.step, self.next) = ((stage, 0), seconds);
        }
        if seconds >= self.next {
            let (scene, projected) = now.drawing()?;
            let drawn = draw(&Problem { scene, target }, &projected, original.depth());
            let found = metrics::compare(original, &widen_pixels(drawn, original.channels()))?;
            self.points.push(TracePoint {
                stage,
                seconds,
                step: self.step.1,
                primitives: projected.len(),
                psnr: found.psnr,
                ssim: found.ssim,
                ms_ssim: found.ms_ssim,
            });
            self.next = seconds + (seconds * RELATIVE_INTERVAL).max(FIRST_INTERVAL);
        }
        self.step.1 += 1;
        Ok(())
    }
}

/// Calls `encode` with options that trace it. Returns its result and the trace.
pub fn traced<T>(options: &EncodeOptions, encode: impl FnOnce(&EncodeOptions) -> T) -> (T, Vec<TracePoint>) {
    // The options refer to inspectors that live as long as the program.
    let tracer: &'static Shared = Box::leak(Box::default());
    let mut options = options.clone();
    options.inspector = Some(Inspector(tracer));
    let encoded = encode(&options);
    (encoded, std::mem::take(&mut tracer.0.lock().expect("no inspection panics").points))
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

/// Converts the samples of a narrow picture to those of `channels`.
fn widen_pixels(pixels: Pixels, channels: Channels) -> Pixels {
    let from = pixels.channels();
    if from == channels {
        return pixels;
    }
    let samples = match pixels.samples() {
        Samples::U8(v) => Samples::U8(widened(v, from, channels, u8::MAX)),
        Samples::U16(v) => Samples::U16(widened(v, from, channels, u16::MAX)),
    };
    Pixels::new(pixels.width(), pixels.height(), channels, samples).expect("as many samples as the size says")
}

fn widened<T: Copy>(samples: &[T], from: Channels, to: Channels, white: T) -> Vec<T> {
    let colors = from.count() - usize::from(from.alpha().is_some());
    let value = |p: &[T], k: usize| match (to.alpha() == Some(k), from.alpha()) {
        (true, Some(a)) => p[a],
        (true, None) => white,
        _ => p[k.min(colors - 1)],
    };
    samples.chunks_exact(from.count()).flat_map(|p| (0..to.count()).map(move |k| value(p, k))).collect()
}

#[cfg(test)]
mod tests {
    use ssplat::Target;
    use ssplat::unstable::encode;

    use super::*;

    fn disc(side: u32) -> Pixels {
        let inside = |x: u32, y: u32| (x * 2).abs_diff(side).pow(2) + (y * 2).abs_diff(side).pow(2) < (side * side) / 2;
        let samples = (0..side * side).map(|i| if inside(i % side, i / side) { 230 } else { 40 }).collect();
        Pixels::new(side, side, Channels::Grey, Samples::U8(samples)).unwrap()
    }

    #[test]
    fn a_trace_ends_with_the_written_picture_and_changes_no_byte() {
        let pixels = disc(48);
        let mut options = EncodeOptions::default();
        options.target = Target::Gaussians(20);
        options.effort = 2;
        let plain = encode(&pixels, &options).unwrap();
        let (traced, points) = traced(&options, |options| encode(&pixels, options).unwrap());
        assert_eq!(plain.bytes, traced.bytes);
        assert!(points.windows(2).all(|p| p[0].seconds <= p[1].seconds));
        assert_eq!(points[0].stage, "fit");
        let last = points.last().unwrap();
        assert_eq!(last.stage, "written");
        // The trace is computed from rounded code values, the report is not.
        assert!((last.psnr - traced.report.psnr).abs() < 0.1, "{} {}", last.psnr, traced.report.psnr);
        // Measured: 28.3 dB and an SSIM of 0.935, from 11.3 dB and 0.42 at the first point. The margins are 1 dB and 0.02.
        assert!(points[0].psnr < 20.0 && last.psnr > 27.3, "{points:?}");
        assert!(last.ssim.is_some_and(|ssim| ssim > 0.915) && last.ms_ssim.is_none(), "{last:?}");
    }
}
