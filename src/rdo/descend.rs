//! Descent over the integers, block by block. Each primitive in turn moves to the neighbouring lattice point, with the
//! best colour for it, that lowers `squared error + λ·bits` most.
//!
//! For a given shape, the picture is linear in the primitive's colour once its weight is fixed, so one pass over the
//! support gives the error for every colour. A second pass gives the error to second order in the shape. Only those
//! neighbouring shapes and positions are rendered that look promising by it. Primitives in disjoint bands of rows are
//! processed in parallel.

use glam::Vec2;

use crate::bitstream::coder::expect::PredictedCost;
use crate::bitstream::splats::PackedGaussian;
use crate::constants::rdo;
use crate::fit::model::drawing::field::{Field, Output};
use crate::fit::model::drawing::kernel;
use crate::fit::model::drawing::project::Projected;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::problem::{Problem, overlap};
use crate::gaussian::Gaussian;
use crate::parallel;
use crate::quantize::Quantizer;
use crate::rdo::bit_cost::{BitCosts, Cost};
use crate::rdo::local_quadratic::{LocalQuadratic, Moves};
use crate::rdo::patch::{self, Parabola, Patch};
use crate::rdo::rounded::projected;
use crate::simd::{self, Simd, Task};
use crate::strict_math::StrictMath;

/// Maximum height of the smallest bands, rows.
const BAND: usize = 96;

/// Width of the blocks of a band that are processed one after the other, pixels.
const BLOCK: usize = 64;

/// The parts of the picture that changed recently. A primitive whose surroundings did not change need not be tried
/// again.
#[derive(Debug)]
pub(super) struct Activity {
    /// The sweep in which each cell of `CELL²` pixels last changed.
    last_changed: Vec<u32>,
    cols: usize,
    sweep: u32,
}

/// Side of an activity cell, pixels.
const CELL: usize = 16;

impl Activity {
    fn new(width: u32, height: u32) -> Self {
        let (cols, rows) = ((width as usize).div_ceil(CELL), (height as usize).div_ceil(CELL));
        Activity { last_changed: vec![1; cols * rows], cols, sweep: 1 }
    }

    /// Returns the cells under the support of `g`.
    fn cells(&self, g: &Gaussian) -> impl Iterator<Item = usize> + use<> {
        let [hx, hy] = g.extent();
        let (cols, rows) = (self.cols, self.last_changed.len() / self.cols);
        let span = |m: f32, h: f32, n: usize| {
            let cell = |v: f32| ((v.max(0.0) / CELL as f32) as usize).min(n - 1);
            cell(m - h)..=cell(m + h)
        };
        let across = span(g.mean[0], hx, cols);
        span(g.mean[1], hy, rows).flat_map(move |y| across.clone().map(move |x| y * cols + x))
    }

    /// Marks the cells under `g` as changed, after it was added, removed or modified.
    pub(super) fn mark(&mut self, g: &Gaussian) {
        for i in self.cells(g) {
            self.last_changed[i] = self.sweep;
        }
    }

    /// Returns whether anything under `g` changed in this sweep or the previous one.
    fn changed_recently(&self, g: &Gaussian) -> bool {
        self.cells(g).any(|i| self.last_changed[i] + 1 >= self.sweep)
    }
}

/// A descent in progress: the problem, and the memory from one sweep to the next.
#[derive(Debug)]
pub(crate) struct Descent<'a> {
    pub(super) problem: Problem<'a>,
    pub(super) quantizer: &'a Quantizer,
    pub(super) activity: Activity,
    pub(super) field: Field,
    /// Frozen primitives that are rendered together with those that change.
    pub(super) frozen: Vec<Projected>,
}

impl<'a> Descent<'a> {
    /// Starts a descent that tries all primitives in its first sweep. `field` provides memory for the planes.
    pub(crate) fn new(problem: Problem<'a>, quantizer: &'a Quantizer, field: Field) -> Self {
        let activity = Activity::new(problem.scene.width, problem.scene.height);
        Descent { problem, quantizer, activity, field, frozen: Vec::new() }
    }

