//! The pixels around one primitive, and how their error depends on its replacement: exactly on the colour of a given
//! shape, and to second order on the shape.

use crate::constants::rdo;
use crate::fit::model::drawing::project::Projected;
use crate::fit::model::drawing::walk::{self, Strip, Visit};
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::problem::{Problem, Scene};
use crate::gaussian::{Blend, CUTOFF_WEIGHT, EPSILON, Gaussian};
use crate::rdo::local_quadratic::LocalQuadratic;
use crate::simd::{LANES, Simd};
use crate::strict_math::StrictMath;
use crate::weighting::RowWeights;

/// Returns the maximum distance of the rows of patches, if `overlap` primitives cover a pixel in the mean.
pub(super) fn max_row_step(scene: &Scene, overlap: f32) -> usize {
    let crowded = (overlap / rdo::PRIMITIVES_PER_ROW_STEP).ceil().clamp(1.0, rdo::MAX_CROWDED_ROW_STEP) as usize;
    if scene.is_large() { crowded.max(rdo::MAX_ROW_STEP) } else { crowded }
}

/// The pixels around one primitive, with that primitive removed.
pub(super) struct Patch<'a> {
    problem: &'a Problem<'a>,
    /// Maximum of `step`.
    max_step: usize,
    /// The removed primitive.
    removed: Option<Projected>,
    /// Rows of `2C + 1` planes with `stride` floats each: `Σwc` with `εb` (C), targets (C), squared error. Only
    /// [`Self::extracted`] pixels are those of this patch. The others are finite remains of earlier ones.
    planes: Vec<f32>,
    /// `Σw + ε` in the same rows. Remains of earlier patches are positive as well.
    divisors: Vec<f32>,
    stride: usize,
    pub columns: std::ops::Range<usize>,
    pub rows: std::ops::Range<usize>,
    /// Distance of the rows that are stored. Each of them stands for `step` rows.
    step: usize,
    /// The vectors of [`LANES`] pixels that are extracted so far in each stored row.
    extracted: Vec<std::ops::Range<u32>>,
    /// Squared error over the extracted pixels without the primitive.
    pub base_error: f32,
}

/// Error of the patch as a function of the colour: `rest + Σ 2 c·cross + c²·square`, relative to [`Patch::base_error`].
#[derive(Clone, Copy)]
pub(super) struct Parabola {
    rest: f32,
    cross: [f32; 4],
    /// Without the weights of the channels: of the first channel, and of the one that is the opacity of the others.
    square: [f32; 2],
    /// Weight of the squared error in each channel.
    channel_weights: [f32; 4],
    /// The channel that is the opacity of the others.
    opacity: Option<usize>,
}

impl<'a> Patch<'a> {
    /// Creates an empty patch whose rows are at most `max_step` apart.
    pub(super) fn new(problem: &'a Problem<'a>, max_step: usize) -> Self {
        Patch {
            problem,
            max_step,
            removed: None,
            planes: Vec::new(),
            divisors: Vec::new(),
            stride: 0,
            columns: 0..0,
            rows: 0..0,
            step: 1,
            extracted: Vec::new(),
            base_error: 0.0,
        }
    }

    /// Starts a patch of `rows` and `columns` around `p`, which will be removed from it. No pixel is extracted yet.
    pub(super) fn begin<const C: usize>(
        &mut self,
        p: &Projected,
        (rows, columns): (std::ops::Range<usize>, std::ops::Range<usize>),
    ) {
        // Strips start at any column and are read as whole vectors, so the last one may overhang.
        self.stride = columns.len().next_multiple_of(LANES) + LANES;
        self.step = self.row_step(p);
        let count = rows.len().div_ceil(self.step);
        (self.columns, self.rows, self.removed) = (columns, rows, Some(*p));
        self.extracted.clear();
        self.extracted.resize(count, 0..0);
        // The memory only grows and is not cleared.
        let size = self.stride * count;
        if self.divisors.len() < size {
            self.divisors.resize(size, 1.0);
            self.planes.resize((2 * C + 1) * size, 0.0);
        }
        self.base_error = 0.0;
    }

