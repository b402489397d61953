//! Accumulates primitives into image-sized planes: sums `Σ w c` and `Σ w`, then the picture or its gradients.
//!
//! Only the rows of a [`RowSet`] are stored, so that stochastic gradients on every `n`th row cost a fraction of the
//! time and memory.

use crate::fit::model::drawing::kernel;
use crate::fit::model::drawing::project::{self, Frames, Primitive, Projected};
use crate::fit::model::drawing::strips::{PlannedStrip, Strips};
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::problem::{Problem, Scene};
use crate::gaussian::{Blend, EPSILON};
use crate::parallel;
use crate::simd::{self, LANES, Simd, Task};
use crate::weighting::RowWeights;

/// Sampled rows per band. Bands are the unit of parallel work.
const BAND: usize = 32;

/// The planes of one drawing.
#[derive(Debug, Default)]
pub struct Field {
    pub planes: Vec<f32>,
    pub stride: usize,
    pub rows: Option<RowSet>,
    /// The strips of the primitives that were drawn last.
    pub strips: Strips,
}

/// Some lines of a drawn picture.
#[derive(Debug, Clone, Copy)]
pub struct DrawnPart<'a> {
    /// The first line of the part.
    pub first: usize,
    planes: &'a [f32],
    row_size: usize,
}

impl<'a> DrawnPart<'a> {
    /// Returns the lines of the part.
    pub fn lines(&self) -> std::ops::Range<usize> {
        self.first..self.first + self.planes.len() / self.row_size
    }

    /// Returns the planes of line `y` of the picture, which must be in the part.
    pub fn row(&self, y: usize) -> &'a [f32] {
        &self.planes[(y - self.first) * self.row_size..][..self.row_size]
    }
}

/// What a drawing leaves in the planes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Output {
    /// `∂L/∂(Σwc)` for each channel and `h = Σ g I` (normalized) or 0 (sum), for the squared error.
    Gradient,
    /// The picture `I` for each channel and `Σ w`.
    Picture,
    /// The plain sums `Σ w c` and `Σ w`.
    Sums,
}

/// Lists the primitives that reach into each band of sampled rows, in order.
#[derive(Debug, Default)]
pub struct Bands {
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl Bands {
    pub fn new(projected: &[Projected], rows: RowSet, height: u32) -> Self {
        let bands = rows.count(height).div_ceil(BAND);
        let range = |p: &Projected| {
            let (first, end) = (rows.index(p.rows[0]), rows.index(p.rows[1]));
            if first < end { first / BAND..(end - 1) / BAND + 1 } else { 0..0 }
        };
        let mut starts = vec![0u32; bands + 1];
        for p in projected {
            for b in range(p) {
                starts[b + 1] += 1;
            }
        }
        for b in 0..bands {
            starts[b + 1] += starts[b];
        }
        let mut next = starts.clone();
        let mut members = vec![0u32; starts[bands] as usize];
        for (i, p) in projected.iter().enumerate() {
            for b in range(p) {
                members[next[b] as usize] = i as u32;
                next[b] += 1;
            }
        }
        Bands { starts, members }
    }

    /// Returns the indices of the primitives that reach into band `b`.
    fn members(&self, b: usize) -> &[u32] {
        &self.members[self.starts[b] as usize..self.starts[b + 1] as usize]
    }
}

impl Field {
    /// Draws `projected` on the rows of `rows` and leaves `output` in the planes. Returns the squared error of the
    /// clamped picture over those rows: weighted by the target's amplitudes for [`Output::Gradient`], unweighted for
    /// [`Output::Picture`], 0 for [`Output::Sums`].
    pub fn draw(&mut self, problem: &Problem<'_>, projected: &[Projected], rows: RowSet, output: Output) -> f64 {
        let Problem { scene, target } = *problem;
        let bands = Bands::new(projected, rows, scene.height);
        let row_size = (target.channels.count() + 1) * target.stride;
        self.stride = target.stride;
        self.rows = Some(rows);
        self.planes.resize(rows.count(scene.height) * row_size, 0.0);
        self.strips.plan(projected, rows, scene.width);
        let drawing = Drawing { problem, projected, strips: &self.strips, bands: &bands, rows, output };
        let errors = parallel::map_chunks(&mut self.planes, BAND * row_size, |b, band| drawing.band(b, band));
        errors.iter().sum()
    }

