//! Descent over the integers, block by block: each primitive in turn takes the lattice point around, with the best colour
//! for it, that lowers `squared error + λ·bits` most, or goes away.
//!
//! For a given shape the picture is linear in the primitive's colour once its weight is fixed, so that one pass over
//! the support gives the error for every colour. Another one tells how the error bends with the shape: of the shapes
//! and positions around, only those are drawn that promise something. Primitives in disjoint bands of rows run in
//! parallel.

use crate::bitstream::splats::PackedGaussian;
use crate::fit::bowl::{Bowl, Moves};
use crate::fit::field::{Field, Output, RowSet, Scene};
use crate::fit::is_large;
use crate::fit::kernel::{self, Strip, Visit};
use crate::fit::project::Projected;
use crate::fit::rates::Rates;
use crate::fit::target::Target;
use crate::gaussian::{Blend, CUTOFF_WEIGHT, EPSILON, Gaussian};
use crate::parallel;
use crate::quantize::Quantizer;
use crate::simd::{self, LANES, Simd, Task};

/// Height of the smallest bands, rows.
const BAND: usize = 96;

/// Rows of a primitive's support, on a large picture, for one that is looked at.
const TALL: usize = 32;

/// Most rows in one that is looked at.
const MOST_ROWS: usize = 4;

/// Bits by which a move may look worse than none and still be looked at: how well its colour can be rounded is not
/// known before.
const SLACK: f32 = 3.0;

/// What one sweep did.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sweep {
    pub changed: usize,
    pub removed: usize,
    /// Fall of the objective.
    pub gain: f64,
}

/// Which parts of the picture changed lately: a primitive whose surroundings rest need not be tried again.
#[derive(Debug)]
pub(crate) struct Activity {
    /// The sweep in which a cell of `CELL²` pixels changed last.
    stamps: Vec<u32>,
    cols: usize,
    sweep: u32,
}

/// Side of an activity cell, pixels.
const CELL: usize = 16;

impl Activity {
    pub(crate) fn new(width: u32, height: u32) -> Self {
        let (cols, rows) = ((width as usize).div_ceil(CELL), (height as usize).div_ceil(CELL));
        Activity { stamps: vec![1; cols * rows], cols, sweep: 1 }
    }

    /// The cells under the support of `g`.
    fn cells(&self, g: &Gaussian) -> impl Iterator<Item = usize> + use<> {
        let [hx, hy] = g.extent();
        let (cols, rows) = (self.cols, self.stamps.len() / self.cols);
        let span = |m: f32, h: f32, n: usize| {
            let cell = |v: f32| ((v.max(0.0) / CELL as f32) as usize).min(n - 1);
            cell(m - h)..=cell(m + h)
        };
        let across = span(g.mean[0], hx, cols);
        span(g.mean[1], hy, rows).flat_map(move |y| across.clone().map(move |x| y * cols + x))
    }

    /// Notes that `g` came, went or changed.
    pub(crate) fn mark(&mut self, g: &Gaussian) {
        for i in self.cells(g) {
            self.stamps[i] = self.sweep;
        }
    }

    /// Whether anything under `g` changed in this sweep or the one before.
    fn stirred(&self, g: &Gaussian) -> bool {
        self.cells(g).any(|i| self.stamps[i] + 1 >= self.sweep)
    }
}

/// Settings of a sweep.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Objective {
    /// Squared error per bit.
    pub lambda: f32,
    /// Bits of a primitive beyond those that [`Rates`] knows: its position at step 1. Minus infinity: never remove.
    pub position_bits: f32,
}

/// One sweep over all primitives. `gaussians` keeps its order; removed ones are taken out.
#[allow(clippy::too_many_arguments)]
pub(crate) fn sweep(
    scene: &Scene,
    target: &Target,
    quantizer: &Quantizer,
    gaussians: &mut Vec<PackedGaussian>,
    objective: &Objective,
    activity: &mut Activity,
    field: &mut Field,
) -> Sweep {
    match target.channels.count() {
        1 => sweep_channels::<1>(scene, target, quantizer, gaussians, objective, activity, field),
        2 => sweep_channels::<2>(scene, target, quantizer, gaussians, objective, activity, field),
        3 => sweep_channels::<3>(scene, target, quantizer, gaussians, objective, activity, field),
        _ => sweep_channels::<4>(scene, target, quantizer, gaussians, objective, activity, field),
    }
}

