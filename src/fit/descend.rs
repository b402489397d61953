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
use crate::fit::kernel::{self, LANES, Lanes, RowExponent};
use crate::fit::project::Projected;
use crate::fit::rates::Rates;
use crate::fit::target::Target;
use crate::gaussian::{Blend, CUTOFF_WEIGHT, EPSILON, Gaussian};
use crate::parallel;
use crate::quantize::Quantizer;

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
    let arch = pulp::Arch::new();
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
                arch.dispatch(task)
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
    left: usize,
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
    /// The rows that are there and inside `rows`, with their planes.
    #[inline(always)]
    fn rows(&self, rows: [u32; 2], channels: usize) -> impl Iterator<Item = (u32, &[f32])> {
        let [from, to] = rows.map(|y| (y as usize).clamp(self.rows.start, self.rows.end) - self.rows.start);
        let size = (2 * channels + 2) * self.stride;
        (from.div_ceil(self.step)..to.div_ceil(self.step))
            .map(move |i| ((self.rows.start + i * self.step) as u32, &self.planes[i * size..][..size]))
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

impl<const C: usize> pulp::WithSimd for BandTask<'_, C> {
    type Output = Vec<Change>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(mut self, _: S) -> Vec<Change> {
        let mut changes = Vec::new();
        let mut patch = Patch::default();
        for n in 0..self.members.len() {
            let index = self.members[n];
            let old = self.gaussians[index as usize];
            if let Some((to, gain)) = self.improve(old, &mut patch) {
                changes.push(Change { index, to, gain });
            }
        }
        changes
    }
}

