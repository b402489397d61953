//! The inner loops of the fit over runs of pixels: forward (weights into planes) and backward (planes into moments).
//!
//! Plain arrays in safe code; callers run them inside `pulp`'s dispatch so that they are compiled for AVX2 and
//! AVX-512 as well. No fused multiply-add: every instruction set gives the same bits.

use crate::fit::project::Projected;
use crate::gaussian::CUTOFF_WEIGHT;

/// Pixels at a time. Rows are padded by this much, so that the last run may overhang.
pub(crate) const LANES: usize = 16;
pub(crate) type Lanes = [f32; LANES];

const IOTA: Lanes = {
    let mut v = [0.0; LANES];
    let mut i = 0;
    while i < LANES {
        v[i] = i as f32;
        i += 1;
    }
    v
};

#[inline(always)]
pub(crate) fn lanes(f: impl Fn(usize) -> f32) -> Lanes {
    // Not `array::from_fn`: that is a call of its own, which the dispatched instruction sets do not reach.
    let mut v = [0.0; LANES];
    let mut i = 0;
    while i < LANES {
        v[i] = f(i);
        i += 1;
    }
    v
}

/// `2^q` for `q ≤ 0`, relative error below 3e−7; 0 where the result would underflow.
// The polynomial's linear term is close to ln 2, not equal.
#[allow(clippy::approx_constant)]
#[inline(always)]
pub(crate) fn exp2(q: Lanes) -> Lanes {
    const MAGIC: f32 = 12_582_912.0; // 1.5·2²³: adding it rounds to an integer
    lanes(|i| {
        let x = if q[i] > -126.0 { q[i] } else { -126.0 };
        let m = x + MAGIC;
        let f = x - (m - MAGIC);
        let p = 1.327_647e-3;
        let p = p * f + 9.675_541e-3;
        let p = p * f + 5.550_713e-2;
        let p = p * f + 2.402_212e-1;
        let p = p * f + 6.931_47e-1;
        let p = p * f + 1.0;
        f32::from_bits((m.to_bits() << 23).wrapping_add(p.to_bits()))
    })
}

/// The exponentials of one row of a primitive, without the shift at the cutoff.
pub(crate) struct RowExponent {
    qa: f32,
    qb: f32,
    qc: f32,
    cx: f32,
}

impl RowExponent {
    #[inline(always)]
    pub(crate) fn new(p: &Projected, dy: f32) -> Self {
        const L2E: f32 = std::f32::consts::LOG2_E;
        let [a, b, c] = p.conic;
        RowExponent { qa: -0.5 * L2E * a, qb: -L2E * b * dy, qc: -0.5 * L2E * c * dy * dy, cx: p.center[0] }
    }

    /// Distances `dx` from the centre and `exp(−d²/2)` for the pixels from `x` on.
    #[inline(always)]
    pub(crate) fn at(&self, x: usize) -> (Lanes, Lanes) {
        let x0 = x as f32 - self.cx;
        let dx = lanes(|i| IOTA[i] + x0);
        let e = exp2(lanes(|i| (self.qa * dx[i] + self.qb) * dx[i] + self.qc));
        (dx, e)
    }
}

#[inline(always)]
pub(crate) fn load(plane: &[f32], x: usize) -> Lanes {
    plane[x..x + LANES].try_into().expect("LANES long")
}

#[inline(always)]
pub(crate) fn store(plane: &mut [f32], x: usize, v: &Lanes) {
    plane[x..x + LANES].copy_from_slice(v);
}

/// Adds the weights of `p` in row `y`, times its colour, to `C` colour planes, and the weights to a last plane.
/// `row` holds the `C + 1` planes, `stride` floats each.
#[inline(always)]
pub(crate) fn splat_row<const C: usize>(p: &Projected, y: u32, width: u32, row: &mut [f32], stride: usize) {
    splat_signed::<C>(p, y, width, row, stride, 1.0);
}