#[allow(clippy::too_many_arguments)]
fn sweep_channels<const C: usize>(
    scene: &Scene,
    target: &Target,
    quantizer: &Quantizer,
    gaussians: &mut Vec<PackedGaussian>,
    objective: &Objective,
    activity: &mut Activity,
    field: &mut Field,
) -> Sweep {
    activity.sweep += 1;
    let rates = Rates::measure(gaussians, C);
    let floats: Vec<Gaussian> = gaussians.iter().map(|g| quantizer.dequantize(g)).collect();
    let projected: Vec<Projected> = floats.iter().map(|g| Projected::from_gaussian(g, scene.height)).collect();
    field.draw(scene, target, &projected, RowSet::ALL, Output::Sums);
    let row_size = (C + 1) * target.stride;
    let height = scene.height as usize;
    let mut waiting: Vec<u32> =
        (0..gaussians.len() as u32).filter(|&i| activity.stirred(&floats[i as usize])).collect();
    let mut removed = vec![false; gaussians.len()];
    let mut result = Sweep::default();
    let mut band = BAND;
    while !waiting.is_empty() {
        for offset in [0, band / 2] {
            // Whole bands first, the same ones shifted by half a band next, then larger ones.
            let fits = |i: u32| -> Option<usize> {
                let rows = reach(&projected[i as usize], height);
                if rows.start < offset && band < height {
                    return None;
                }
                let b = rows.start.saturating_sub(offset) / band;
                (band >= height || rows.end <= offset + (b + 1) * band).then_some(if band >= height { 0 } else { b })
            };
            let offset = if band >= height { 0 } else { offset };
            if offset >= height {
                continue;
            }
            let bands = (height - offset).div_ceil(band);
            let mut members: Vec<Vec<u32>> = vec![Vec::new(); bands];
            waiting.retain(|&i| match fits(i) {
                Some(b) => {
                    members[b].push(i);
                    false
                }
                None => true,
            });
            let planes = &mut field.planes[offset * row_size..];
            let changes = parallel::map_chunks(planes, band * row_size, |b, planes| {
                let task = BandTask::<C> {
                    scene,
                    target,
                    quantizer,
                    rates: &rates,
                    objective,
                    gaussians,
                    members: &members[b],
                    planes,
                    first: offset + b * band,
                };
                simd::dispatch(task)
            });
            for change in changes.into_iter().flatten() {
                result.gain += f64::from(change.gain);
                activity.mark(&floats[change.index as usize]);
                match change.to {
                    Some(g) => {
                        activity.mark(&quantizer.dequantize(&g));
                        gaussians[change.index as usize] = g;
                        result.changed += 1;
                    }
                    None => {
                        removed[change.index as usize] = true;
                        result.removed += 1;
                    }
                }
            }
            if band >= height {
                break;
            }
        }
        band *= 4;
    }
    let mut i = 0;
    gaussians.retain(|_| {
        i += 1;
        !removed[i - 1]
    });
    result
}

/// The rows that a primitive and its neighbours on the lattice may touch.
fn reach(p: &Projected, height: usize) -> std::ops::Range<usize> {
    let tall = (p.rows[1] - p.rows[0]) as usize;
    let margin = tall / 4 + 2;
    (p.rows[0] as usize).saturating_sub(margin)..(p.rows[1] as usize + margin).min(height)
}

struct Change {
    index: u32,
    to: Option<PackedGaussian>,
    gain: f32,
}

struct BandTask<'a, const C: usize> {
    scene: &'a Scene,
    target: &'a Target,
    quantizer: &'a Quantizer,
    rates: &'a Rates,
    objective: &'a Objective,
    gaussians: &'a [PackedGaussian],
    members: &'a [u32],
    planes: &'a mut [f32],
    first: usize,
}