    /// Returns what [`Self::draw`] returns for all rows, without keeping the drawing.
    pub fn error(&mut self, problem: &Problem<'_>, projected: &[Projected], output: Output) -> f64 {
        self.sum_of_bands(problem, projected, output, 0..problem.scene.height, &|error, _, _| error)
    }

    /// Draws the bands that contain `lines` and returns the sum of `value(error, first line, planes)` over them. The
    /// number of bands drawn at a time is what fits into the memory already allocated, but at least one per thread,
    /// because the planes of a whole picture are several times as large as the picture.
    fn sum_of_bands(
        &mut self,
        problem: &Problem<'_>,
        projected: &[Projected],
        output: Output,
        lines: std::ops::Range<u32>,
        value: &(impl Fn(f64, usize, &[f32]) -> f64 + Sync),
    ) -> f64 {
        let (rows, scene) = (RowSet::ALL, problem.scene);
        let row_size = (problem.target.channels.count() + 1) * problem.target.stride;
        let band_size = BAND * row_size;
        let count = rows.count(scene.height).div_ceil(BAND);
        let at_once = (self.planes.len() / band_size).max(parallel::threads()).clamp(1, count.max(1));
        self.planes.resize(self.planes.len().max(at_once * band_size), 0.0);
        let bands = self.plan_parts(problem, projected);
        let drawing = Drawing { problem, projected, strips: &self.strips, bands: &bands, rows, output };
        let mut sum = 0.0;
        for begin in (lines.start as usize / BAND..(lines.end as usize).div_ceil(BAND)).step_by(at_once) {
            let end = (begin + at_once).min((lines.end as usize).div_ceil(BAND));
            let planes = &mut self.planes[..((end * BAND).min(scene.height as usize) - begin * BAND) * row_size];
            let values = parallel::map_chunks(planes, band_size, |b, band| {
                let error = drawing.band(begin + b, band);
                value(error, (begin + b) * BAND, band)
            });
            sum = values.iter().fold(sum, |sum, v| sum + v);
        }
        sum
    }