/// As [`splat_row`], with the weights times `sign`.
#[inline(always)]
pub(crate) fn splat_signed<const C: usize>(
    p: &Projected,
    y: u32,
    width: u32,
    row: &mut [f32],
    stride: usize,
    sign: f32,
) {
    let Some((first, end, dy)) = p.span(y, width) else { return };
    let exponent = RowExponent::new(p, dy);
    let mut x = first;
    while x < end {
        let (_, e) = exponent.at(x);
        let w = lanes(|i| if e[i] > CUTOFF_WEIGHT { (e[i] - CUTOFF_WEIGHT) * sign } else { 0.0 });
        for k in 0..C {
            let old = load(row, k * stride + x);
            store(row, k * stride + x, &lanes(|i| old[i] + w[i] * p.color[k]));
        }
        let old = load(row, C * stride + x);
        store(row, C * stride + x, &lanes(|i| old[i] + w[i]));
        x += LANES;
    }
}

/// Sums over the support that make up a primitive's gradient.
#[derive(Clone, Copy)]
pub(crate) struct Moments<const C: usize> {
    /// `Σ w g` for each channel.
    pub color: [Lanes; C],
    /// `Σ e v`, with `dx`, `dy`, `dx²`, `dx dy`, `dy²` in front, where `v = Σ g c − h`.
    pub geometry: [Lanes; 6],
}

impl<const C: usize> Moments<C> {
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        Moments { color: [[0.0; LANES]; C], geometry: [[0.0; LANES]; 6] }
    }
}

/// Sum of the lanes, in pairs, so that the order is fixed.
#[inline(always)]
pub(crate) fn total(v: &Lanes) -> f32 {
    let mut t = *v;
    let mut n = LANES / 2;
    while n > 0 {
        for i in 0..n {
            t[i] += t[i + n];
        }
        n /= 2;
    }
    t[0]
}

/// Gathers row `y` of the gradient planes (`C` of `∂L/∂(Σwc)`, then `h`) under `p` into `m`.
#[inline(always)]
pub(crate) fn gather_row<const C: usize>(
    p: &Projected,
    y: u32,
    width: u32,
    row: &[f32],
    stride: usize,
    m: &mut Moments<C>,
) {
    let Some((first, end, dy)) = p.span(y, width) else { return };
    let exponent = RowExponent::new(p, dy);
    let (mut v0, mut v1, mut v2) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    let mut x = first;
    while x < end {
        let (dx, e) = exponent.at(x);
        // Runs may overhang the span: outside the support both the weight and its derivative are 0.
        let e = lanes(|i| if e[i] > CUTOFF_WEIGHT { e[i] } else { 0.0 });
        let w = lanes(|i| if e[i] > CUTOFF_WEIGHT { e[i] - CUTOFF_WEIGHT } else { 0.0 });
        let h = load(row, C * stride + x);
        let mut v = lanes(|i| -h[i]);
        for k in 0..C {
            let g = load(row, k * stride + x);
            m.color[k] = lanes(|i| m.color[k][i] + w[i] * g[i]);
            v = lanes(|i| v[i] + g[i] * p.color[k]);
        }
        let t = lanes(|i| e[i] * v[i]);
        let tx = lanes(|i| t[i] * dx[i]);
        v0 = lanes(|i| v0[i] + t[i]);
        v1 = lanes(|i| v1[i] + tx[i]);
        v2 = lanes(|i| v2[i] + tx[i] * dx[i]);
        x += LANES;
    }
    let g = &mut m.geometry;
    let t01 = lanes(|i| dy * v0[i]);
    g[0] = lanes(|i| g[0][i] + v0[i]);
    g[1] = lanes(|i| g[1][i] + v1[i]);
    g[2] = lanes(|i| g[2][i] + t01[i]);
    g[3] = lanes(|i| g[3][i] + v2[i]);
    g[4] = lanes(|i| g[4][i] + dy * v1[i]);
    g[5] = lanes(|i| g[5][i] + dy * t01[i]);
}