/// The pixels around one primitive, with that primitive taken out.
#[derive(Default)]
struct Patch {
    /// Rows of `2C + 2` planes, `stride` floats each: `Σwc` with `εb` (C), `Σw + ε`, targets (C), squared error.
    planes: Vec<f32>,
    stride: usize,
    columns: std::ops::Range<usize>,
    rows: std::ops::Range<usize>,
    /// Only every `step`th of them is there, and counts for all.
    step: usize,
    /// Squared error over the patch without the primitive.
    bare: f32,
}

/// Error of the patch as a function of the colour: `rest + Σ 2 c·cross + c²·square`, relative to `Patch::bare`.
#[derive(Clone, Copy)]
struct Parabola {
    rest: f32,
    cross: [f32; 4],
    square: [f32; 2],
}

impl Patch {
    /// Which of the rows that are there lie inside `rows`.
    fn range(&self, rows: [u32; 2]) -> std::ops::Range<usize> {
        let [from, to] = rows.map(|y| (y as usize).clamp(self.rows.start, self.rows.end) - self.rows.start);
        from.div_ceil(self.step)..to.div_ceil(self.step)
    }

    /// The number in the picture of the `i`th row that is there.
    #[inline(always)]
    fn row(&self, i: usize) -> u32 {
        (self.rows.start + i * self.step) as u32
    }
}

impl Parabola {
    #[inline(always)]
    fn at(&self, c: [f32; 4], channels: usize) -> f32 {
        let mut e = self.rest;
        for k in 0..channels {
            e += c[k] * (2.0 * self.cross[k] + c[k] * self.square(k, channels));
        }
        e
    }

    /// `Σ r²` of channel `k`; alpha is weighted differently from colour.
    #[inline(always)]
    fn square(&self, k: usize, channels: usize) -> f32 {
        self.square[usize::from(channels.is_multiple_of(2) && k + 1 == channels)]
    }

    /// The colour of the least error, unless nearly all are as good.
    #[inline(always)]
    fn minimum(&self, channels: usize) -> Option<[f32; 4]> {
        let mut c = [0.0f32; 4];
        for k in 0..channels {
            let square = self.square(k, channels);
            if square < 1e-6 {
                return None;
            }
            c[k] = (-self.cross[k] / square).clamp(-4.0, 4.0);
        }
        Some(c)
    }
}

impl<const C: usize> Task for BandTask<'_, C> {
    type Output = Vec<Change>;

    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) -> Vec<Change> {
        let mut changes = Vec::new();
        let mut patch = Patch::default();
        for n in 0..self.members.len() {
            let index = self.members[n];
            let old = self.gaussians[index as usize];
            if let Some((to, gain)) = self.improve(simd, old, &mut patch) {
                changes.push(Change { index, to, gain });
            }
        }
        changes
    }
}

