//! Finds peaks of the error, and the shape that a new primitive should have there.

use crate::fit::model::drawing::field::Field;
use crate::fit::model::drawing::project::Primitive;
use crate::fit::model::objective::blur::Cells;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::placing::ridge::{self, Shape};
use crate::fit::model::problem::{Problem, Scene};
use crate::gaussian::Blend;
use crate::parallel;
use crate::simd::{self, Simd, Task};
use crate::strict_math::StrictMath;

/// Local maxima per unit of parallel work when shapes are searched.
const CHUNK: usize = 64;

/// A place where a new primitive helps most.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Peak {
    pub mean: [f32; 2],
    /// Standard deviations along and across `rotation`, pixels.
    pub scale: [f32; 2],
    /// Direction of the first scale, radians.
    pub rotation: f32,
    /// Estimated decrease of the squared error.
    pub gain: f32,
    /// Mean residual (target − picture) at the peak, doubled to give the peak value of a Gaussian of that size.
    pub residual: [f32; 4],
}

impl Peak {
    /// Creates a peak at `mean` (pixels) of a residual that is blurred with a standard deviation of `sigma` pixels.
    pub(crate) fn new(mean: [f32; 2], sigma: f32, shape: &Shape) -> Self {
        Peak {
            mean,
            scale: [sigma * shape.aspect, sigma],
            rotation: shape.rotation,
            gain: 4.0 * std::f32::consts::PI * sigma * sigma * shape.score,
            residual: shape.residual.map(|r| 2.0 * r),
        }
    }
}

/// Returns the scale (pixels) of the largest new primitives, when `count` are added to a picture of `among` primitives.
pub(crate) fn spacing(scene: &Scene, count: usize, among: usize) -> f32 {
    // The blend divides by the sum of weights, so a primitive larger than its neighbours would smear what they draw.
    let crowd = match scene.blend {
        Blend::Normalized => among,
        Blend::Sum => count,
    };
    (scene.width as f32 * scene.height as f32 / (std::f32::consts::PI * crowd.max(1) as f32)).sqrt()
}

/// Returns at most `count` places where new primitives help most in a picture of `among` primitives, best first: peaks
/// of the residual blurred at several scales. If a peak is part of a ridge, its shape is elongated along it.
pub(crate) fn peaks(problem: &Problem<'_>, field: &Field, rows: RowSet, count: usize, among: usize) -> Vec<Peak> {
    Scratch::default().peaks(problem, field, rows, [count, among])
}

/// Scratch memory that is kept from one search to the next. Touching fresh memory pages costs as much as the search.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    cells: Cells,
    spare: Vec<f32>,
    score: Vec<f32>,
}

impl Scratch {
    /// Returns what [`peaks`] returns, for `count` peaks in a picture of `among` primitives.
    pub(crate) fn peaks(
        &mut self,
        problem: &Problem<'_>,
        field: &Field,
        rows: RowSet,
        [count, among]: [usize; 2],
    ) -> Vec<Peak> {
        let Scratch { cells, spare, score } = self;
        // The cells are `rows.step` pixels wide, because the field has only every `rows.step`th row.
        residual(problem, field, rows, cells);
        search(&problem.scene, (cells, spare, score), rows.step as f32, [count, among])
    }
}