    /// Draws the picture in parts of `height` lines, a multiple of [`BAND`], and calls `look` with each part, from the
    /// top. The memory is that of one part.
    pub fn draw_parts(
        mut self,
        problem: &Problem<'_>,
        projected: &[Projected],
        height: usize,
        mut look: impl FnMut(&DrawnPart<'_>),
    ) {
        assert!(height.is_multiple_of(BAND), "{height} lines are not whole bands");
        let lines = problem.scene.height as usize;
        let row_size = (problem.target.channels.count() + 1) * problem.target.stride;
        let bands = self.plan_parts(problem, projected);
        let (rows, output) = (RowSet::ALL, Output::Picture);
        let drawing = Drawing { problem, projected, strips: &self.strips, bands: &bands, rows, output };
        for first in (0..lines).step_by(height) {
            self.planes.resize(height.min(lines - first) * row_size, 0.0);
            parallel::map_chunks(&mut self.planes, BAND * row_size, |b, band| drawing.band(first / BAND + b, band));
            look(&DrawnPart { first, planes: &self.planes, row_size });
        }
    }

    /// Prepares for drawing parts of the picture of `projected`, and returns its bands.
    fn plan_parts(&mut self, problem: &Problem<'_>, projected: &[Projected]) -> Bands {
        let scene = problem.scene;
        self.rows = None;
        self.stride = problem.target.stride;
        self.strips.plan(projected, RowSet::ALL, scene.width);
        Bands::new(projected, RowSet::ALL, scene.height)
    }

    /// Returns the gradients of the drawn primitives from index `start` on, gathered from the gradient planes over the
    /// rows `rows` that they were drawn on.
    pub fn gather(
        &self,
        channels: usize,
        rows: RowSet,
        width: u32,
        (start, projected): (usize, &[Projected]),
        primitives: &[Primitive],
    ) -> Vec<Gradient> {
        let field = self;
        match channels {
            1 => simd::dispatch(GatherTask::<1> { field, rows, width, start, projected, primitives }),
            2 => simd::dispatch(GatherTask::<2> { field, rows, width, start, projected, primitives }),
            3 => simd::dispatch(GatherTask::<3> { field, rows, width, start, projected, primitives }),
            _ => simd::dispatch(GatherTask::<4> { field, rows, width, start, projected, primitives }),
        }
    }

    /// Returns the planes of sampled row `i`.
    #[inline(always)]
    pub fn row(&self, i: usize, channels: usize) -> &[f32] {
        let size = (channels + 1) * self.stride;
        &self.planes[i * size..][..size]
    }
}

/// Returns the squared error of the clamped picture of `projected` over all rows.
pub fn squared_error(problem: &Problem<'_>, projected: &[Projected]) -> f64 {
    Field::default().error(problem, projected, Output::Picture)
}

/// Returns the squared error of the clamped picture of `projected` within some columns and lines, weighted or
/// unweighted as [`Field::draw`] does for `output`.
pub fn error_within(
    problem: &Problem<'_>,
    projected: &[Projected],
    (columns, lines): (std::ops::Range<usize>, std::ops::Range<u32>),
    output: Output,
) -> f64 {
    let Problem { target, .. } = *problem;
    let count = target.channels.count();
    let row_size = (count + 1) * target.stride;
    Field::default().sum_of_bands(problem, projected, Output::Picture, lines.clone(), &|_, first, planes| {
        let mut error = 0.0;
        for (y, drawn) in (first as u32..).zip(planes.chunks_exact(row_size)).filter(|(y, _)| lines.contains(y)) {
            let wanted = target.row(y);
            let weights = weights(target, y, output);
            for k in 0..count {
                let of = |x: usize| {
                    let at = k * target.stride + x;
                    f64::from((drawn[at].clamp(0.0, 1.0) - wanted[at]) * weights.factor(k, x)).powi(2)
                };
                error += columns.clone().map(of).sum::<f64>();
            }
        }
        error
    })
}

/// Returns the squared error of the clamped picture of `primitives` over all rows.
pub fn float_error(problem: &Problem<'_>, primitives: &[Primitive]) -> f64 {
    squared_error(problem, &project::all(primitives, problem.scene.height))
}

/// Primitives to draw band by band, and the output to produce.
#[derive(Clone, Copy)]
struct Drawing<'a> {
    problem: &'a Problem<'a>,
    projected: &'a [Projected],
    strips: &'a Strips,
    bands: &'a Bands,
    rows: RowSet,
    output: Output,
}

impl Drawing<'_> {
    /// Draws band `b`; returns its squared error.
    fn band(&self, b: usize, band: &mut [f32]) -> f64 {
        let drawing = self;
        match self.problem.target.channels.count() {
            1 => simd::dispatch(BandTask::<1> { drawing, b, band }),
            2 => simd::dispatch(BandTask::<2> { drawing, b, band }),
            3 => simd::dispatch(BandTask::<3> { drawing, b, band }),
            _ => simd::dispatch(BandTask::<4> { drawing, b, band }),
        }
    }
}

/// A band to draw.
struct BandTask<'a, const C: usize> {
    drawing: &'a Drawing<'a>,
    b: usize,
    band: &'a mut [f32],
}