impl<const C: usize> BandTask<'_, C> {
    #[inline(always)]
    fn improve<S: Simd>(
        &mut self,
        simd: S,
        old: PackedGaussian,
        patch: &mut Patch,
    ) -> Option<(Option<PackedGaussian>, f32)> {
        let height = self.scene.height;
        let before = self.quantizer.dequantize(&old);
        let p = Projected::from_gaussian(&before, height);
        if p.rows[0] >= p.rows[1] {
            return None;
        }
        let end = self.first + self.planes.len() / ((C + 1) * self.target.stride);
        let rows = reach(&p, height as usize);
        let rows = rows.start.max(self.first)..rows.end.min(end);
        let half = before.extent()[0] * 1.25 + 2.0 + LANES as f32;
        let left = (p.center[0] - half).max(0.0) as usize;
        let right = ((p.center[0] + half).max(0.0) as usize + 1).min(self.scene.width as usize);
        if left >= right {
            return None;
        }
        self.cut(simd, &p, rows, (left, right), patch);

        let lambda = self.objective.lambda;
        let lattice = self.quantizer.lattice();
        let now = self.parabola(simd, &p, patch);
        let current = now.at(p.color, C) + lambda * (self.rates.geometry(&old, lattice) + self.rates.colors(old.color));
        let (mut best, mut best_value) = (old, current);
        let mut consider = |task: &Self, candidate: PackedGaussian, parabola: &Parabola| {
            let geometry = lambda * task.rates.geometry(&candidate, lattice);
            let (color, value) = task.best_color(parabola, candidate.color);
            if value + geometry < best_value {
                (best, best_value) = (PackedGaussian { color, ..candidate }, value + geometry);
            }
        };
        consider(self, old, &now);
        // By the envelope theorem the gradient is that of the least error over all colours.
        let bowl = self.bowl(simd, (&p, &before), now.minimum(C).unwrap_or(p.color), &now, patch);
        for candidate in self.moves(&old, &before, &bowl).iter() {
            let g = self.quantizer.dequantize(&candidate);
            let q = Projected::from_gaussian(&g, height);
            let wide = g.extent()[0];
            let inside = q.rows[0] as usize >= patch.rows.start
                && q.rows[1] as usize <= patch.rows.end
                && q.center[0] - wide >= if left == 0 { f32::NEG_INFINITY } else { left as f32 }
                && q.center[0] + wide
                    <= if right == self.scene.width as usize { f32::INFINITY } else { (right - 1) as f32 };
            if inside && q.rows[0] < q.rows[1] {
                let parabola = self.parabola(simd, &q, patch);
                consider(self, candidate, &parabola);
            }
        }
        // Without it, the patch keeps its bare error, which is 0 in these units.
        let removal = -lambda * self.objective.position_bits;
        if removal < best_value {
            self.paste(simd, &p, None);
            return Some((None, current - removal));
        }
        if best == old || best_value >= current - 1e-7 * patch.bare.abs() {
            return None;
        }
        let q = Projected::from_gaussian(&self.quantizer.dequantize(&best), height);
        self.paste(simd, &p, Some(&q));
        Some((Some(best), current - best_value))
    }

    /// Copies the pixels around `p` into `patch`, with `p` taken out.
    #[inline(always)]
    fn cut<S: Simd>(
        &self,
        simd: S,
        p: &Projected,
        rows: std::ops::Range<usize>,
        (left, right): (usize, usize),
        patch: &mut Patch,
    ) {
        let stride = self.target.stride;
        let width = (right - left).next_multiple_of(LANES) + LANES;
        patch.stride = width;
        patch.columns = left..right;
        patch.rows = rows.clone();
        patch.step = self.row_step(p);
        patch.planes.resize((2 * C + 2) * width * rows.len().div_ceil(patch.step), 0.0);
        let alpha = self.target.channels.alpha();
        let (zero, one) = (simd.splat(0.0), simd.splat(1.0));
        let epsilon = simd.splat(EPSILON);
        let mut bare = zero;
        for (y, out) in rows.step_by(patch.step).zip(patch.planes.chunks_exact_mut((2 * C + 2) * width)) {
            let row = &self.planes[(y - self.first) * (C + 1) * stride..][..(C + 1) * stride];
            let target = self.target.row(y as u32);
            let span = p.span(y as u32, self.scene.width);
            let amplitude = self.target.amplitude(y as u32);
            for o in (0..width).step_by(LANES) {
                let x = left + o;
                // Past the right end of the patch nothing counts.
                if x >= right {
                    for k in 0..2 * C + 2 {
                        simd.write(&mut out[k * width + o..], if k == C { one } else { zero });
                    }
                    continue;
                }
                let limit = simd.splat((right - x) as f32 - 0.5);
                let own = match span {
                    Some((first, end, dy)) if x + LANES > first && x < end => {
                        let e = kernel::at(simd, p, x, dy);
                        simd.keep_above(simd.max(simd.sub(e, simd.splat(CUTOFF_WEIGHT)), zero), limit, simd.index())
                    }
                    _ => zero,
                };
                let all = simd.read(&row[C * stride + x..]);
                let (with, without) = match self.scene.blend {
                    Blend::Normalized => {
                        (simd.add(all, epsilon), simd.add(simd.max(simd.sub(all, own), zero), epsilon))
                    }
                    Blend::Sum => (one, one),
                };
                let (with, share) = (simd.div(one, with), simd.div(one, without));
                let mut error = zero;
                for k in 0..C {
                    let sum = simd.add(simd.read(&row[k * stride + x..]), simd.splat(self.shift(k)));
                    let n = simd.sub(sum, simd.mul(own, simd.splat(p.color[k])));
                    let mut t = simd.read(&target[k * stride + x..]);
                    // Overshoot of a saturated pixel is clamped away: as long as it stays, it is no error.
                    let beyond = simd.sub(simd.mul(sum, with), t);
                    let above = simd.keep_above(simd.max(beyond, zero), t, simd.splat(1.0f32.next_down()));
                    let below = simd.keep_above(simd.min(beyond, zero), simd.splat(f32::MIN_POSITIVE), t);
                    t = simd.add(simd.add(t, above), below);
                    let mut d = simd.sub(simd.mul(n, share), t);
                    if let Some(a) = alpha.filter(|&a| a != k) {
                        d = simd.mul(d, simd.read(&target[a * stride + x..]));
                    }
                    if let Some(a) = amplitude {
                        d = simd.mul(d, simd.read(&a[x..]));
                    }
                    error = simd.add(error, simd.mul(d, d));
                    simd.write(&mut out[k * width + o..], n);
                    simd.write(&mut out[(C + 1 + k) * width + o..], t);
                }
                let error = simd.keep_above(error, limit, simd.index());
                simd.write(&mut out[C * width + o..], without);
                simd.write(&mut out[(2 * C + 1) * width + o..], error);
                bare = simd.add(bare, error);
            }
        }
        patch.bare = simd.sum(bare) * patch.step as f32;
    }

    /// Rows in one that is looked at: on a large picture tall primitives have more pixels than it takes to decide.
    fn row_step(&self, p: &Projected) -> usize {
        let tall = (p.rows[1] - p.rows[0]) as usize;
        if is_large(self.scene) { (tall / TALL).clamp(1, MOST_ROWS) } else { 1 }
    }

    /// What is added to `Σwc` of channel `k` before the division.
    #[inline(always)]
    fn shift(&self, k: usize) -> f32 {
        match self.scene.blend {
            Blend::Normalized => EPSILON * self.scene.background[k],
            Blend::Sum => self.scene.background[k],
        }
    }

    /// The error over the patch with `q` in it, for any colour, minus the bare error.
    #[inline(always)]
    fn parabola<S: Simd>(&self, simd: S, q: &Projected, patch: &Patch) -> Parabola {
        let (zero, range) = (simd.splat(0.0), patch.range(q.rows));
        let mut errors = Errors {
            pixels: Pixels { scene: self.scene, target: self.target, patch, first: range.start },
            rest: zero,
            cross: [zero; C],
            square: [zero; 2],
        };
        self.walk(simd, q, range, patch, &mut errors);
        let scale = patch.step as f32;
        let mut out = Parabola {
            rest: simd.sum(errors.rest) * scale,
            cross: [0.0; 4],
            square: [simd.sum(errors.square[0]), simd.sum(errors.square[1])].map(|s| s * scale),
        };
        for k in 0..C {
            out.cross[k] = simd.sum(errors.cross[k]) * scale;
        }
        out
    }

    /// Visits the pixels of `p` in the rows `range` of the patch.
    #[inline(always)]
    fn walk<S: Simd>(
        &self,
        simd: S,
        p: &Projected,
        range: std::ops::Range<usize>,
        patch: &Patch,
        visitor: &mut impl Visit<S>,
    ) {
        let dy = patch.row(range.start) as f32 - p.center[1];
        kernel::walk(simd, p, (dy, patch.step as f32, range.len()), patch.columns.clone(), visitor);
    }

    /// How the error over the patch with `p`, the projection of `g`, in it and of `color` changes with mean, scales and
    /// rotation, to second order.
    #[inline(always)]
    fn bowl<S: Simd>(
        &self,
        simd: S,
        (p, g): (&Projected, &Gaussian),
        color: [f32; 4],
        parabola: &Parabola,
        patch: &Patch,
    ) -> Bowl {
        let (zero, range) = (simd.splat(0.0), patch.range(p.rows));
        let (sin, cos) = g.rotation.sin_cos();
        let [sx, sy] = g.scale;
        let mut slopes = Slopes {
            pixels: Pixels { scene: self.scene, target: self.target, patch, first: range.start },
            color,
            across: [cos / sx, sin / sx],
            along: [-sin / sy, cos / sy],
            turn: sx / sy - sy / sx,
            first: [zero; 5],
            second: [zero; 15],
            mixed: [[zero; 5]; C],
        };
        self.walk(simd, p, range, patch, &mut slopes);
        let scale = patch.step as f32;
        let mut bowl = Bowl::default();
        let mut mixed = [[0.0; 5]; C];
        let mut n = 0;
        for a in 0..5 {
            bowl.slope[a] = simd.sum(slopes.first[a]) * scale;
            for k in 0..C {
                mixed[k][a] = simd.sum(slopes.mixed[k][a]) * scale;
            }
            for b in 0..=a {
                let mut v = simd.sum(slopes.second[n]) * scale;
                for (k, of) in mixed.iter().enumerate() {
                    // The colour follows.
                    v -= of[a] * of[b] / (parabola.square(k, C) + 1e-6);
                }
                (bowl.curvature[a][b], bowl.curvature[b][a]) = (v, v);
                n += 1;
            }
        }
        bowl
    }

    /// The lattice points around `old` that promise most: for each neighbouring shape the positions that suit it best.
    #[inline(always)]
    fn moves(&self, old: &PackedGaussian, before: &Gaussian, bowl: &Bowl) -> Moves {
        let lambda = self.objective.lambda;
        let lattice = self.quantizer.lattice();
        let now = self.rates.geometry(old, lattice);
        let (sin, cos) = before.rotation.sin_cos();
        let [sx, sy] = before.scale;
        let mut moves = Moves::default();
        for shape in 0..27 {
            let Some(mut p) = neighbor(old, shape, self.quantizer) else { continue };
            let turn = self.quantizer.rotation(p.major, p.minor, p.angle) - before.rotation;
            let turn = turn - std::f32::consts::PI * (turn / std::f32::consts::PI).round();
            let log = |index: u8, scale: f32| (self.quantizer.scale(index) / scale).ln();
            let valley = bowl.given([log(p.major, sx), log(p.minor, sy), turn]);
            let [u, v] = valley.lowest();
            let (u, v) = (u * sx, v * sy);
            self.quantizer.place(&mut p, [before.mean[0] + cos * u - sin * v, before.mean[1] + sin * u + cos * v]);
            let bits = lambda * (self.rates.geometry(&p, lattice) - now);
            let [ex, ey] = lattice.exponents(p.major, p.minor, p.angle).map(|e| (e as f32).exp2());
            // What is nearest in the metric of the shape need not be lowest.
            for (x, y) in [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)] {
                let (Some(x), Some(y)) = (p.x.checked_add_signed(x), p.y.checked_add_signed(y)) else { continue };
                let to = PackedGaussian { x, y, ..p };
                let [dx, dy] = [(x as f32 + 0.5) * ex - before.mean[0], (y as f32 + 0.5) * ey - before.mean[1]];
                let value = bits + valley.at([(cos * dx + sin * dy) / sx, (cos * dy - sin * dx) / sy]);
                if value < SLACK * lambda && to != *old && self.quantizer.holds(&to) {
                    moves.add(value, to);
                }
            }
        }
        moves
    }

    /// The colour integers with the least `error + λ·bits`, near the parabola's minimum, and that value.
    #[inline(always)]
    fn best_color(&self, parabola: &Parabola, old: [i16; 4]) -> ([i16; 4], f32) {
        let lambda = self.objective.lambda;
        let value = |c: [i16; 4]| parabola.at(self.quantizer.dequantize_color(c), C) + lambda * self.rates.colors(c);
        let mut best = (old, value(old));
        let Some(minimum) = parabola.minimum(C) else { return best };
        let axes = self.quantizer.transform_color(minimum);
        let steps = self.quantizer.color_steps();
        let at = |k: usize, v: f32| (v / steps[k]).floor().clamp(-30000.0, 30000.0) as i16;
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
        let alpha = if C == 4 { (axes[3] / steps[3] + 0.5).floor().clamp(-30000.0, 30000.0) as i16 } else { 0 };
        let (co0, cg0) = (at(1, axes[1]), at(2, axes[2]));
        for co in co0..=co0 + 1 {
            for cg in cg0..=cg0 + 1 {
                // Luma and Cg are not orthogonal in RGB: the rest of Cg's rounding moves the best luma by a sixth.
                let left = f32::from(cg) * steps[2] - axes[2];
                let luma = at(0, axes[0] + left / 6.0);
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
    fn paste<S: Simd>(&mut self, simd: S, old: &Projected, new: Option<&Projected>) {
        let stride = self.target.stride;
        for (p, sign) in [(Some(old), -1.0f32), (new, 1.0)] {
            let Some(p) = p else { continue };
            let planes = (&mut *self.planes, stride);
            kernel::splat::<S, C>(simd, p, (RowSet::ALL, self.first), self.scene.width, planes, sign);
        }
    }
}

/// The pixels of a patch under a primitive.
struct Pixels<'a> {
    scene: &'a Scene,
    target: &'a Target,
    patch: &'a Patch,
    /// The first row that is visited, among those that are there.
    first: usize,
}

/// Eight pixels of a patch.
struct Eight<'a> {
    /// The row's planes from these pixels on.
    planes: &'a [f32],
    stride: usize,
    /// The factors of errors.
    amplitude: Option<&'a [f32]>,
    /// The channel whose target is a factor of the others' errors.
    alpha: Option<usize>,
    blend: Blend,
}