    /// Extracts the pixels under `q` that are not extracted yet. The sums have `C + 1` planes per row, from row `first`
    /// on.
    #[inline(always)]
    pub(super) fn extract<S: Simd, const C: usize>(&mut self, simd: S, q: &Projected, sums: (&[f32], usize)) {
        let Some(p) = self.removed else { return };
        let vectors = (self.stride / LANES) as u32;
        let mut base_error = simd.splat(0.0);
        for i in self.range(q.rows) {
            let y = self.rows.start + i * self.step;
            // A strip of `q` that reaches into the row starts or ends up to a vector beyond the support. One column
            // more allows for rounding.
            let Some([from, to]) = q.row_ends(y as u32) else { continue };
            let vector = |x: f32| ((x - self.columns.start as f32).max(0.0) / LANES as f32) as u32;
            let from = vector(from - LANES as f32).min(vectors);
            let to = (vector(to + LANES as f32) + 1).min(vectors);
            let mut have = self.extracted[i].clone();
            if have.start == have.end {
                have = from..from;
            }
            for missing in [from..have.start, have.end..to] {
                if !missing.is_empty() {
                    base_error = simd.add(base_error, self.extract_row::<S, C>(simd, &p, (i, y), missing, sums));
                }
            }
            self.extracted[i] = have.start.min(from)..have.end.max(to);
        }
        // Each stored row stands for `step` rows.
        self.base_error += simd.sum(base_error) * self.step as f32;
    }

    /// Extracts some vectors of stored row `i`, which is row `y` of the picture, and removes `p`. Returns their error.
    #[inline(always)]
    fn extract_row<S: Simd, const C: usize>(
        &mut self,
        simd: S,
        p: &Projected,
        (i, y): (usize, usize),
        vectors: std::ops::Range<u32>,
        (sums, first): (&[f32], usize),
    ) -> S::Vector {
        let Problem { scene: Scene { width: picture, blend, .. }, target } = *self.problem;
        let (stride, colors, width) = (target.stride, p.color, self.stride);
        let (left, right) = (self.columns.start, self.columns.end);
        let (zero, one) = (simd.splat(0.0), simd.splat(1.0));
        let background: [f32; C] = std::array::from_fn(|k| self.background_term(k));
        let out = &mut self.planes[i * (2 * C + 1) * width..][..(2 * C + 1) * width];
        let divisors = &mut self.divisors[i * width..][..width];
        let row = &sums[(y - first) * (C + 1) * stride..][..(C + 1) * stride];
        let wanted = target.row(y as u32);
        let span = p.span(y as u32, picture);
        let weights = target.weights(y as u32);
        let mut base_error = zero;
        for o in vectors {
            let o = o as usize * LANES;
            let x = left + o;
            // Beyond the right end nothing counts: sums of 0 over a weight of 1 have no error and can be divided
            // safely.
            if x >= right {
                for k in 0..2 * C + 1 {
                    simd.write(&mut out[k * width + o..], zero);
                }
                simd.write(&mut divisors[o..], one);
                continue;
            }
            // The last vector may contain columns beyond the patch. Lanes from `limit` on must not count.
            let limit = simd.splat((right - x) as f32 - 0.5);
            let all = simd.read(&row[C * stride + x..]);
            // The exponential is needed only under the support of the primitive.
            let own = span.filter(|&(start, end, _)| x + LANES > start && x < end).map(|(.., dy)| {
                let own = simd.max(simd.sub(walk::at(simd, p, x, dy), simd.splat(CUTOFF_WEIGHT)), zero);
                simd.keep_above(own, limit, simd.index())
            });
            let Weights { with, without, share } = Weights::new(simd, blend, all, own);
            let own = own.unwrap_or(zero);
            let mut error = zero;
            for k in 0..C {
                let sum = simd.add(simd.read(&row[k * stride + x..]), simd.splat(background[k]));
                let n = simd.sub(sum, simd.mul(own, simd.splat(colors[k])));
                let t = clamped_target(simd, simd.read(&wanted[k * stride + x..]), simd.mul(sum, with));
                let mut d = simd.sub(simd.mul(n, share), t);
                if let Some(factor) = weights.pixels(simd, k, x) {
                    d = simd.mul(d, factor);
                }
                d = simd.mul(d, simd.splat(weights.channels[k]));
                error = simd.add(error, simd.mul(d, d));
                // Both are stored unweighted. Weights are applied when a candidate is evaluated.
                simd.write(&mut out[k * width + o..], n);
                simd.write(&mut out[(C + k) * width + o..], t);
            }
            // The error of each pixel is stored, because a candidate changes it only under its support.
            let error = simd.keep_above(error, limit, simd.index());
            simd.write(&mut divisors[o..], without);
            simd.write(&mut out[2 * C * width + o..], error);
            base_error = simd.add(base_error, error);
        }
        base_error
    }

    /// Returns the distance of the stored rows. Tall primitives have more pixels than a decision needs.
    fn row_step(&self, p: &Projected) -> usize {
        let tall = (p.rows[1] - p.rows[0]) as usize;
        (tall / rdo::SUPPORT_ROWS_PER_STEP).clamp(1, self.max_step)
    }