/// A primitive to add to a band.
struct SplatTask<'a, const C: usize> {
    p: &'a Projected,
    strips: &'a [PlannedStrip],
    rows: RowSet,
    first: usize,
    width: u32,
    planes: &'a mut [f32],
    stride: usize,
}

impl<const C: usize> Task for SplatTask<'_, C> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let SplatTask { p, strips, rows, first, width, planes, stride } = self;
        kernel::splat_planned::<S, C>(simd, (p, strips), (rows, first), width, (planes, stride));
    }
}

impl<const C: usize> Task for BandTask<'_, C> {
    type Output = f64;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> f64 {
        let BandTask { drawing, b, band } = self;
        let Drawing { problem, projected, strips, bands, rows, output } = *drawing;
        let first = b * BAND;
        let Problem { scene, target } = problem;
        let stride = target.stride;
        let row_size = (C + 1) * stride;
        let count = band.len() / row_size;
        band.fill(0.0);
        for &i in bands.members(b) {
            let (p, strips) = (&projected[i as usize], strips.of(i as usize));
            simd.call(SplatTask::<C> { p, strips, rows, first, width: scene.width, planes: &mut *band, stride });
        }
        if output == Output::Sums {
            return 0.0;
        }
        let mut error = 0.0;
        for i in 0..count {
            let y = rows.row(first + i);
            let row = &mut band[i * row_size..][..row_size];
            let weights = weights(target, y, output);
            error += resolve_row::<S, C>(simd, scene, (target.row(y), weights), (row, stride), output);
        }
        error
    }
}

/// Returns the weights of the errors in row `y`. For [`Output::Picture`] they do not depend on the tuning.
#[inline(always)]
fn weights(target: &Planes, y: u32, output: Output) -> RowWeights<'_> {
    match output {
        Output::Picture => target.untuned_weights(y),
        Output::Gradient | Output::Sums => target.weights(y),
    }
}

/// Turns the sums of one row into `output`; returns the squared error of the clamped row.
#[inline(always)]
fn resolve_row<S: Simd, const C: usize>(
    simd: S,
    scene: &Scene,
    (target, row_weights): (&[f32], RowWeights<'_>),
    (row, stride): (&mut [f32], usize),
    output: Output,
) -> f64 {
    let (zero, one) = (simd.splat(0.0), simd.splat(1.0));
    let mut error = zero;
    let w = scene.width as usize;
    let (colors, weights) = row.split_at_mut(C * stride);
    let mut x = 0;
    while x < w {
        let limit = simd.splat((w - x) as f32 - 0.5);
        let inv = match scene.blend {
            Blend::Normalized => simd.div(one, simd.add(simd.read(&weights[x..]), simd.splat(EPSILON))),
            Blend::Sum => one,
        };
        let mut h = zero;
        for k in 0..C {
            let colors = &mut colors[k * stride + x..];
            let b = match scene.blend {
                Blend::Normalized => EPSILON * scene.background[k],
                Blend::Sum => scene.background[k],
            };
            let v = simd.mul(simd.add(simd.read(colors), simd.splat(b)), inv);
            let clamped = simd.min(simd.max(v, zero), one);
            let counts = simd.splat(row_weights.channels[k]);
            let factor = row_weights.pixels(simd, k, x);
            let mut e = simd.mul(simd.sub(clamped, simd.read(&target[k * stride + x..])), counts);
            e = simd.keep_above(e, limit, simd.index());
            if let Some(factor) = factor {
                e = simd.mul(e, factor);
            }
            error = simd.add(error, simd.mul(e, e));
            // The derivative of the weighted square has the factor twice.
            if let Some(factor) = factor {
                e = simd.mul(e, factor);
            }
            let left = match output {
                Output::Picture | Output::Sums => v,
                Output::Gradient => simd.mul(simd.mul(e, counts), inv),
            };
            simd.write(colors, left);
            if scene.blend == Blend::Normalized {
                h = simd.add(h, simd.mul(left, v));
            }
        }
        if output == Output::Gradient {
            simd.write(&mut weights[x..], h);
        }
        x += LANES;
    }
    // Strips may overhang the end of the row. Values there must not count.
    for plane in row.chunks_exact_mut(stride) {
        plane[x..].fill(0.0);
    }
    f64::from(simd.sum(error))
}

/// Returns the gradient of half the squared error for one primitive, gathered from the gradient planes, in the
/// primitive's whitened frame: the mean along its own axes in units of its scales, log-scales, rotation, and colour.
#[inline(always)]
fn gather<S: Simd, const C: usize>(simd: S, one: MomentsTask<'_, C>, frame: Frame) -> Gradient {
    let m = simd.call(one);
    let mut gradient = Gradient::from_moments(m.geometry, frame);
    gradient.color[..C].copy_from_slice(&m.color);
    gradient
}

/// Computes the moments of a primitive.
struct MomentsTask<'a, const C: usize> {
    field: &'a Field,
    rows: RowSet,
    width: u32,
    p: &'a Projected,
    strips: &'a [PlannedStrip],
}