/// Finds the peaks of the residual in `cells`, which are `size` pixels wide. The other two buffers are scratch memory.
fn search(
    scene: &Scene,
    (cells, spare, score): (&mut Cells, &mut Vec<f32>, &mut Vec<f32>),
    mut size: f32,
    [count, among]: [usize; 2],
) -> Vec<Peak> {
    let spacing = spacing(scene, count, among);
    let ridges = ridge::all();
    let mut threshold = GainThreshold { count, gains: Vec::new() };
    let mut candidates: Vec<(Peak, u32)> = Vec::new();
    // Variance of the blur so far, pixels².
    let mut variance = 0.0f32;
    for level in 0..12u32 {
        let passes = if level == 0 { 2 } else { 1 };
        for _ in 0..passes {
            cells.blur(spare);
        }
        variance += passes as f32 * size * size;
        let sigma = variance.sqrt();
        if level > 0 && sigma > spacing {
            break;
        }
        let gain_of = |score: f32| 4.0 * std::f32::consts::PI * variance * score;
        let max_aspect = ridge::max_aspect(spacing, sigma);
        let maxima = maxima(cells, score);
        let least = threshold.raise(maxima.iter().map(|maximum| gain_of(maximum.score))) / max_aspect;
        let maxima: Vec<_> = maxima.into_iter().filter(|maximum| gain_of(maximum.score) >= least).collect();
        let shapes = parallel::map(maxima.len().div_ceil(CHUNK), |c| {
            let maxima = &maxima[c * CHUNK..maxima.len().min((c + 1) * CHUNK)];
            maxima.iter().map(|maximum| ridge::shape(&ridges, max_aspect, cells, maximum.cell)).collect::<Vec<_>>()
        })
        .concat();
        for (LocalMaximum { cell: [x, y], .. }, shape) in maxima.into_iter().zip(shapes) {
            let mean = [(x as f32 + 0.5) * size, (y as f32 + 0.5) * size];
            candidates.push((Peak::new(mean, sigma, &shape), level));
        }
        if cells.width < 4 || cells.height < 4 {
            break;
        }
        // Averaging 2 × 2 cells adds a variance of a quarter of the finer cell's area.
        cells.halve(spare);
        variance += 0.25 * size * size;
        size *= 2.0;
    }
    best(candidates, count, scene)
}

/// The smallest of the `count` largest gains so far. Peaks far below it need not be examined.
struct GainThreshold {
    count: usize,
    gains: Vec<f32>,
}

impl GainThreshold {
    fn raise(&mut self, gains: impl Iterator<Item = f32>) -> f32 {
        self.gains.extend(gains);
        let Some(over) = self.gains.len().checked_sub(self.count).filter(|&over| over < self.gains.len()) else {
            return 0.0;
        };
        let least = *self.gains.select_nth_unstable_by(over, f32::total_cmp).1;
        self.gains.drain(..over);
        least
    }
}

/// Selects the best `count` of candidates with their levels, none of them close to a better one.
pub(crate) fn best(mut candidates: Vec<(Peak, u32)>, count: usize, scene: &Scene) -> Vec<Peak> {
    // Ties are broken by position, so that the order is deterministic.
    let order = |(a, la): &(Peak, u32), (b, lb): &(Peak, u32)| {
        b.gain
            .total_cmp(&a.gain)
            .then(la.cmp(lb))
            .then(a.mean[1].total_cmp(&b.mean[1]))
            .then(a.mean[0].total_cmp(&b.mean[0]))
    };
    // A large picture has many more candidates than are selected, so the worst ones are rarely worth sorting.
    let part = (4 * count).max(1024);
    let (mut next, mut sorted) = (0, 0);
    let candidates = std::iter::from_fn(|| {
        if next == sorted {
            let rest = &mut candidates[sorted..];
            let part = part.min(rest.len());
            if part < rest.len() {
                rest.select_nth_unstable_by(part, order);
            }
            rest[..part].sort_unstable_by(order);
            sorted += part;
        }
        let (peak, _) = *candidates.get(next)?;
        next += 1;
        Some(peak)
    });
    spread(candidates, count, scene)
}

/// Fills `cells` with the residual (target − picture in `field`), in cells that are `rows.step` pixels wide.
fn residual(problem: &Problem<'_>, field: &Field, rows: RowSet, cells: &mut Cells) {
    let Problem { scene, target } = *problem;
    let channels = target.channels.count();
    let (step, length) = (rows.step as usize, scene.width as usize);
    let (width, height) = (length.div_ceil(step), rows.count(scene.height));
    // Four adjacent floats fill one vector.
    let each = if channels == 1 { 1 } else { 4 };
    let share = 1.0 / step as f32;
    (cells.width, cells.height, cells.each) = (width, height, each);
    cells.values.resize(width * height * each, 0.0);
    parallel::map_chunks(&mut cells.values, (width * each).max(1), |i, out| {
        let (wanted, weights) = (target.row(rows.row(i)), target.weights(rows.row(i)));
        let found = field.row(i, channels);
        if (step, channels) == (1, 3) {
            let planes =
                std::array::from_fn(|k| [&wanted[k * target.stride..][..length], &found[k * field.stride..][..length]]);
            let [r, g, b, _] = weights.channels;
            return simd::dispatch(ResidualTask { planes, shares: [r, g, b], amplitude: weights.amplitude, out });
        }
        out.fill(0.0);
        for k in 0..channels {
            let t = &wanted[k * target.stride..][..length];
            let v = &found[k * field.stride..][..length];
            let parts = t.chunks(step).zip(v.chunks(step)).zip(out.chunks_exact_mut(each));
            for (cell, ((t, v), out)) in parts.enumerate() {
                for (x, (t, v)) in t.iter().zip(v).enumerate() {
                    let x = cell * step + x;
                    out[k] += (t - v.clamp(0.0, 1.0)) * (share * weights.factor(k, x));
                }
            }
        }
    });
}