    /// Returns the background's term in channel `k`, which is added to `Σwc` before the division.
    #[inline(always)]
    fn background_term(&self, k: usize) -> f32 {
        match self.problem.scene.blend {
            Blend::Normalized => EPSILON * self.problem.scene.background[k],
            Blend::Sum => self.problem.scene.background[k],
        }
    }

    /// Returns the error over the patch with `q` added, for any colour, minus the error without it.
    #[inline(always)]
    pub(super) fn parabola<S: Simd, const C: usize>(&self, simd: S, q: &Projected) -> Parabola {
        let (zero, range) = (simd.splat(0.0), self.range(q.rows));
        let channel_weights = self.problem.target.channel_amplitude.map(|a| a * a);
        let mut errors = ParabolaVisitor::<S, C> {
            pixels: self.pixels::<C>(&range),
            rest: zero,
            cross: [zero; C],
            square: [zero; 2],
            channel_weights,
        };
        self.walk(simd, q, range, &mut errors);
        let scale = self.step as f32;
        let mut out = Parabola {
            rest: simd.sum(errors.rest) * scale,
            cross: [0.0; 4],
            square: [simd.sum(errors.square[0]), simd.sum(errors.square[1])].map(|s| s * scale),
            channel_weights,
            opacity: self.problem.target.opacity,
        };
        for k in 0..C {
            out.cross[k] = simd.sum(errors.cross[k]) * scale * out.channel_weights[k];
        }
        out
    }

    /// Returns the stored rows with indices in `range`.
    #[inline(always)]
    fn pixels<const C: usize>(&self, range: &std::ops::Range<usize>) -> PatchRows<'_> {
        PatchRows {
            planes: &self.planes[range.start * (2 * C + 1) * self.stride..],
            divisors: &self.divisors[range.start * self.stride..],
            stride: self.stride,
            left: self.columns.start,
            row: self.rows.start + range.start * self.step,
            step: self.step,
            target: self.problem.target,
            blend: self.problem.scene.blend,
        }
    }

    /// Visits the pixels of `p` in the stored rows with indices in `range`.
    #[inline(always)]
    fn walk<S: Simd>(&self, simd: S, p: &Projected, range: std::ops::Range<usize>, visitor: &mut impl Visit<S>) {
        let dy = (self.rows.start + range.start * self.step) as f32 - p.center[1];
        walk::walk(simd, p, (dy, self.step as f32, range.len()), self.columns.clone(), visitor);
    }

    /// Returns how the error over the patch changes to second order with mean, scales and rotation of `p`, the
    /// projection of `g`, with the colour `color`.
    #[inline(always)]
    pub(super) fn local_quadratic<S: Simd, const C: usize>(
        &self,
        simd: S,
        (p, g): (&Projected, &Gaussian),
        color: [f32; 4],
        parabola: &Parabola,
    ) -> LocalQuadratic {
        let (zero, range) = (simd.splat(0.0), self.range(p.rows));
        let (sin, cos) = g.rotation.strict_sin_cos();
        let [sx, sy] = g.scale;
        let mut slopes = QuadraticVisitor::<S, C> {
            pixels: self.pixels::<C>(&range),
            color,
            across: [cos / sx, sin / sx],
            along: [-sin / sy, cos / sy],
            turn: sx / sy - sy / sx,
            first: [zero; 5],
            second: [zero; 15],
            mixed: [[zero; 5]; C],
        };
        self.walk(simd, p, range, &mut slopes);
        let scale = self.step as f32;
        let mut local_quadratic = LocalQuadratic::default();
        let mut mixed = [[0.0; 5]; C];
        let mut n = 0;
        for a in 0..5 {
            local_quadratic.slope[a] = simd.sum(slopes.first[a]) * scale;
            for k in 0..C {
                mixed[k][a] = simd.sum(slopes.mixed[k][a]) * scale;
            }
            for b in 0..=a {
                let mut v = simd.sum(slopes.second[n]) * scale;
                for (k, by_color) in mixed.iter().enumerate() {
                    // Subtract the effect of optimizing the colour (Schur complement).
                    v -= by_color[a] * by_color[b] / (parabola.square(k) + 1e-6);
                }
                (local_quadratic.curvature[a][b], local_quadratic.curvature[b][a]) = (v, v);
                n += 1;
            }
        }
        local_quadratic
    }

    /// Returns the indices of the stored rows inside `rows`.
    fn range(&self, rows: [u32; 2]) -> std::ops::Range<usize> {
        let [from, to] = rows.map(|y| (y as usize).clamp(self.rows.start, self.rows.end) - self.rows.start);
        from.div_ceil(self.step)..to.div_ceil(self.step)
    }
}

