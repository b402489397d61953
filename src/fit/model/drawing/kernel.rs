//! The inner loops of the fit: forward (weights into planes) and backward (planes into moments). They process eight
//! columns at a time and walk down runs of rows by recurrence, as the decoder does. Rows are padded by eight samples,
//! because the last strip may overhang.

use crate::fit::model::drawing::project::Projected;
use crate::fit::model::drawing::strips::{self, PlannedStrip};
use crate::fit::model::drawing::walk::{Strip, Visit, walk_rows};
use crate::fit::model::objective::rows::RowSet;
use crate::simd::{self, Simd};

/// Returns the colour of `p`, each channel in all lanes.
#[inline(always)]
pub fn colors<S: Simd, const C: usize>(simd: S, p: &Projected) -> [S::Vector; C] {
    let mut colors = [simd.splat(0.0); C];
    for (color, value) in colors.iter_mut().zip(p.color) {
        *color = simd.splat(value);
    }
    colors
}

/// Adds the weights of `p`, times `sign`, to sums: multiplied by its colour to `C` planes, and unmultiplied to the last
/// plane.
///
/// `planes` holds the sampled rows from index `first` on, each with `C + 1` planes of `stride` floats. Rows that it
/// does not hold are skipped.
#[inline(always)]
pub fn splat<S: Simd, const C: usize>(
    simd: S,
    p: &Projected,
    (rows, first): (RowSet, usize),
    width: u32,
    (planes, stride): (&mut [f32], usize),
    sign: f32,
) {
    let size = (C + 1) * stride;
    let from = rows.index(p.rows[0]).max(first);
    let end = rows.index(p.rows[1]).min(first + planes.len() / size);
    if from >= end {
        return;
    }
    let sign = simd.splat(sign);
    let mut color = colors::<S, C>(simd, p);
    for color in &mut color {
        *color = simd.mul(*color, sign);
    }
    let planes = &mut planes[(from - first) * size..(end - first) * size];
    let mut deposit = Deposit { color, sign, planes, stride };
    walk_rows(simd, p, (rows, from..end), width, &mut deposit);
}

/// Adds the weights of a primitive with precomputed strips to sums, like [`splat`] with a sign of 1.
#[inline(always)]
pub(crate) fn splat_planned<S: Simd, const C: usize>(
    simd: S,
    (p, strips): (&Projected, &[PlannedStrip]),
    (rows, first): (RowSet, usize),
    width: u32,
    (planes, stride): (&mut [f32], usize),
) {
    let end = first + planes.len() / ((C + 1) * stride);
    let mut deposit = Deposit::<S, C> { color: colors(simd, p), sign: simd.splat(1.0), planes, stride };
    strips::walk(simd, (p, strips), (rows, first..end), width, &mut deposit);
}

/// Adds weights to sums.
struct Deposit<'a, S: Simd, const C: usize> {
    /// The colour, multiplied by the sign.
    color: [S::Vector; C],
    sign: S::Vector,
    planes: &'a mut [f32],
    stride: usize,
}

impl<S: Simd, const C: usize> Visit<S> for Deposit<'_, S, C> {
    #[inline(always)]
    fn pixels(&mut self, simd: S, strip: &Strip<S>, i: usize, g: S::Vector, _dy: S::Vector) {
        let row = &mut self.planes[i * (C + 1) * self.stride + strip.x..][..C * self.stride + simd::LANES];
        let w = simd.max(simd.sub(g, strip.edge), simd.splat(0.0));
        for k in 0..C {
            let sums = &mut row[k * self.stride..];
            simd.write(sums, simd.add(simd.read(sums), simd.mul(w, self.color[k])));
        }
        let sums = &mut row[C * self.stride..];
        simd.write(sums, simd.add(simd.read(sums), simd.mul(w, self.sign)));
    }
}

/// Sums over the support from which a primitive's gradient follows.
#[derive(Clone, Copy)]
pub struct Moments<const C: usize> {
    /// `Σ w g` for each channel.
    pub color: [f32; C],
    /// `Σ e v` times `dx`, `dy`, `dx²`, `dx dy` and `dy²`, where `v = Σ g c − h`.
    pub geometry: [f32; 5],
}

/// Returns the moments of `p` over the gradient planes of all its sampled rows. Each row has `C` planes of `∂L/∂(Σwc)`,
/// then `h`, with `stride` floats each.
#[cfg(any(test, feature = "unstable"))]
#[inline(always)]
pub fn gather<S: Simd, const C: usize>(
    simd: S,
    p: &Projected,
    rows: RowSet,
    width: u32,
    (planes, stride): (&[f32], usize),
) -> Moments<C> {
    let (from, end) = (rows.index(p.rows[0]), rows.index(p.rows[1]));
    let mut gather = Gather::<S, C>::new(simd, p, (&planes[from * (C + 1) * stride..], stride));
    walk_rows(simd, p, (rows, from..end), width, &mut gather);
    gather.moments(simd)
}