/// Computes the weighted residual of a row of three colours, where each pixel is a cell. Compilers vectorize its loop
/// for the instruction set.
struct ResidualTask<'a> {
    /// The rows of the target and of the drawn picture, for each colour.
    planes: [[&'a [f32]; 2]; 3],
    shares: [f32; 3],
    amplitude: Option<&'a [f32]>,
    out: &'a mut [f32],
}

#[inline(always)]
fn residual_at([t, v]: [&[f32]; 2], x: usize) -> f32 {
    t[x] - v[x].clamp(0.0, 1.0)
}

impl Task for ResidualTask<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let ResidualTask { planes: [r, g, b], shares, amplitude, out } = self;
        let (out, _) = out.as_chunks_mut::<4>();
        for (x, out) in out.iter_mut().enumerate() {
            let weight = amplitude.map_or(1.0, |a| a[x]);
            *out = [
                residual_at(r, x) * (shares[0] * weight),
                residual_at(g, x) * (shares[1] * weight),
                residual_at(b, x) * (shares[2] * weight),
                0.0,
            ];
        }
    }
}

/// A cell whose sum of squares is larger than those of its neighbours.
struct LocalMaximum {
    cell: [usize; 2],
    score: f32,
}

/// Returns the cells whose sums of squares are larger than those of their neighbours; of equal ones, the first. `score`
/// receives the sums of squares.
fn maxima(cells: &Cells, score: &mut Vec<f32>) -> Vec<LocalMaximum> {
    let (w, h) = (cells.width, cells.height);
    score.resize(w * h, 0.0);
    parallel::map_chunks(score, w.max(1), |y, out| {
        simd::dispatch(SquaresTask { row: cells.row(y), each: cells.each, out })
    });
    let row = |y: usize| &score[y * w..][..w];
    let found = parallel::map(h, |y| {
        let mut is_maximum = vec![false; w];
        let (above, below) = (y.checked_sub(1).map(row), (y + 1 < h).then(|| row(y + 1)));
        simd::dispatch(LocalMaximumTask { above, row: row(y), below, out: &mut is_maximum });
        let maxima = is_maximum.iter().zip(row(y)).enumerate().filter(|(_, (maximum, _))| **maximum);
        maxima.map(|(x, (_, &score))| LocalMaximum { cell: [x, y], score }).collect::<Vec<_>>()
    });
    found.into_iter().flatten().collect()
}

/// Computes the sums of squares of cells. Compilers vectorize its loops for the instruction set.
struct SquaresTask<'a> {
    row: &'a [f32],
    each: usize,
    out: &'a mut [f32],
}

impl Task for SquaresTask<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        if self.each == 4 {
            for (out, [a, b, c, d]) in self.out.iter_mut().zip(self.row.as_chunks().0) {
                *out = a * a + b * b + c * c + d * d;
            }
        } else {
            for (out, v) in self.out.iter_mut().zip(self.row) {
                *out = v * v;
            }
        }
    }
}

/// Marks the values of a row that are positive and larger than their neighbours.
struct LocalMaximumTask<'a> {
    above: Option<&'a [f32]>,
    row: &'a [f32],
    below: Option<&'a [f32]>,
    out: &'a mut [bool],
}

impl Task for LocalMaximumTask<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let LocalMaximumTask { above, row, below, out } = self;
        let n = row.len();
        for (o, &v) in out.iter_mut().zip(row) {
            *o = v > 0.0;
        }
        // Of equal values the first one counts, in raster order.
        for (i, o) in out.iter_mut().enumerate().skip(1) {
            *o &= row[i] > row[i - 1];
        }
        for (i, o) in out[..n - 1].iter_mut().enumerate() {
            *o &= row[i] >= row[i + 1];
        }
        if let Some(above) = above {
            for i in 0..n {
                out[i] &= row[i] > above[i];
            }
            for i in 1..n {
                out[i] &= row[i] > above[i - 1];
            }
            for i in 0..n - 1 {
                out[i] &= row[i] > above[i + 1];
            }
        }
        if let Some(below) = below {
            for i in 0..n {
                out[i] &= row[i] >= below[i];
            }
            for i in 1..n {
                out[i] &= row[i] >= below[i - 1];
            }
            for i in 0..n - 1 {
                out[i] &= row[i] >= below[i + 1];
            }
        }
    }
}