/// Factors of a vector of pixels: a pixel is its sums by them.
struct Weights<V> {
    /// The inverse of the divisor with the primitive.
    with: V,
    /// The divisor without the primitive.
    without: V,
    /// The inverse of `without`.
    share: V,
}

impl<V: Copy> Weights<V> {
    /// Returns the factors of pixels whose weights have the sum `all`. `own` is the weight of the primitive; `None`
    /// means 0.
    #[inline(always)]
    fn new<S: Simd<Vector = V>>(simd: S, blend: Blend, all: V, own: Option<V>) -> Self {
        let (zero, one, epsilon) = (simd.splat(0.0), simd.splat(1.0), simd.splat(EPSILON));
        let (with, without) = match (own, blend) {
            (Some(own), Blend::Normalized) => {
                // Rounding may leave slightly less than 0.
                let without = simd.add(simd.max(simd.sub(all, own), zero), epsilon);
                (Some(simd.div(one, simd.add(all, epsilon))), without)
            }
            (None, Blend::Normalized) => (None, simd.add(simd.max(all, zero), epsilon)),
            (_, Blend::Sum) => (None, one),
        };
        let share = simd.div(one, without);
        Weights { with: with.unwrap_or(share), without, share }
    }
}

/// Returns the values that pixels should have if they now have the values `now` and their target is `target`. Decoders
/// clamp values. If a black or white pixel overshoots, the target moves to the current value, so that the overshoot is
/// no error as long as it stays the same.
#[inline(always)]
fn clamped_target<S: Simd>(simd: S, target: S::Vector, now: S::Vector) -> S::Vector {
    let zero = simd.splat(0.0);
    let beyond = simd.sub(now, target);
    let above = simd.keep_above(simd.max(beyond, zero), target, simd.splat(1.0f32.next_down()));
    let below = simd.keep_above(simd.min(beyond, zero), simd.splat(f32::MIN_POSITIVE), target);
    simd.add(simd.add(target, above), below)
}

impl Parabola {
    #[inline(always)]
    pub(super) fn at(&self, c: [f32; 4], channels: usize) -> f32 {
        let mut e = self.rest;
        for k in 0..channels {
            e += c[k] * (2.0 * self.cross[k] + c[k] * self.square(k));
        }
        e
    }

    /// Returns `Σ r²` of channel `k`.
    #[inline(always)]
    fn square(&self, k: usize) -> f32 {
        self.square[usize::from(self.opacity == Some(k))] * self.channel_weights[k]
    }

    /// Returns the colour of the smallest error, or `None` if the error hardly depends on the colour.
    #[inline(always)]
    pub(super) fn minimum(&self, channels: usize) -> Option<[f32; 4]> {
        let mut c = [0.0f32; 4];
        for k in 0..channels {
            let square = self.square(k);
            if square < 1e-6 {
                return None;
            }
            c[k] = (-self.cross[k] / square).clamp(-4.0, 4.0);
        }
        Some(c)
    }
}

/// The stored rows of a patch that a primitive reaches.
struct PatchRows<'a> {
    /// The planes from the first of these rows on.
    planes: &'a [f32],
    divisors: &'a [f32],
    stride: usize,
    /// The first stored column.
    left: usize,
    /// The number of the first row in the picture.
    row: usize,
    step: usize,
    target: &'a Planes,
    blend: Blend,
}

/// One vector of adjacent pixels of a patch.
struct PixelVector<'a> {
    /// The row's planes, starting at these pixels.
    planes: &'a [f32],
    divisors: &'a [f32],
    stride: usize,
    /// The first pixel's column in the picture, and the weights of its row.
    x: usize,
    weights: RowWeights<'a>,
    blend: Blend,
}

impl PatchRows<'_> {
    #[inline(always)]
    fn vector<const C: usize>(&self, i: usize, x: usize) -> PixelVector<'_> {
        let PatchRows { stride, blend, .. } = *self;
        let planes = &self.planes[i * (2 * C + 1) * stride + x - self.left..];
        let divisors = &self.divisors[i * stride + x - self.left..];
        let weights = self.target.weights((self.row + i * self.step) as u32);
        PixelVector { planes, divisors, stride, x, weights, blend }
    }
}

