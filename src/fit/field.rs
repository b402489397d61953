//! Image-sized planes: `Σ w c` and `Σ w` summed over primitives, then turned into what the fit needs of them.
//!
//! Only the rows of a [`RowSet`] are kept, so that stochastic gradients over one row in `n` cost a fraction of the
//! time and of the memory.

use crate::fit::kernel::{self, LANES, Moments};
use crate::fit::project::{Primitive, Projected};
use crate::fit::target::Target;
use crate::gaussian::{Blend, EPSILON};
use crate::parallel;

/// Sampled rows in one band: the unit of parallel work.
const BAND: usize = 16;

/// Every `step`-th row from `phase` on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct RowSet {
    pub step: u32,
    pub phase: u32,
}

impl RowSet {
    pub(crate) const ALL: RowSet = RowSet { step: 1, phase: 0 };

    /// How many of `height` rows are in the set.
    pub(crate) fn count(self, height: u32) -> usize {
        (height.saturating_sub(self.phase)).div_ceil(self.step) as usize
    }

    /// Index of the first row of the set at or after `y`.
    #[inline(always)]
    pub(crate) fn index(self, y: u32) -> usize {
        y.saturating_sub(self.phase).div_ceil(self.step) as usize
    }

    /// Row number of index `i`.
    #[inline(always)]
    pub(crate) fn row(self, i: usize) -> u32 {
        self.phase + i as u32 * self.step
    }
}

/// What is fitted: blend, background, and the size of the planes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scene {
    pub width: u32,
    pub height: u32,
    pub blend: Blend,
    pub background: [f32; 4],
}

/// The planes.
#[derive(Debug, Default)]
pub(crate) struct Field {
    pub planes: Vec<f32>,
    pub stride: usize,
    pub rows: Option<RowSet>,
}

/// What to leave in the planes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Output {
    /// `∂L/∂(Σwc)` for each channel and `h = Σ g I` (normalized) or 0 (sum), for the squared error.
    Gradient,
    /// The picture `I` for each channel and `Σ w`.
    Picture,
    /// `Σ w c` and `Σ w` as they are.
    Sums,
}

/// For each band of sampled rows, the primitives that reach into it, in order.
#[derive(Debug, Default)]
pub(crate) struct Bands {
    starts: Vec<u32>,
    members: Vec<u32>,
}

impl Bands {
    pub(crate) fn new(projected: &[Projected], rows: RowSet, height: u32) -> Self {
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
}

impl Field {
    /// Sums `projected` over the rows of `rows` and leaves `output` in the planes. Returns the squared error of the
    /// clamped picture over those rows: weighted as the target has it for the gradients, plain for
    /// [`Output::Picture`], 0 for [`Output::Sums`].
    pub(crate) fn draw(
        &mut self,
        scene: &Scene,
        target: &Target,
        projected: &[Projected],
        rows: RowSet,
        output: Output,
    ) -> f64 {
        match target.channels.count() {
            1 => self.draw_channels::<1>(scene, target, projected, rows, output),
            2 => self.draw_channels::<2>(scene, target, projected, rows, output),
            3 => self.draw_channels::<3>(scene, target, projected, rows, output),
            _ => self.draw_channels::<4>(scene, target, projected, rows, output),
        }
    }

    fn draw_channels<const C: usize>(
        &mut self,
        scene: &Scene,
        target: &Target,
        projected: &[Projected],
        rows: RowSet,
        output: Output,
    ) -> f64 {
        let bands = Bands::new(projected, rows, scene.height);
        let row_size = (C + 1) * target.stride;
        self.stride = target.stride;
        self.rows = Some(rows);
        self.planes.resize(rows.count(scene.height) * row_size, 0.0);
        let arch = pulp::Arch::new();
        let errors = parallel::map_chunks(&mut self.planes, BAND * row_size, |b, band| {
            let members = &bands.members[bands.starts[b] as usize..bands.starts[b + 1] as usize];
            arch.dispatch(BandTask::<C> { scene, target, projected, members, rows, first: b * BAND, band, output })
        });
        errors.iter().sum()
    }