/// Keeps the best peaks whose distance from all better ones is at least 1.5 of their own scales, in each direction.
fn spread(candidates: impl Iterator<Item = Peak>, count: usize, scene: &Scene) -> Vec<Peak> {
    const CELL: f32 = 8.0;
    const NONE: u32 = u32::MAX;
    let cols = (scene.width as f32 / CELL) as usize + 1;
    let rows = (scene.height as f32 / CELL) as usize + 1;
    // The most recently accepted peak in each cell, and for each peak the one accepted before it in that cell.
    let mut last = vec![NONE; cols * rows];
    let mut before: Vec<u32> = Vec::new();
    let place = |m: [f32; 2]| (((m[0] / CELL) as usize).min(cols - 1), ((m[1] / CELL) as usize).min(rows - 1));
    let mut out: Vec<Peak> = Vec::new();
    for p in candidates {
        if out.len() >= count {
            break;
        }
        let reach = 1.5 * p.scale[0];
        let (sin, cos) = p.rotation.strict_sin_cos();
        let (cx, cy) = place(p.mean);
        let r = (reach / CELL).ceil() as usize;
        let near = |q: &Peak| {
            let (dx, dy) = (q.mean[0] - p.mean[0], q.mean[1] - p.mean[1]);
            let (u, v) = ((cos * dx + sin * dy) / p.scale[0], (cos * dy - sin * dx) / p.scale[1]);
            u * u + v * v < 2.25
        };
        let taken = if (2 * r + 1) * (2 * r + 1) > out.len() {
            out.iter().any(near)
        } else {
            (cy.saturating_sub(r)..=(cy + r).min(rows - 1)).any(|y| {
                let cells = &last[y * cols..][cx.saturating_sub(r)..=(cx + r).min(cols - 1)];
                cells.iter().any(|&first| {
                    let mut i = first;
                    while i != NONE {
                        if near(&out[i as usize]) {
                            return true;
                        }
                        i = before[i as usize];
                    }
                    false
                })
            })
        };
        if !taken {
            let cell = &mut last[cy * cols + cx];
            before.push(std::mem::replace(cell, out.len() as u32));
            out.push(p);
        }
    }
    out
}

/// Returns a primitive for a peak.
pub(crate) fn at_peak(peak: &Peak, problem: &Problem<'_>) -> Primitive {
    let Problem { scene, target } = *problem;
    let color = match scene.blend {
        Blend::Normalized => target.at(peak.mean),
        // The residual was weighted for the search.
        Blend::Sum => {
            let amplitude = target.amplitude_at(peak.mean);
            std::array::from_fn(|k| peak.residual[k] / (amplitude * target.channel_amplitude[k]))
        }
    };
    Primitive { mean: peak.mean, log_scale: peak.scale.map(|s| s.max(0.5).strict_ln()), rotation: peak.rotation, color }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::model::drawing::field::Output;
    use crate::fit::model::drawing::project::Projected;
    use crate::weighting::cases;

    #[test]
    fn residuals_are_weighted_as_errors_are() {
        let (width, height) = (37u32, 21u32);
        for case in cases::all(width, height) {
            let (target, count) = (&case.target, case.target.channels.count());
            let scene = Scene { width, height, blend: case.blend, background: [0.4; 4] };
            let problem = Problem { scene, target };
            let mut field = Field::default();
            field.draw(&problem, &[] as &[Projected], RowSet::ALL, Output::Picture);
            let mut cells = Cells::default();
            residual(&problem, &field, RowSet::ALL, &mut cells);
            for (i, (value, weight)) in case.values.iter().zip(&case.weights).enumerate() {
                let (pixel, k) = (i / count, i % count);
                let found = f64::from(cells.values[pixel * cells.each + k]);
                let drawn = field.row(pixel / width as usize, count)[k * target.stride + pixel % width as usize];
                let want = (value - f64::from(drawn)) * weight.sqrt();
                assert!((found - want).abs() < 1e-6, "{}, sample {i}: {found} {want}", case.name);
            }
        }
    }
}