impl Pixels<'_> {
    #[inline(always)]
    fn eight<const C: usize>(&self, i: usize, x: usize) -> Eight<'_> {
        let (i, stride) = (self.first + i, self.patch.stride);
        Eight {
            planes: &self.patch.planes[i * (2 * C + 2) * stride + x - self.patch.columns.start..],
            stride,
            amplitude: self.target.amplitude(self.patch.row(i)).map(|a| &a[x..]),
            alpha: self.target.channels.alpha(),
            blend: self.scene.blend,
        }
    }
}

impl Eight<'_> {
    #[inline(always)]
    fn plane<S: Simd>(&self, simd: S, k: usize) -> S::Vector {
        simd.read(&self.planes[k * self.stride..])
    }

    /// What the sums are multiplied by if the weight `w` joins them.
    #[inline(always)]
    fn share<S: Simd, const C: usize>(&self, simd: S, w: S::Vector) -> S::Vector {
        match self.blend {
            Blend::Normalized => simd.div(simd.splat(1.0), simd.add(self.plane(simd, C), w)),
            Blend::Sum => simd.splat(1.0),
        }
    }

    /// `v`, which belongs to channel `k`, times what errors of these pixels count.
    #[inline(always)]
    fn weighted<S: Simd, const C: usize>(&self, simd: S, k: usize, mut v: S::Vector) -> S::Vector {
        if let Some(a) = self.amplitude {
            v = simd.mul(v, simd.read(a));
        }
        if let Some(plane) = self.alpha.filter(|&a| a != k) {
            v = simd.mul(v, self.plane(simd, C + 1 + plane));
        }
        v
    }
}