impl<const C: usize> Task for MomentsTask<'_, C> {
    type Output = kernel::Moments<C>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> kernel::Moments<C> {
        let MomentsTask { field, rows, width, p, strips } = self;
        kernel::gather_planned::<S, C>(simd, (p, strips), rows, width, (&field.planes, field.stride))
    }
}

/// Computes the gradients of consecutive primitives.
struct GatherTask<'a, const C: usize> {
    field: &'a Field,
    rows: RowSet,
    width: u32,
    start: usize,
    projected: &'a [Projected],
    primitives: &'a [Primitive],
}

impl<const C: usize> Task for GatherTask<'_, C> {
    type Output = Vec<Gradient>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Vec<Gradient> {
        let GatherTask { field, rows, width, start, projected, primitives } = self;
        let mut out = Vec::with_capacity(projected.len());
        for (eight, primitives) in primitives.chunks(LANES).enumerate() {
            let Frames { scales: [major, minor], sin, cos } = project::frames(simd, primitives);
            for k in 0..primitives.len() {
                let i = eight * LANES + k;
                let (p, strips) = (&projected[i], field.strips.of(start + i));
                let frame = Frame { scale: [major[k], minor[k]], turn: (sin[k], cos[k]) };
                out.push(gather(simd, MomentsTask::<C> { field, rows, width, p, strips }, frame));
            }
        }
        out
    }
}

/// A gradient in the whitened frame of its primitive.
#[derive(Debug, Clone, Copy, Default)]
pub struct Gradient {
    pub mean: [f32; 2],
    pub log_scale: [f32; 2],
    pub rotation: f32,
    pub color: [f32; 4],
    /// The frame that the gradient is expressed in.
    pub frame: Frame,
}

/// The local frame of a primitive.
#[derive(Debug, Clone, Copy, Default)]
pub struct Frame {
    /// The scales of the primitive.
    pub scale: [f32; 2],
    /// Sine and cosine of its rotation.
    pub turn: (f32, f32),
}