    /// Sweeps over all primitives once, where each bit must save `lambda` of the squared error. Returns by how much
    /// `error + λ·bits` fell. The order of `gaussians` stays the same. The coder's predictions `expected`, which may be
    /// empty, are used for the whole sweep.
    pub(crate) fn sweep(&mut self, gaussians: &mut [PackedGaussian], expected: &[PredictedCost], lambda: f32) -> f64 {
        match self.problem.target.channels.count() {
            1 => sweep_channels::<1>(self, gaussians, expected, lambda),
            2 => sweep_channels::<2>(self, gaussians, expected, lambda),
            3 => sweep_channels::<3>(self, gaussians, expected, lambda),
            _ => sweep_channels::<4>(self, gaussians, expected, lambda),
        }
    }

    /// Keeps the primitives `frozen` in the picture during the descent.
    pub(crate) fn with_frozen(self, frozen: Vec<Projected>) -> Self {
        Descent { frozen, ..self }
    }

    /// Returns all visible primitives, projected: `gaussians` first.
    pub(crate) fn visible(&self, gaussians: &[PackedGaussian]) -> Vec<Projected> {
        let mut visible = projected(self.quantizer, gaussians, self.problem.scene.height);
        visible.extend_from_slice(&self.frozen);
        visible
    }

    /// Returns the squared error of the clamped picture of `gaussians`, weighted by the target's amplitudes.
    pub(super) fn error(&mut self, gaussians: &[PackedGaussian]) -> f64 {
        let projected = self.visible(gaussians);
        self.field.error(&self.problem, &projected, Output::Gradient)
    }
}

fn sweep_channels<const C: usize>(
    descent: &mut Descent<'_>,
    gaussians: &mut [PackedGaussian],
    expected: &[PredictedCost],
    lambda: f32,
) -> f64 {
    let (problem, quantizer) = (&descent.problem, descent.quantizer);
    let (activity, field) = (&mut descent.activity, &mut descent.field);
    let Problem { scene, target } = *problem;
    activity.sweep += 1;
    // Bit costs are measured once, so that all bands use the same.
    let costs = BitCosts::measure(gaussians, C, expected);
    // Each primitive is tried at most once per sweep, so these shapes stay valid until its turn.
    let floats: Vec<Gaussian> = gaussians.iter().map(|g| quantizer.dequantize(g)).collect();
    let mut projected: Vec<Projected> = floats.iter().map(|g| Projected::from_gaussian(g, scene.height)).collect();
    let max_row_step = patch::max_row_step(&scene, overlap(&scene, &floats));
    projected.extend_from_slice(&descent.frozen);
    // The sums are not divided yet, so that single primitives can be removed and added.
    field.draw(problem, &projected, RowSet::ALL, Output::Sums);
    let row_size = (C + 1) * target.stride;
    let height = scene.height as usize;
    // If nothing changed nearby since the last sweep, a primitive would hardly find anything new.
    let mut waiting: Vec<u32> =
        (0..gaussians.len() as u32).filter(|&i| activity.changed_recently(&floats[i as usize])).collect();
    let mut gain = 0.0;
    // Each band belongs to one thread. A primitive is tried in a band that contains all rows it may touch, so that no
    // two threads write to the same pixels. The last band is the whole picture, so that every primitive is tried.
    let mut least = BAND;
    while !waiting.is_empty() {
        // Bands of equal height keep threads busy for equally long.
        let band = height.div_ceil(height.div_ceil(least));
        // Bands shifted by half take the primitives that cross a border of the first ones. Larger bands take the rest.
        for offset in [0, band / 2] {
            let members = Bands { height, band, offset }.take(&mut waiting, &projected);
            let planes = &mut field.planes[offset * row_size..];
            let changes = parallel::map_chunks(planes, band * row_size, |b, planes| {
                let task = BandTask::<C> {
                    problem,
                    quantizer,
                    costs: &costs,
                    lambda,
                    gaussians,
                    members: &members[b],
                    planes,
                    first: offset + b * band,
                    max_row_step,
                };
                simd::dispatch(task)
            });
            // Integers are replaced only now, because all threads read them.
            for change in changes.into_iter().flatten() {
                gain += f64::from(change.gain);
                // Pixels change both at the old and at the new position.
                activity.mark(&floats[change.index as usize]);
                activity.mark(&quantizer.dequantize(&change.to));
                gaussians[change.index as usize] = change.to;
            }
            if band >= height {
                break;
            }
        }
        least *= 2;
    }
    gain
}

/// Bands of `band` rows each, the first of which starts at row `offset`.
struct Bands {
    height: usize,
    band: usize,
    offset: usize,
}