/// Sums a [`Parabola`].
struct Errors<'a, S: Simd, const C: usize> {
    pixels: Pixels<'a>,
    rest: S::Vector,
    cross: [S::Vector; C],
    square: [S::Vector; 2],
}

impl<S: Simd, const C: usize> Visit<S> for Errors<'_, S, C> {
    #[inline(always)]
    fn pixels(&mut self, simd: S, strip: &Strip<S>, i: usize, g: S::Vector, _dy: S::Vector) {
        let zero = simd.splat(0.0);
        let at = self.pixels.eight::<C>(i, strip.x);
        let w = simd.max(simd.sub(g, strip.edge), zero);
        let share = at.share::<S, C>(simd, w);
        let part = simd.mul(w, share);
        let mut error = zero;
        for k in 0..C {
            let a = simd.sub(simd.mul(at.plane(simd, k), share), at.plane(simd, C + 1 + k));
            let a = at.weighted::<S, C>(simd, k, a);
            let r = at.weighted::<S, C>(simd, k, part);
            error = simd.add(error, simd.mul(a, a));
            self.cross[k] = simd.add(self.cross[k], simd.mul(a, r));
            if k == 0 || at.alpha == Some(k) {
                let s = usize::from(k != 0);
                self.square[s] = simd.add(self.square[s], simd.mul(r, r));
            }
        }
        let more = simd.sub(error, at.plane(simd, 2 * C + 1));
        self.rest = simd.add(self.rest, simd.keep_above(more, w, zero));
    }
}