    /// The gradients of a run of primitives, gathered from gradient planes over `rows`.
    pub(crate) fn gather(
        &self,
        channels: usize,
        rows: RowSet,
        width: u32,
        projected: &[Projected],
        primitives: &[Primitive],
    ) -> Vec<Gradient> {
        let (arch, field) = (pulp::Arch::new(), self);
        match channels {
            1 => arch.dispatch(GatherTask::<1> { field, rows, width, projected, primitives }),
            2 => arch.dispatch(GatherTask::<2> { field, rows, width, projected, primitives }),
            3 => arch.dispatch(GatherTask::<3> { field, rows, width, projected, primitives }),
            _ => arch.dispatch(GatherTask::<4> { field, rows, width, projected, primitives }),
        }
    }

    /// The planes of sampled row `i`.
    #[inline(always)]
    pub(crate) fn row(&self, i: usize, channels: usize) -> &[f32] {
        let size = (channels + 1) * self.stride;
        &self.planes[i * size..][..size]
    }
}

/// One band to draw. A struct and not a closure: only `inline(always)` carries the dispatched instruction set inside.
struct BandTask<'a, const C: usize> {
    scene: &'a Scene,
    target: &'a Target,
    projected: &'a [Projected],
    members: &'a [u32],
    rows: RowSet,
    first: usize,
    band: &'a mut [f32],
    output: Output,
}

impl<const C: usize> pulp::WithSimd for BandTask<'_, C> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> f64 {
        let BandTask { scene, target, projected, members, rows, first, band, output } = self;
        let stride = target.stride;
        let row_size = (C + 1) * stride;
        let count = band.len() / row_size;
        band.fill(0.0);
        for &i in members {
            let p = &projected[i as usize];
            for index in rows.index(p.rows[0]).max(first)..rows.index(p.rows[1]).min(first + count) {
                let row = &mut band[(index - first) * row_size..][..row_size];
                kernel::splat_row::<C>(p, rows.row(index), scene.width, row, stride);
            }
        }
        if output == Output::Sums {
            return 0.0;
        }
        let mut error = 0.0;
        for i in 0..count {
            let y = rows.row(first + i);
            let row = &mut band[i * row_size..][..row_size];
            let alpha = target.channels.alpha();
            let amplitude = if output == Output::Picture { None } else { target.amplitude(y) };
            error += resolve_row::<C>(scene, target.row(y), row, stride, output, alpha, amplitude);
        }
        error
    }
}

/// Turns the sums of one row into `output`; returns the squared error of the clamped row.
#[inline(always)]
fn resolve_row<const C: usize>(
    scene: &Scene,
    target: &[f32],
    row: &mut [f32],
    stride: usize,
    output: Output,
    alpha: Option<usize>,
    amplitude: Option<&[f32]>,
) -> f64 {
    let mut error = [0.0f32; LANES];
    let w = scene.width as usize;
    let (colors, weights) = row.split_at_mut(C * stride);
    let mut x = 0;
    while x < w {
        let sum = kernel::load(weights, x);
        let inside = w - x;
        let inv = match scene.blend {
            Blend::Normalized => kernel::lanes(|i| 1.0 / (sum[i] + EPSILON)),
            Blend::Sum => [1.0; LANES],
        };
        let mut h = [0.0f32; LANES];
        let opacity = alpha.map(|a| kernel::load(target, a * stride + x));
        let amplitude = amplitude.map(|a| kernel::load(a, x));
        for k in 0..C {
            let run = kernel::load(colors, k * stride + x);
            let t = kernel::load(target, k * stride + x);
            let b = scene.background[k];
            let v = match scene.blend {
                Blend::Normalized => kernel::lanes(|i| (run[i] + EPSILON * b) * inv[i]),
                Blend::Sum => kernel::lanes(|i| run[i] + b),
            };
            let mut e = kernel::lanes(|i| v[i].clamp(0.0, 1.0) - t[i]);
            if let (Some(o), false) = (opacity, alpha == Some(k)) {
                e = kernel::lanes(|i| e[i] * o[i]);
            }
            if inside < LANES {
                e = kernel::lanes(|i| if i < inside { e[i] } else { 0.0 });
            }
            if let Some(a) = amplitude {
                e = kernel::lanes(|i| e[i] * a[i]);
            }
            error = kernel::lanes(|i| error[i] + e[i] * e[i]);
            if let Some(a) = amplitude {
                e = kernel::lanes(|i| e[i] * a[i]);
            }
            let left = match output {
                Output::Picture | Output::Sums => v,
                Output::Gradient => kernel::lanes(|i| e[i] * inv[i]),
            };
            kernel::store(colors, k * stride + x, &left);
            if scene.blend == Blend::Normalized {
                h = kernel::lanes(|i| h[i] + left[i] * v[i]);
            }
        }
        if output == Output::Gradient {
            kernel::store(weights, x, &h);
        }
        x += LANES;
    }
    // Runs may overhang the row's end: what lies there must not count.
    for plane in row.chunks_exact_mut(stride) {
        plane[x..].fill(0.0);
    }
    f64::from(kernel::total(&error))
}