/// Returns the moments of `p` over the gradient planes of the sampled rows in `planes`, on precomputed strips.
#[inline(always)]
pub(crate) fn gather_planned<S: Simd, const C: usize>(
    simd: S,
    (p, strips): (&Projected, &[PlannedStrip]),
    rows: RowSet,
    width: u32,
    (planes, stride): (&[f32], usize),
) -> Moments<C> {
    let count = planes.len() / ((C + 1) * stride);
    let mut gather = Gather::<S, C>::new(simd, p, (planes, stride));
    strips::walk(simd, (p, strips), (rows, 0..count), width, &mut gather);
    gather.moments(simd)
}

/// Accumulates moments.
struct Gather<'a, S: Simd, const C: usize> {
    color: [S::Vector; C],
    planes: &'a [f32],
    stride: usize,
    colors: [S::Vector; C],
    geometry: [S::Vector; 5],
    /// Sums of `w g` over a run of rows. Sums that start and end with a run stay in registers.
    shades: [S::Vector; C],
    /// Three nested running sums of `e v` over a run of rows: the sum, the sum of these sums, and the sum of those.
    /// They take three additions per row, and the moments along `dy` follow from them at the end of the run.
    sums: [S::Vector; 3],
}

impl<'a, S: Simd, const C: usize> Gather<'a, S, C> {
    #[inline(always)]
    fn new(simd: S, p: &Projected, (planes, stride): (&'a [f32], usize)) -> Self {
        let zero = simd.splat(0.0);
        let (color, colors, geometry) = (colors(simd, p), [zero; C], [zero; 5]);
        Gather { color, planes, stride, colors, geometry, shades: [zero; C], sums: [zero; 3] }
    }

    #[inline(always)]
    fn moments(self, simd: S) -> Moments<C> {
        let mut moments = Moments { color: [0.0; C], geometry: [0.0; 5] };
        for (sum, v) in moments.color.iter_mut().zip(self.colors) {
            *sum = simd.sum(v);
        }
        for (sum, v) in moments.geometry.iter_mut().zip(self.geometry) {
            *sum = simd.sum(v);
        }
        moments
    }
}

impl<S: Simd, const C: usize> Visit<S> for Gather<'_, S, C> {
    #[inline(always)]
    fn pixels(&mut self, simd: S, strip: &Strip<S>, i: usize, g: S::Vector, _dy: S::Vector) {
        let row = &self.planes[i * (C + 1) * self.stride + strip.x..][..C * self.stride + simd::LANES];
        // Some columns may lie outside the support, where both the weight and its derivative are 0.
        let e = simd.keep_above(g, g, strip.edge);
        let w = simd.max(simd.sub(g, strip.edge), simd.splat(0.0));
        let mut v = simd.splat(0.0);
        for k in 0..C {
            let gradient = simd.read(&row[k * self.stride..]);
            self.shades[k] = simd.add(self.shades[k], simd.mul(w, gradient));
            let part = simd.mul(gradient, self.color[k]);
            v = if k == 0 { part } else { simd.add(v, part) };
        }
        let t = simd.mul(e, simd.sub(v, simd.read(&row[C * self.stride..])));
        self.sums[0] = simd.add(self.sums[0], t);
        self.sums[1] = simd.add(self.sums[1], self.sums[0]);
        self.sums[2] = simd.add(self.sums[2], self.sums[1]);
    }

    #[inline(always)]
    fn leave(&mut self, simd: S, strip: &Strip<S>, dy: f32, step: f32) {
        for k in 0..C {
            self.colors[k] = simd.add(self.colors[k], self.shades[k]);
            self.shades[k] = simd.splat(0.0);
        }
        // Row `j` of `n`, at `dy − (n − j)·step`, is counted `n − j` times in the second sum and `(n − j)(n − j + 1) /
        // 2` times in the third.
        let [t, linear, triangular] = std::mem::replace(&mut self.sums, [simd.splat(0.0); 3]);
        let square = simd.sub(simd.add(triangular, triangular), linear);
        let ty = simd.sub(simd.mul(simd.splat(dy), t), simd.mul(simd.splat(step), linear));
        let tyy = simd.add(
            simd.sub(simd.mul(simd.splat(dy * dy), t), simd.mul(simd.splat(2.0 * dy * step), linear)),
            simd.mul(simd.splat(step * step), square),
        );
        let tx = simd.mul(t, strip.dx);
        let sums = [tx, ty, simd.mul(tx, strip.dx), simd.mul(ty, strip.dx), tyy];
        for (sum, v) in self.geometry.iter_mut().zip(sums) {
            *sum = simd.add(*sum, v);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::model::drawing::project::Primitive;
    use crate::fit::model::drawing::walk::RUN;
    use crate::gaussian::CUTOFF;
    use crate::gaussian::CUTOFF_WEIGHT;
    use crate::simd::{Plain, Task};

    const WIDTH: u32 = 83;
    const HEIGHT: u32 = 71;
    const STRIDE: usize = 96;

    /// Round, needle-like, huge and subpixel primitives, inside and beside the picture.
    fn primitives() -> Vec<Primitive> {
        (0..600u32)
            .map(|i| {
                let f = |k: u32| (f64::from(i) * f64::from(k).sqrt()).fract() as f32;
                let long = [0.3, 2.0, 9.0, 60.0, 900.0][i as usize % 5] * (0.5 + f(2));
                Primitive {
                    mean: [f(3) * 110.0 - 14.0, f(5) * 100.0 - 14.0],
                    log_scale: [long.ln(), (long * f(7).max(0.01)).max(0.25).ln()],
                    rotation: f(11) * 4.0,
                    color: [0.8, -0.3, 0.5, 0.0],
                }
            })
            .collect()
    }

    struct Draw<'a>(&'a Projected, RowSet, &'a mut [f32]);

    impl Task for Draw<'_> {
        type Output = ();

        #[inline(always)]
        fn run<S: Simd>(self, simd: S) {
            splat::<S, 3>(simd, self.0, (self.1, 0), WIDTH, (self.2, STRIDE), 1.0);
        }
    }

    struct Sum<'a>(&'a Projected, RowSet, &'a [f32]);

    impl Task for Sum<'_> {
        type Output = Moments<3>;

        #[inline(always)]
        fn run<S: Simd>(self, simd: S) -> Moments<3> {
            gather::<S, 3>(simd, self.0, self.1, WIDTH, (self.2, STRIDE))
        }
    }