/// Sums a [`Bowl`].
struct Slopes<'a, S: Simd, const C: usize> {
    pixels: Pixels<'a>,
    color: [f32; 4],
    /// Along the rotated x axis, in units of its scale, per pixel to the right and down.
    across: [f32; 2],
    /// The same along the rotated y axis.
    along: [f32; 2],
    /// What a rotation moves for each `u·v`.
    turn: f32,
    first: [S::Vector; 5],
    second: [S::Vector; 15],
    mixed: [[S::Vector; 5]; C],
}

impl<S: Simd, const C: usize> Visit<S> for Slopes<'_, S, C> {
    #[inline(always)]
    fn pixels(&mut self, simd: S, strip: &Strip<S>, i: usize, g: S::Vector, dy: S::Vector) {
        let at = self.pixels.eight::<C>(i, strip.x);
        let e = simd.keep_above(g, g, strip.edge);
        let w = simd.max(simd.sub(g, strip.edge), simd.splat(0.0));
        let share = at.share::<S, C>(simd, w);
        let ([ux, uy], [vx, vy]) = (self.across, self.along);
        let u = simd.add(simd.mul(simd.splat(ux), strip.dx), simd.mul(simd.splat(uy), dy));
        let v = simd.add(simd.mul(simd.splat(vx), strip.dx), simd.mul(simd.splat(vy), dy));
        let turn = simd.mul(simd.mul(simd.splat(self.turn), u), v);
        let features = [u, v, simd.mul(u, u), simd.mul(v, v), turn];
        let mut t = simd.splat(0.0);
        let mut square = simd.splat(0.0);
        for k in 0..C {
            let color = simd.splat(self.color[k]);
            let value = simd.mul(simd.add(at.plane(simd, k), simd.mul(w, color)), share);
            let own = match at.blend {
                Blend::Normalized => simd.mul(simd.mul(simd.sub(color, value), share), e),
                Blend::Sum => simd.mul(color, e),
            };
            let own = at.weighted::<S, C>(simd, k, own);
            let error = at.weighted::<S, C>(simd, k, simd.sub(value, at.plane(simd, C + 1 + k)));
            t = simd.add(t, simd.mul(error, own));
            square = simd.add(square, simd.mul(own, own));
            let shown = at.weighted::<S, C>(simd, k, simd.mul(simd.mul(own, w), share));
            for (sum, f) in self.mixed[k].iter_mut().zip(features) {
                *sum = simd.add(*sum, simd.mul(shown, f));
            }
        }
        let mut n = 0;
        for (a, &f) in features.iter().enumerate() {
            self.first[a] = simd.add(self.first[a], simd.mul(t, f));
            let scaled = simd.mul(square, f);
            for &other in &features[..=a] {
                self.second[n] = simd.add(self.second[n], simd.mul(scaled, other));
                n += 1;
            }
        }
    }
}

/// The `step`th of the 27 shapes within one step of `old` in both scales and the angle, if there is such a one.
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