impl Gradient {
    /// Computes the gradient from the sums of `t` times `dx`, `dy`, `dx²`, `dx dy` and `dy²`, where `t` is the gradient
    /// with respect to the exponent.
    #[inline(always)]
    pub fn from_moments([m10, m01, m20, m11, m02]: [f32; 5], frame: Frame) -> Self {
        let Frame { scale: [sx, sy], turn: (sin, cos) } = frame;
        let (ix, iy) = (1.0 / (sx * sx), 1.0 / (sy * sy));
        let uu = cos * cos * m20 + 2.0 * cos * sin * m11 + sin * sin * m02;
        let vv = sin * sin * m20 - 2.0 * cos * sin * m11 + cos * cos * m02;
        let uv = cos * sin * (m02 - m20) + (cos * cos - sin * sin) * m11;
        Gradient {
            mean: [(cos * m10 + sin * m01) / sx, (cos * m01 - sin * m10) / sy],
            log_scale: [uu * ix, vv * iy],
            rotation: -uv * (ix - iy),
            color: [0.0; 4],
            frame,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::model::objective::planes::Planes;
    use crate::gaussian::Channels;
    use crate::pixels::{Pixels, Samples};
    use crate::weighting::cases;

    #[test]
    fn the_error_is_the_same_with_and_without_keeping_the_drawing() {
        // The last band is shorter than the others.
        let (width, height) = (45, 3 * BAND as u32 + 5);
        for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
            let count = (width * height) as usize * channels.count();
            let samples = (0..count).map(|i| (i * 7919 % 251) as u8).collect();
            let target = Planes::new(&Pixels::new(width, height, channels, Samples::U8(samples)).unwrap());
            let scene = Scene { width, height, blend: Blend::Normalized, background: target.mean };
            let problem = Problem { scene, target: &target };
            let projected: Vec<Projected> = (0..40u32)
                .map(|i| {
                    let f = |k: u32| (f64::from(i) * f64::from(k).sqrt()).fract() as f32;
                    let (mean, color) = ([45.0 * f(2), 53.0 * f(3)], [f(5), f(7), f(11), f(13)]);
                    Projected::new(
                        &Primitive { mean, log_scale: [2.0 * f(17), f(19)], rotation: 3.0 * f(23), color },
                        height,
                    )
                })
                .collect();
            for output in [Output::Picture, Output::Gradient] {
                let kept = Field::default().draw(&problem, &projected, RowSet::ALL, output);
                assert_eq!(Field::default().error(&problem, &projected, output), kept);
                assert!(kept > 0.0);
            }
        }
    }

    #[test]
    fn errors_are_weighted_sums_over_all_samples() {
        let (width, height) = (45u32, 2 * BAND as u32 + 5);
        for case in cases::all(width, height) {
            let (target, count) = (&case.target, case.target.channels.count());
            let scene = Scene { width, height, blend: case.blend, background: target.mean };
            let problem = Problem { scene, target };
            let projected: Vec<Projected> = (0..40u32)
                .map(|i| {
                    let f = |k: u32| (f64::from(i) * f64::from(k).sqrt()).fract() as f32;
                    let (mean, color) = ([45.0 * f(2), 53.0 * f(3)], [f(5), f(7), f(11), f(13)].map(|c| 0.3 * c));
                    let p = Primitive { mean, log_scale: [2.0 * f(17), f(19)], rotation: 3.0 * f(23), color };
                    Projected::new(&p, height)
                })
                .collect();
            let mut drawn = Field::default();
            drawn.draw(&problem, &projected, RowSet::ALL, Output::Picture);
            let error = |weights: &[f64], [left, right]: [usize; 2]| -> f64 {
                let samples = (0..weights.len()).filter(|i| (left..right).contains(&(i / count % width as usize)));
                samples
                    .map(|i| {
                        let (pixel, k) = (i / count, i % count);
                        let (x, y) = (pixel % width as usize, pixel / width as usize);
                        let v = drawn.row(y, count)[k * target.stride + x].clamp(0.0, 1.0);
                        weights[i] * (f64::from(v) - case.values[i]).powi(2)
                    })
                    .sum()
            };
            let all = [0, width as usize];
            // Sums of a few thousand squares in f32.
            let near =
                |found: f64, want: f64| assert!((found / want - 1.0).abs() < 1e-4, "{}: {found} {want}", case.name);
            near(Field::default().error(&problem, &projected, Output::Picture), error(&case.untuned, all));
            near(Field::default().error(&problem, &projected, Output::Gradient), error(&case.weights, all));
            let part = (5..31usize, 0..height);
            near(error_within(&problem, &projected, part.clone(), Output::Picture), error(&case.untuned, [5, 31]));
            near(error_within(&problem, &projected, part, Output::Gradient), error(&case.weights, [5, 31]));
        }
    }
}