impl Bands {
    /// Returns the band that contains all rows that `p` may touch.
    fn of(&self, p: &Projected) -> Option<usize> {
        let &Bands { height, band, offset } = self;
        if band >= height {
            return Some(0);
        }
        let rows = reach(p, height);
        let b = rows.start.checked_sub(offset)? / band;
        (rows.end <= offset + (b + 1) * band).then_some(b)
    }

    /// Takes the primitives that lie in a single band out of `waiting`, and returns those of each band.
    fn take(&self, waiting: &mut Vec<u32>, projected: &[Projected]) -> Vec<Vec<u32>> {
        let mut members: Vec<Vec<u32>> = vec![Vec::new(); (self.height - self.offset).div_ceil(self.band)];
        waiting.retain(|&i| match self.of(&projected[i as usize]) {
            Some(b) => {
                members[b].push(i);
                false
            }
            None => true,
        });
        // Each band is processed a few columns at a time, so that the rows under one primitive are still in the cache
        // for the next.
        for members in &mut members {
            members.sort_by_key(|&i| projected[i as usize].center[0].max(0.0) as usize / BLOCK);
        }
        members
    }
}

/// Returns the rows that a primitive and its neighbours on the lattice may touch.
fn reach(p: &Projected, height: usize) -> std::ops::Range<usize> {
    let tall = (p.rows[1] - p.rows[0]) as usize;
    let margin = tall / 4 + 2;
    (p.rows[0] as usize).saturating_sub(margin)..(p.rows[1] as usize + margin).min(height)
}

struct Change {
    index: u32,
    to: PackedGaussian,
    gain: f32,
}

struct BandTask<'a, const C: usize> {
    problem: &'a Problem<'a>,
    quantizer: &'a Quantizer,
    costs: &'a BitCosts<'a>,
    lambda: f32,
    gaussians: &'a [PackedGaussian],
    members: &'a [u32],
    planes: &'a mut [f32],
    first: usize,
    /// Maximum distance of the rows of a patch.
    max_row_step: usize,
}

impl<const C: usize> Task for BandTask<'_, C> {
    type Output = Vec<Change>;

    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) -> Vec<Change> {
        let mut changes = Vec::new();
        let mut patch = Patch::new(self.problem, self.max_row_step);
        for n in 0..self.members.len() {
            let index = self.members[n];
            if let Some((to, gain)) = self.improve(simd, index as usize, &mut patch) {
                changes.push(Change { index, to, gain });
            }
        }
        changes
    }
}

/// Extracts the pixels under a shape and returns their error for all of its colours.
struct ParabolaTask<'a, 'b, const C: usize> {
    patch: &'a mut Patch<'b>,
    q: &'a Projected,
    planes: &'a [f32],
    first: usize,
}

impl<const C: usize> Task for ParabolaTask<'_, '_, C> {
    type Output = Parabola;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Parabola {
        self.patch.extract::<S, C>(simd, self.q, (self.planes, self.first));
        self.patch.parabola::<S, C>(simd, self.q)
    }
}

struct QuadraticTask<'a, 'b, const C: usize> {
    patch: &'a Patch<'b>,
    p: &'a Projected,
    g: &'a Gaussian,
    color: [f32; 4],
    parabola: &'a Parabola,
}

impl<const C: usize> Task for QuadraticTask<'_, '_, C> {
    type Output = LocalQuadratic;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> LocalQuadratic {
        self.patch.local_quadratic::<S, C>(simd, (self.p, self.g), self.color, self.parabola)
    }
}

