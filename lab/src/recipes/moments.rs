//! Gradients with respect to positions and covariances, from sums over a Gaussian's pixels.

use ssplat::unstable::fit::model::drawing::field::Field;
use ssplat::unstable::fit::model::drawing::kernel;
use ssplat::unstable::fit::model::drawing::project::Projected;
use ssplat::unstable::fit::model::objective::rows::RowSet;
use ssplat::unstable::parallel;
use ssplat::unstable::simd::{self, Simd, Task};

/// Gaussians in one unit of parallel work.
const CHUNK: usize = 64;

/// The gradient with respect to a Gaussian in the picture.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Slope {
    /// Gradient with respect to the position, per pixel.
    pub mean: [f32; 2],
    /// Gradient with respect to the covariance `[xx, xy, yy]`: the entries of the symmetric matrix `∂L/∂Σ`, per
    /// pixel².
    pub covariance: [f32; 3],
    pub color: [f32; 4],
}

impl Slope {
    /// Computes the gradient from `Σ t` times `dx`, `dy`, `dx²`, `dx dy` and `dy²`, where `t` is the gradient with
    /// respect to the exponent `−½ xᵀ C x`: `∂L/∂μ = C Σ t x` and `∂L/∂Σ = ½ C (Σ t x xᵀ) C`.
    pub(super) fn from_moments([m10, m01, m20, m11, m02]: [f32; 5], [a, b, c]: [f32; 3], color: [f32; 4]) -> Self {
        // M C by rows, then C (M C).
        let [p, q] = [m20 * a + m11 * b, m20 * b + m11 * c];
        let [r, s] = [m11 * a + m02 * b, m11 * b + m02 * c];
        Slope {
            mean: [a * m10 + b * m01, b * m10 + c * m01],
            covariance: [0.5 * (a * p + b * r), 0.5 * (a * q + b * s), 0.5 * (b * q + c * s)],
            color,
        }
    }
}

/// Returns the gradients of all of `projected` from gradient planes over all rows.
pub(super) fn slopes(field: &Field, channels: usize, width: u32, projected: &[Projected]) -> Vec<Slope> {
    let chunks = projected.len().div_ceil(CHUNK);
    parallel::map(chunks, |c| {
        let projected = &projected[c * CHUNK..projected.len().min((c + 1) * CHUNK)];
        match channels {
            1 => simd::dispatch(Gather::<1> { field, width, projected }),
            _ => simd::dispatch(Gather::<3> { field, width, projected }),
        }
    })
    .concat()
}

struct Gather<'a, const C: usize> {
    field: &'a Field,
    width: u32,
    projected: &'a [Projected],
}

impl<const C: usize> Task for Gather<'_, C> {
    type Output = Vec<Slope>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Vec<Slope> {
        let mut out = Vec::with_capacity(self.projected.len());
        for p in self.projected {
            let planes = (&self.field.planes[..], self.field.stride);
            let m = kernel::gather::<S, C>(simd, p, RowSet::ALL, self.width, planes);
            let mut color = [0.0; 4];
            color[..C].copy_from_slice(&m.color);
            out.push(Slope::from_moments(m.geometry, p.conic, color));
        }
        out
    }
}