    fn row_sets() -> [RowSet; 3] {
        [RowSet::ALL, RowSet { step: 2, phase: 1 }, RowSet { step: 5, phase: 3 }]
    }

    #[test]
    fn weights_match_f64_for_round_and_stiff_shapes() {
        for (i, p) in primitives().iter().enumerate() {
            let rows = row_sets()[i % 3];
            let projected = Projected::new(p, HEIGHT);
            let mut planes = vec![0.0; rows.count(HEIGHT) * 4 * STRIDE];
            simd::dispatch(Draw(&projected, rows, &mut planes));
            let (sin, cos) = f64::from(p.rotation).sin_cos();
            let [s1, s2] = p.log_scale.map(|l| f64::from(l).exp());
            for r in 0..rows.count(HEIGHT) {
                for x in 0..STRIDE {
                    let [dx, dy] =
                        [x as f64 + 0.5 - f64::from(p.mean[0]), f64::from(rows.row(r)) + 0.5 - f64::from(p.mean[1])];
                    let (u, v) = ((cos * dx + sin * dy) / s1, (cos * dy - sin * dx) / s2);
                    let e = (-0.5 * (u * u + v * v)).exp();
                    let want = if x < WIDTH as usize { (e - f64::from(CUTOFF_WEIGHT)).max(0.0) } else { 0.0 };
                    let found = planes[(r * 4 + 3) * STRIDE + x];
                    // The terms of the exponent cancel: the error is up to `(dx² + dy²)/s₂²` units in the last place of
                    // f32.
                    let size = ((dx * dx + dy * dy) / (s2 * s2)).min(400.0 * f64::from(CUTOFF).powi(2));
                    // `exp2` has an error of 2·10⁻⁷ in both factors of the first ratio, and each row rounds the ratio
                    // and its bend by 2⁻²⁴.
                    let rounding = f64::from(f32::EPSILON) / 2.0;
                    let drift = f64::from(RUN) * (4e-7 + 2.0 * rounding) + f64::from(RUN * RUN) * rounding;
                    let tolerance = drift + 1e-6 + 3e-7 * size;
                    assert!((f64::from(found) - want).abs() < tolerance, "{p:?} {x} {r}: {found}, expected {want}");
                    let color = planes[(r * 4) * STRIDE + x];
                    assert!((color - 0.8 * found).abs() < 1e-6);
                }
            }
        }
    }

    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        let noise: Vec<f32> =
            (0..HEIGHT as usize * 4 * STRIDE).map(|i| ((i * 7919) % 1000) as f32 * 1e-3 - 0.4).collect();
        for (i, p) in primitives().iter().enumerate() {
            let rows = row_sets()[i % 3];
            let projected = Projected::new(p, HEIGHT);
            let [mut found, mut want] = [(); 2].map(|()| vec![0.0; rows.count(HEIGHT) * 4 * STRIDE]);
            simd::dispatch(Draw(&projected, rows, &mut found));
            Draw(&projected, rows, &mut want).run(Plain);
            assert_eq!(found, want, "{p:?}");
            let [found, want] =
                [simd::dispatch(Sum(&projected, rows, &noise)), Sum(&projected, rows, &noise).run(Plain)];
            assert_eq!((found.color, found.geometry), (want.color, want.geometry), "{p:?}");
            assert!(found.color.iter().chain(&found.geometry).all(|v| v.is_finite()), "{p:?}");
        }
    }
}