impl<const C: usize> BandTask<'_, C> {
    #[inline(always)]
    fn improve<S: Simd>(&mut self, simd: S, index: usize, patch: &mut Patch<'_>) -> Option<(PackedGaussian, f32)> {
        let (old, cost) = (self.gaussians[index], self.costs.of(index));
        let height = self.problem.scene.height;
        let before = self.quantizer.dequantize(&old);
        let p = Projected::from_gaussian(&before, height);
        // A primitive outside all rows of the picture has no pixels to evaluate.
        if p.rows[0] >= p.rows[1] {
            return None;
        }
        // The patch has a margin for larger and shifted shapes, but excludes rows of other bands, which other threads
        // change.
        let end = self.first + self.planes.len() / ((C + 1) * self.problem.target.stride);
        let rows = reach(&p, height as usize);
        let rows = rows.start.max(self.first)..rows.end.min(end);
        let half = before.extent()[0] * rdo::PATCH_GROWTH + rdo::PATCH_MARGIN;
        let left = (p.center[0] - half).max(0.0) as usize;
        let right = ((p.center[0] + half).max(0.0) as usize + 1).min(self.problem.scene.width as usize);
        if left >= right {
            return None;
        }
        patch.begin::<C>(&p, (rows, left..right));
        let lambda = self.lambda;
        let lattice = self.quantizer.lattice();
        // A candidate has to be better than the current primitive.
        let now = simd.call(ParabolaTask::<C> { patch, q: &p, planes: self.planes, first: self.first });
        let current = now.at(p.color, C) + lambda * (cost.geometry(&old, lattice) + cost.colors(old.color));
        let (mut best, mut best_value) = (old, current);
        let min_bits = cost.min_color_bits();
        let mut consider = |task: &Self, candidate: PackedGaussian, parabola: &Parabola| {
            let geometry = lambda * cost.geometry(&candidate, lattice);
            let minimum = parabola.minimum(C);
            // If even the best colour before rounding, with the fewest bits, is not better, no colour needs to be
            // tried.
            if minimum.is_some_and(|m| parabola.at(m, C) + geometry + lambda * min_bits >= best_value) {
                return;
            }
            let (color, value) = task.best_color(&cost, (parabola, minimum), candidate.color);
            if value + geometry < best_value {
                (best, best_value) = (PackedGaussian { color, ..candidate }, value + geometry);
            }
        };
        // A new colour for the current shape needs no further pass over the pixels. A lower value found here rules out
        // more of the shapes that follow.
        consider(self, old, &now);
        // The colour is optimized for each shape. At the best colour the gradient is that of the minimum error over all
        // colours (envelope theorem), so the quadratic model shows which shapes are worth a pass over the pixels.
        let color = now.minimum(C).unwrap_or(p.color);
        let local_quadratic = simd.call(QuadraticTask::<C> { patch, p: &p, g: &before, color, parabola: &now });
        for candidate in self.moves(&cost, (&old, &before), &local_quadratic).iter() {
            let g = self.quantizer.dequantize(&candidate);
            let q = Projected::from_gaussian(&g, height);
            let wide = g.extent()[0];
            // Outside the patch the error is not known, except beyond the picture's border, where nothing counts.
            let inside = q.rows[0] as usize >= patch.rows.start
                && q.rows[1] as usize <= patch.rows.end
                && q.center[0] - wide >= if left == 0 { f32::NEG_INFINITY } else { left as f32 }
                && q.center[0] + wide
                    <= if right == self.problem.scene.width as usize { f32::INFINITY } else { (right - 1) as f32 };
            if inside && q.rows[0] < q.rows[1] {
                let parabola = simd.call(ParabolaTask::<C> { patch, q: &q, planes: self.planes, first: self.first });
                consider(self, candidate, &parabola);
            }
        }
        // Smaller gains may be caused by rounding of sums.
        if best == old || best_value >= current - 1e-7 * patch.base_error.abs() {
            return None;
        }
        // The remaining primitives of this band must see the change.
        let q = Projected::from_gaussian(&self.quantizer.dequantize(&best), height);
        self.replace(simd, &p, &q);
        Some((best, current - best_value))
    }

    /// Returns the most promising lattice points around `old`: for each neighbouring shape, the positions that suit it
    /// best.
    // WebAssembly has one instruction set, and its modules are to be small.
    #[cfg_attr(target_family = "wasm", inline(never))]
    #[cfg_attr(not(target_family = "wasm"), inline(always))]
    fn moves(
        &self,
        cost: &Cost<'_>,
        (old, before): (&PackedGaussian, &Gaussian),
        local_quadratic: &LocalQuadratic,
    ) -> Moves {
        let lambda = self.lambda;
        let lattice = self.quantizer.lattice();
        let now = cost.geometry(old, lattice);
        let (sin, cos) = before.rotation.strict_sin_cos();
        let [sx, sy] = before.scale;
        let mut moves = Moves::default();
        let mut of_scales = cost.of_scales([old.major, old.minor], lattice);
        for shape in 0..27 {
            let Some(mut p) = neighbor(old, shape, self.quantizer) else { continue };
            let turn = self.quantizer.rotation(p.major, p.minor, p.angle) - before.rotation;
            let turn = turn - std::f32::consts::PI * (turn / std::f32::consts::PI).round();
            let log = |index: u8, scale: f32| (self.quantizer.scale(index) / scale).strict_ln();
            let quadratic = local_quadratic.with_shape([log(p.major, sx), log(p.minor, sy), turn]);
            let [u, v] = quadratic.minimum();
            let (u, v) = (u * sx, v * sy);
            let mean = Vec2::from(before.mean) + u * Vec2::new(cos, sin) + v * Vec2::new(-sin, cos);
            self.quantizer.place(&mut p, mean.into());
            // Shapes with the same scales are consecutive.
            if of_scales.scales != [p.major, p.minor] {
                of_scales = cost.of_scales([p.major, p.minor], lattice);
            }
            let exponents = lattice.exponents(p.major, p.minor, p.angle);
            let bits = lambda * (of_scales.bits(p.angle, exponents) - now);
            let [ex, ey] = exponents.map(|e| (e as f32).strict_exp2());
            // The position nearest to the minimum need not have the smallest error, so its neighbours are compared as
            // well.
            for (x, y) in [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)] {
                let (Some(x), Some(y)) = (p.x.checked_add_signed(x), p.y.checked_add_signed(y)) else { continue };
                let to = PackedGaussian { x, y, ..p };
                let [dx, dy] = [(x as f32 + 0.5) * ex - before.mean[0], (y as f32 + 0.5) * ey - before.mean[1]];
                let value = bits + quadratic.at([(cos * dx + sin * dy) / sx, (cos * dy - sin * dx) / sy]);
                if value < rdo::MAX_APPARENT_LOSS * lambda && to != *old && self.quantizer.holds(&to) {
                    moves.add(value, to);
                }
            }
        }
        moves
    }

    /// Returns the colour integers near the parabola's minimum with the smallest `error + λ·bits`, and that value.
    #[cfg_attr(target_family = "wasm", inline(never))]
    #[cfg_attr(not(target_family = "wasm"), inline(always))]
    fn best_color(
        &self,
        cost: &Cost<'_>,
        (parabola, minimum): (&Parabola, Option<[f32; 4]>),
        old: [i16; 4],
    ) -> ([i16; 4], f32) {
        let lambda = self.lambda;
        let value = |c: [i16; 4]| parabola.at(self.quantizer.dequantize_color(c), C) + lambda * cost.colors(c);
        let mut best = (old, value(old));
        let Some(minimum) = minimum else { return best };
        let axes = self.quantizer.transform_color(minimum);
        let steps = self.quantizer.color_steps();
        let max_color = self.quantizer.most_color().map(f32::from);
        // Leave room for the next larger value, which is tried as well.
        let at = |k: usize, v: f32| (v / steps[k]).floor().clamp(-max_color[k], max_color[k] - 1.0) as i16;
        if C < 3 {
            for k in 0..C {
                let start = best.0;
                for v in at(k, axes[k])..=at(k, axes[k]) + 1 {
                    let mut c = start;
                    c[k] = v;
                    let e = value(c);
                    if e < best.1 {
                        best = (c, e);
                    }
                }
            }
            return best;
        }
        let alpha =
            if C == 4 { (axes[3] / steps[3] + 0.5).floor().clamp(-max_color[3], max_color[3]) as i16 } else { 0 };
        let (co0, cg0) = (at(1, axes[1]), at(2, axes[2]));
        let weights = self.problem.target.channel_amplitude.map(|a| a * a);
        let share = 1.0 / (weights[0] + weights[1] + weights[2]);
        // Shifts of the best luma per unit of error in Co and Cg, which are not orthogonal to luma in RGB.
        let (by_co, by_cg) =
            (0.5 * share * (weights[2] - weights[0]), share * (0.5 * (weights[0] + weights[2]) - 0.5 * weights[1]));
        for co in co0..=co0 + 1 {
            for cg in cg0..=cg0 + 1 {
                let offset = [f32::from(co) * steps[1] - axes[1], f32::from(cg) * steps[2] - axes[2]];
                let luma = at(0, axes[0] + by_co * offset[0] + by_cg * offset[1]);
                for y in luma..=luma + 1 {
                    let c = [y, co, cg, alpha];
                    let e = value(c);
                    if e < best.1 {
                        best = (c, e);
                    }
                }
            }
        }
        best
    }

    /// Replaces `old` by `new` in the sums.
    #[inline(always)]
    fn replace<S: Simd>(&mut self, simd: S, old: &Projected, new: &Projected) {
        let stride = self.problem.target.stride;
        for (p, sign) in [(old, -1.0f32), (new, 1.0)] {
            let planes = (&mut *self.planes, stride);
            kernel::splat::<S, C>(simd, p, (RowSet::ALL, self.first), self.problem.scene.width, planes, sign);
        }
    }
}