impl PixelVector<'_> {
    #[inline(always)]
    fn plane<S: Simd>(&self, simd: S, k: usize) -> S::Vector {
        simd.read(&self.planes[k * self.stride..])
    }

    /// Returns the factor that converts sums to values of the picture after the weight `w` is added to the sums.
    #[inline(always)]
    fn share<S: Simd>(&self, simd: S, w: S::Vector) -> S::Vector {
        match self.blend {
            Blend::Normalized => simd.div(simd.splat(1.0), simd.add(simd.read(self.divisors), w)),
            Blend::Sum => simd.splat(1.0),
        }
    }

    /// Returns the factor of the errors in channel `k` without that of the channel; `None` means 1.
    #[inline(always)]
    fn factor<S: Simd>(&self, simd: S, k: usize) -> Option<S::Vector> {
        self.weights.pixels(simd, k, self.x)
    }
}

/// Returns `v` times `factor`; `None` means 1.
#[inline(always)]
fn by<S: Simd>(simd: S, v: S::Vector, factor: Option<S::Vector>) -> S::Vector {
    factor.map_or(v, |factor| simd.mul(v, factor))
}

/// Accumulates a [`Parabola`].
struct ParabolaVisitor<'a, S: Simd, const C: usize> {
    pixels: PatchRows<'a>,
    rest: S::Vector,
    cross: [S::Vector; C],
    square: [S::Vector; 2],
    /// Weight of the squared error in each channel.
    channel_weights: [f32; 4],
}

impl<S: Simd, const C: usize> Visit<S> for ParabolaVisitor<'_, S, C> {
    #[inline(always)]
    fn pixels(&mut self, simd: S, strip: &Strip<S>, i: usize, g: S::Vector, _dy: S::Vector) {
        let zero = simd.splat(0.0);
        let at = self.pixels.vector::<C>(i, strip.x);
        let w = simd.max(simd.sub(g, strip.edge), zero);
        let share = at.share(simd, w);
        let part = simd.mul(w, share);
        let mut error = zero;
        for k in 0..C {
            let a = simd.sub(simd.mul(at.plane(simd, k), share), at.plane(simd, C + k));
            let factor = at.factor(simd, k);
            let (a, r) = (by(simd, a, factor), by(simd, part, factor));
            let counted = simd.mul(a, simd.splat(self.channel_weights[k]));
            error = simd.add(error, simd.mul(counted, a));
            self.cross[k] = simd.add(self.cross[k], simd.mul(a, r));
            let is_opacity = self.pixels.target.opacity == Some(k);
            if k == 0 || is_opacity {
                let s = usize::from(is_opacity);
                self.square[s] = simd.add(self.square[s], simd.mul(r, r));
            }
        }
        let more = simd.sub(error, at.plane(simd, 2 * C));
        self.rest = simd.add(self.rest, simd.keep_above(more, w, zero));
    }
}

/// Accumulates a [`LocalQuadratic`].
struct QuadraticVisitor<'a, S: Simd, const C: usize> {
    pixels: PatchRows<'a>,
    color: [f32; 4],
    /// Change of the coordinate `u` along the rotated x axis, in units of its scale, per pixel to the right and per
    /// pixel down.
    across: [f32; 2],
    /// Change of the coordinate `v` along the rotated y axis, in units of its scale, per pixel to the right and per
    /// pixel down.
    along: [f32; 2],
    /// Change of the Gaussian's exponent per radian of rotation and unit of `u·v`.
    turn: f32,
    first: [S::Vector; 5],
    second: [S::Vector; 15],
    mixed: [[S::Vector; 5]; C],
}

impl<S: Simd, const C: usize> Visit<S> for QuadraticVisitor<'_, S, C> {
    #[inline(always)]
    fn pixels(&mut self, simd: S, strip: &Strip<S>, i: usize, g: S::Vector, dy: S::Vector) {
        let at = self.pixels.vector::<C>(i, strip.x);
        let e = simd.keep_above(g, g, strip.edge);
        let w = simd.max(simd.sub(g, strip.edge), simd.splat(0.0));
        let share = at.share(simd, w);
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
            let channel_weights = simd.splat(self.pixels.target.channel_amplitude[k]);
            let factor = at.factor(simd, k);
            let own = simd.mul(by(simd, own, factor), channel_weights);
            let error = by(simd, simd.sub(value, at.plane(simd, C + k)), factor);
            let error = simd.mul(error, channel_weights);
            t = simd.add(t, simd.mul(error, own));
            square = simd.add(square, simd.mul(own, own));
            let shown = by(simd, simd.mul(simd.mul(simd.mul(own, w), share), channel_weights), factor);
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