impl<const C: usize> BandTask<'_, C> {
    #[inline(always)]
    fn improve(&mut self, old: PackedGaussian, patch: &mut Patch) -> Option<(Option<PackedGaussian>, f32)> {
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
        self.cut(&p, rows, left, right, patch);

        let lambda = self.objective.lambda;
        let lattice = self.quantizer.lattice();
        let now = self.parabola(&p, patch);
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
        let bowl = self.bowl(&p, &before, now.minimum(C).unwrap_or(p.color), &now, patch);
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
                let parabola = self.parabola(&q, patch);
                consider(self, candidate, &parabola);
            }
        }
        // Without it, the patch keeps its bare error, which is 0 in these units.
        let removal = -lambda * self.objective.position_bits;
        if removal < best_value {
            self.paste(&p, None);
            return Some((None, current - removal));
        }
        if best == old || best_value >= current - 1e-7 * patch.bare.abs() {
            return None;
        }
        let q = Projected::from_gaussian(&self.quantizer.dequantize(&best), height);
        self.paste(&p, Some(&q));
        Some((Some(best), current - best_value))
    }

    /// Copies the pixels around `p` into `patch`, with `p` taken out.
    #[inline(always)]
    fn cut(&self, p: &Projected, rows: std::ops::Range<usize>, left: usize, right: usize, patch: &mut Patch) {
        let stride = self.target.stride;
        let width = (right - left).next_multiple_of(LANES) + LANES;
        patch.stride = width;
        patch.left = left;
        patch.rows = rows.clone();
        patch.step = self.row_step(p);
        patch.planes.resize((2 * C + 2) * width * rows.len().div_ceil(patch.step), 0.0);
        let alpha = self.target.channels.alpha();
        let mut bare = [0.0f32; LANES];
        for (y, out) in rows.step_by(patch.step).zip(patch.planes.chunks_exact_mut((2 * C + 2) * width)) {
            let row = &self.planes[(y - self.first) * (C + 1) * stride..][..(C + 1) * stride];
            let target = self.target.row(y as u32);
            let span = p.span(y as u32, self.scene.width);
            let exponent = RowExponent::new(p, y as f32 - p.center[1]);
            let amplitude = self.target.amplitude(y as u32);
            let mut x = left;
            let mut o = 0;
            while o < width {
                // Past the right end of the patch nothing counts; the planes are padded, but only by one run.
                if x >= right {
                    for k in 0..2 * C + 2 {
                        kernel::store(out, k * width + o, &[if k == C { 1.0 } else { 0.0 }; LANES]);
                    }
                    (x, o) = (x + LANES, o + LANES);
                    continue;
                }
                let own: Lanes = match span {
                    Some((first, end, _)) if x + LANES > first && x < end => {
                        let (_, e) = exponent.at(x);
                        kernel::lanes(|i| {
                            if e[i] > CUTOFF_WEIGHT && x + i < self.scene.width as usize {
                                e[i] - CUTOFF_WEIGHT
                            } else {
                                0.0
                            }
                        })
                    }
                    _ => [0.0; LANES],
                };
                let all = kernel::load(row, C * stride + x);
                let (with, without) = match self.scene.blend {
                    Blend::Normalized => {
                        (kernel::lanes(|i| all[i] + EPSILON), kernel::lanes(|i| (all[i] - own[i]).max(0.0) + EPSILON))
                    }
                    Blend::Sum => ([1.0; LANES], [1.0; LANES]),
                };
                let mut bare_error = [0.0f32; LANES];
                let inside = kernel::lanes(|i| if x + i < right { 1.0 } else { 0.0 });
                for k in 0..C {
                    let s = kernel::load(row, k * stride + x);
                    let shift = self.shift(k);
                    let n = kernel::lanes(|i| s[i] - own[i] * p.color[k] + shift);
                    let t = kernel::load(target, k * stride + x);
                    // Overshoot of a saturated pixel is clamped away: as long as it stays, it is no error.
                    let v = kernel::lanes(|i| (s[i] + shift) / with[i]);
                    let t = kernel::lanes(|i| {
                        if (t[i] >= 1.0 && v[i] > 1.0) || (t[i] <= 0.0 && v[i] < 0.0) { v[i] } else { t[i] }
                    });
                    let mut weight = match alpha {
                        Some(a) if a != k => kernel::load(target, a * stride + x),
                        _ => [1.0; LANES],
                    };
                    if let Some(a) = amplitude {
                        let a = kernel::load(a, x);
                        weight = kernel::lanes(|i| weight[i] * a[i]);
                    }
                    let d = kernel::lanes(|i| (n[i] / without[i] - t[i]) * weight[i]);
                    bare_error = kernel::lanes(|i| bare_error[i] + d[i] * d[i]);
                    kernel::store(out, k * width + o, &n);
                    kernel::store(out, (C + 1 + k) * width + o, &t);
                }
                bare_error = kernel::lanes(|i| bare_error[i] * inside[i]);
                kernel::store(out, C * width + o, &without);
                kernel::store(out, (2 * C + 1) * width + o, &bare_error);
                bare = kernel::lanes(|i| bare[i] + bare_error[i]);
                (x, o) = (x + LANES, o + LANES);
            }
        }
        patch.bare = kernel::total(&bare) * patch.step as f32;
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
    fn parabola(&self, q: &Projected, patch: &Patch) -> Parabola {
        let width = patch.stride;
        let alpha = self.target.channels.alpha();
        let mut rest = [0.0f32; LANES];
        let mut cross = [[0.0f32; LANES]; C];
        let mut square = [[0.0f32; LANES]; 2];
        for (y, row) in patch.rows(q.rows, C) {
            let Some((first, end, dy)) = q.span(y, self.scene.width) else { continue };
            let exponent = RowExponent::new(q, dy);
            let amplitude = self.target.amplitude(y);
            let mut x = first.max(patch.left);
            while x < end {
                let o = x - patch.left;
                let (_, e) = exponent.at(x);
                let w = kernel::lanes(|i| if e[i] > CUTOFF_WEIGHT && x + i < end { e[i] - CUTOFF_WEIGHT } else { 0.0 });
                let without = kernel::load(row, C * width + o);
                let inv = match self.scene.blend {
                    Blend::Normalized => kernel::lanes(|i| 1.0 / (without[i] + w[i])),
                    Blend::Sum => [1.0; LANES],
                };
                let r = kernel::lanes(|i| w[i] * inv[i]);
                let mut error = [0.0f32; LANES];
                let amplitude = amplitude.map(|a| kernel::load(a, x));
                for k in 0..C {
                    let n = kernel::load(row, k * width + o);
                    let t = kernel::load(row, (C + 1 + k) * width + o);
                    let mut a = kernel::lanes(|i| n[i] * inv[i] - t[i]);
                    let mut r = r;
                    if let Some(m) = amplitude {
                        a = kernel::lanes(|i| a[i] * m[i]);
                        r = kernel::lanes(|i| r[i] * m[i]);
                    }
                    if let (Some(plane), true) = (alpha, alpha != Some(k)) {
                        let weight = kernel::load(row, (C + 1 + plane) * width + o);
                        a = kernel::lanes(|i| a[i] * weight[i]);
                        r = kernel::lanes(|i| r[i] * weight[i]);
                    }
                    error = kernel::lanes(|i| error[i] + a[i] * a[i]);
                    cross[k] = kernel::lanes(|i| cross[k][i] + a[i] * r[i]);
                    if k == 0 || alpha == Some(k) {
                        let s = usize::from(k != 0);
                        square[s] = kernel::lanes(|i| square[s][i] + r[i] * r[i]);
                    }
                }
                let bare = kernel::load(row, (2 * C + 1) * width + o);
                rest = kernel::lanes(|i| rest[i] + if w[i] > 0.0 { error[i] - bare[i] } else { 0.0 });
                x += LANES;
            }
        }
        let total = |sum: &Lanes| kernel::total(sum) * patch.step as f32;
        let mut out = Parabola { rest: total(&rest), cross: [0.0; 4], square: square.map(|s| total(&s)) };
        for k in 0..C {
            out.cross[k] = total(&cross[k]);
        }
        out
    }

    /// How the error over the patch with `p`, the projection of `g`, in it and of `color` changes with mean, scales and
    /// rotation, to second order.
    #[inline(always)]
    fn bowl(&self, p: &Projected, g: &Gaussian, color: [f32; 4], parabola: &Parabola, patch: &Patch) -> Bowl {
        let width = patch.stride;
        let alpha = self.target.channels.alpha();
        let (sin, cos) = g.rotation.sin_cos();
        let [sx, sy] = g.scale;
        let turn = sx / sy - sy / sx;
        let mut first = [[0.0f32; LANES]; 5];
        let mut second = [[0.0f32; LANES]; 15];
        let mut mixed = [[[0.0f32; LANES]; 5]; C];
        for (y, row) in patch.rows(p.rows, C) {
            let Some((start, end, dy)) = p.span(y, self.scene.width) else { continue };
            let exponent = RowExponent::new(p, dy);
            let amplitude = self.target.amplitude(y);
            let mut x = start.max(patch.left);
            while x < end {
                let o = x - patch.left;
                let (dx, e) = exponent.at(x);
                let e = kernel::lanes(|i| if e[i] > CUTOFF_WEIGHT && x + i < end { e[i] } else { 0.0 });
                let w = kernel::lanes(|i| if e[i] > 0.0 { e[i] - CUTOFF_WEIGHT } else { 0.0 });
                let amplitude = amplitude.map(|a| kernel::load(a, x));
                let without = kernel::load(row, C * width + o);
                let inv = match self.scene.blend {
                    Blend::Normalized => kernel::lanes(|i| 1.0 / (without[i] + w[i])),
                    Blend::Sum => [1.0; LANES],
                };
                let u = kernel::lanes(|i| (cos * dx[i] + sin * dy) * (1.0 / sx));
                let v = kernel::lanes(|i| (cos * dy - sin * dx[i]) * (1.0 / sy));
                let features = [
                    u,
                    v,
                    kernel::lanes(|i| u[i] * u[i]),
                    kernel::lanes(|i| v[i] * v[i]),
                    kernel::lanes(|i| turn * u[i] * v[i]),
                ];
                let mut t = [0.0f32; LANES];
                let mut square = [0.0f32; LANES];
                for k in 0..C {
                    let n = kernel::load(row, k * width + o);
                    let wanted = kernel::load(row, (C + 1 + k) * width + o);
                    let value = kernel::lanes(|i| (n[i] + w[i] * color[k]) * inv[i]);
                    let mut weight = [1.0f32; LANES];
                    if let (Some(plane), true) = (alpha, alpha != Some(k)) {
                        weight = kernel::load(row, (C + 1 + plane) * width + o);
                    }
                    if let Some(a) = amplitude {
                        weight = kernel::lanes(|i| weight[i] * a[i]);
                    }
                    let own = match self.scene.blend {
                        Blend::Normalized => kernel::lanes(|i| (color[k] - value[i]) * inv[i] * weight[i] * e[i]),
                        Blend::Sum => kernel::lanes(|i| color[k] * weight[i] * e[i]),
                    };
                    t = kernel::lanes(|i| t[i] + (value[i] - wanted[i]) * weight[i] * own[i]);
                    square = kernel::lanes(|i| square[i] + own[i] * own[i]);
                    let shown = kernel::lanes(|i| own[i] * w[i] * inv[i] * weight[i]);
                    for (sum, f) in mixed[k].iter_mut().zip(&features) {
                        *sum = kernel::lanes(|i| sum[i] + shown[i] * f[i]);
                    }
                }
                let mut n = 0;
                for a in 0..5 {
                    let f = &features[a];
                    first[a] = kernel::lanes(|i| first[a][i] + t[i] * f[i]);
                    let scaled = kernel::lanes(|i| square[i] * f[i]);
                    for other in &features[..=a] {
                        second[n] = kernel::lanes(|i| second[n][i] + scaled[i] * other[i]);
                        n += 1;
                    }
                }
                x += LANES;
            }
        }
        let total = |sum: &Lanes| kernel::total(sum) * patch.step as f32;
        let mut bowl = Bowl { slope: first.map(|v| total(&v)), ..Bowl::default() };
        let mixed = mixed.map(|of| of.map(|v| total(&v)));
        let mut n = 0;
        for a in 0..5 {
            for b in 0..=a {
                let mut v = total(&second[n]);
                for k in 0..C {
                    // The colour follows.
                    v -= mixed[k][a] * mixed[k][b] / (parabola.square(k, C) + 1e-6);
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
    fn paste(&mut self, old: &Projected, new: Option<&Projected>) {
        let stride = self.target.stride;
        let end = self.first + self.planes.len() / ((C + 1) * stride);
        for (p, sign) in [(Some(old), -1.0f32), (new, 1.0)] {
            let Some(p) = p else { continue };
            for y in (p.rows[0] as usize).max(self.first)..(p.rows[1] as usize).min(end) {
                let row = &mut self.planes[(y - self.first) * (C + 1) * stride..][..(C + 1) * stride];
                kernel::splat_signed::<C>(p, y as u32, self.scene.width, row, stride, sign);
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