/// Returns the `step`th of the 27 shapes within one step of `old` in both scales and the angle, if it exists.
#[inline(always)]
fn neighbor(old: &PackedGaussian, step: i16, quantizer: &Quantizer) -> Option<PackedGaussian> {
    let (major, minor) = (i16::from(old.major) + step / 9 - 1, i16::from(old.minor) + step / 3 % 3 - 1);
    if minor < 0 || major < minor || !quantizer.holds_scale(major) {
        return None;
    }
    let mut p = PackedGaussian { major: major as u8, minor: minor as u8, ..*old };
    let lattice = quantizer.lattice();
    let (before, n) = (lattice.angles(old.major, old.minor), lattice.angles(p.major, p.minor));
    if n != before {
        p.angle = ((f32::from(p.angle) * f32::from(n) / f32::from(before) + 0.5).floor() as u16) % n;
    }
    match step % 3 {
        0 if n >= 2 => p.angle = (p.angle + n - 1) % n,
        1 => {}
        2 if n > 2 => p.angle = (p.angle + 1) % n,
        _ => return None,
    }
    Some(p)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bitstream::splats::Layout;
    use crate::fit::model::drawing::project::Primitive;
    use crate::fit::model::objective::masking;
    use crate::fit::model::objective::planes::Planes;
    use crate::fit::model::problem::Scene;
    use crate::gaussian::{Blend, Channels};
    use crate::options::HiddenColors;
    use crate::pixels::{Pixels, Samples};
    use crate::rdo::rounded::{Rounded, quantizer};

    #[test]
    fn the_gain_of_a_sweep_equals_the_decrease_of_the_weighted_error() {
        // Smooth and busy content, far enough from black and white that nothing is clamped.
        let (width, height) = (96u32, 80u32);
        let all = [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba];
        for (channels, hidden) in
            all.into_iter().flat_map(|c| [HiddenColors::Continue, HiddenColors::Keep].map(|h| (c, h)))
        {
            let value = |x: u32, y: u32, k: u32| 128.0 + 50.0 * (0.1 * (x + k) as f32).sin() + (x * y % 23) as f32;
            let count = channels.count() as u32;
            let samples = (0..width * height * count)
                .map(|i| value(i / count % width, i / count / width, i % count) as u8)
                .collect();
            let pixels = Pixels::new(width, height, channels, Samples::U8(samples)).unwrap();
            let mut target = Planes::with_hidden(&pixels, hidden);
            target.amplitude = masking::amplitudes(&target, 120);
            target.channel_amplitude = [0.9, 1.3, 0.6, 1.1];
            for blend in [Blend::Normalized, Blend::Sum] {
                let scene = Scene { width, height, blend, background: target.mean };
                let problem = Problem { scene, target: &target };
                let primitives: Vec<Primitive> = (0..120u32)
                    .map(|i| {
                        let f = |k: u32| (f64::from(i) * f64::from(k).sqrt()).fract() as f32;
                        let color = match blend {
                            Blend::Normalized => [f(7), f(11), f(13), f(17)].map(|v| 0.3 + 0.4 * v),
                            Blend::Sum => [f(7), f(11), f(13), f(17)].map(|v| 0.1 * v - 0.05),
                        };
                        let mean = [96.0 * f(2), 80.0 * f(3)];
                        Primitive { mean, log_scale: [1.5 + f(5), 1.0 + f(19)], rotation: 3.0 * f(23), color }
                    })
                    .collect();
                let Rounded { steps, mut gaussians, .. } = Rounded::nearest(&problem, Layout::Coded, &primitives);
                let quantizer = quantizer(&problem, Layout::Coded, &steps);
                let mut descent = Descent::new(problem, &quantizer, Field::default());
                let before = descent.error(&gaussians);
                let swept = descent.sweep(&mut gaussians, &[], 0.0);
                let fall = before - descent.error(&gaussians);
                // Sums of several thousand pixels in f32, a few of them at a time.
                assert!((swept / fall - 1.0).abs() < 1e-3, "{channels:?} {hidden:?} {blend:?} {} {fall}", swept);
                assert!(fall > 0.1 * before, "{fall} {before}");
            }
        }
    }
}