/// The gradient of half the squared error with respect to one primitive, gathered from gradient planes, in the
/// primitive's whitened frame: mean along its own axes in units of its own scales, log-scales, rotation, colour.
#[inline(always)]
pub(crate) fn gather<const C: usize>(
    field: &Field,
    rows: RowSet,
    width: u32,
    p: &Projected,
    log_scale: [f32; 2],
    rotation: f32,
) -> Gradient {
    let mut m = Moments::<C>::zero();
    for index in rows.index(p.rows[0])..rows.index(p.rows[1]) {
        kernel::gather_row::<C>(p, rows.row(index), width, field.row(index, C), field.stride, &mut m);
    }
    let [_, geometry @ ..] = m.geometry.map(|v| kernel::total(&v));
    let mut gradient = Gradient::from_moments(geometry, log_scale.map(f32::exp), rotation);
    for k in 0..C {
        gradient.color[k] = kernel::total(&m.color[k]);
    }
    gradient
}

/// The gradients of a run of primitives; a struct for the same reason as [`BandTask`].
struct GatherTask<'a, const C: usize> {
    field: &'a Field,
    rows: RowSet,
    width: u32,
    projected: &'a [Projected],
    primitives: &'a [Primitive],
}

impl<const C: usize> pulp::WithSimd for GatherTask<'_, C> {
    type Output = Vec<Gradient>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Vec<Gradient> {
        let mut out = Vec::with_capacity(self.projected.len());
        for (q, p) in self.projected.iter().zip(self.primitives) {
            out.push(gather::<C>(self.field, self.rows, self.width, q, p.log_scale, p.rotation));
        }
        out
    }
}

/// A gradient in the whitened frame of its primitive.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Gradient {
    pub mean: [f32; 2],
    pub log_scale: [f32; 2],
    pub rotation: f32,
    pub color: [f32; 4],
}

impl Gradient {
    /// From `Σ t` times `dx`, `dy`, `dx²`, `dx dy` and `dy²`, where `t` is the gradient with respect to the exponent.
    #[inline(always)]
    pub(crate) fn from_moments([m10, m01, m20, m11, m02]: [f32; 5], [sx, sy]: [f32; 2], rotation: f32) -> Self {
        let (sin, cos) = rotation.sin_cos();
        let (ix, iy) = (1.0 / (sx * sx), 1.0 / (sy * sy));
        let uu = cos * cos * m20 + 2.0 * cos * sin * m11 + sin * sin * m02;
        let vv = sin * sin * m20 - 2.0 * cos * sin * m11 + cos * cos * m02;
        let uv = cos * sin * (m02 - m20) + (cos * cos - sin * sin) * m11;
        Gradient {
            mean: [(cos * m10 + sin * m01) / sx, (cos * m01 - sin * m10) / sy],
            log_scale: [uu * ix, vv * iy],
            rotation: -uv * (ix - iy),
            color: [0.0; 4],
        }
    }
}
