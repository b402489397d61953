//! A quadratic model of the error around one primitive, as a function of its mean, scales and rotation. It selects the
//! moves that are worth a pass over the pixels.

use crate::bitstream::splats::PackedGaussian;
use crate::constants::rdo;

/// Half the gradient and half the Hessian (Gauss–Newton) of the squared error in the primitive's whitened frame: mean,
/// log-scales, rotation. The colour is optimized for each shape.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LocalQuadratic {
    pub slope: [f32; 5],
    pub curvature: [[f32; 5]; 5],
}

/// Change of the squared error as a function of the mean, for fixed scales and rotation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FixedShapeQuadratic {
    constant: f32,
    slope: [f32; 2],
    curvature: [[f32; 2]; 2],
}

impl LocalQuadratic {
    /// Returns the model for log-scales and rotation that differ by `shape`.
    #[inline(always)]
    pub(crate) fn with_shape(&self, shape: [f32; 3]) -> FixedShapeQuadratic {
        let c = &self.curvature;
        let mut constant = 0.0;
        let mut slope = [self.slope[0], self.slope[1]];
        for i in 0..3 {
            constant += 2.0 * self.slope[2 + i] * shape[i];
            for j in 0..3 {
                constant += c[2 + i][2 + j] * shape[i] * shape[j];
            }
            slope[0] += c[0][2 + i] * shape[i];
            slope[1] += c[1][2 + i] * shape[i];
        }
        FixedShapeQuadratic { constant, slope, curvature: [[c[0][0], c[0][1]], [c[1][0], c[1][1]]] }
    }
}

impl FixedShapeQuadratic {
    /// Returns the shift of the mean with the smallest error, within the range where the model holds.
    #[inline(always)]
    pub(crate) fn minimum(&self) -> [f32; 2] {
        let [[a, b], [_, c]] = self.curvature;
        // Regularize, so that rounding cannot move the mean far along a direction in which the error is flat.
        let ridge = 1e-3 * (a.max(0.0) + c.max(0.0)) + 1e-9;
        let (a, c) = (a.max(0.0) + ridge, c.max(0.0) + ridge);
        let det = (a * c - b * b).max(1e-3 * a * c);
        let [u, v] = self.slope;
        [(b * v - c * u) / det, (b * u - a * v) / det].map(|s| s.clamp(-rdo::TRUST_RADIUS, rdo::TRUST_RADIUS))
    }

    /// Returns the change of the error if the mean shifts by `(u, v)`.
    #[inline(always)]
    pub(crate) fn at(&self, [u, v]: [f32; 2]) -> f32 {
        let [[a, b], [_, c]] = self.curvature;
        self.constant + 2.0 * (self.slope[0] * u + self.slope[1] * v) + a * u * u + 2.0 * b * u * v + c * v * v
    }
}

/// The most promising moves, best first.
#[derive(Debug, Default)]
pub(crate) struct Moves {
    best: [(f32, PackedGaussian); rdo::MAX_MOVES],
    count: usize,
}

impl Moves {
    /// Adds a move that is expected to change the objective by `value`.
    #[inline(always)]
    pub(crate) fn add(&mut self, value: f32, to: PackedGaussian) {
        let at = self.best[..self.count].iter().position(|b| value < b.0).unwrap_or(self.count);
        if at < rdo::MAX_MOVES {
            self.count = (self.count + 1).min(rdo::MAX_MOVES);
            self.best.copy_within(at..self.count - 1, at + 1);
            self.best[at] = (value, to);
        }
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = PackedGaussian> {
        self.best[..self.count].iter().map(|b| b.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_returned_shift_minimizes_the_error_for_its_shape() {
        let mut local_quadratic = LocalQuadratic { slope: [0.3, -0.2, 0.1, 0.4, -0.5], ..LocalQuadratic::default() };
        for i in 0..5 {
            for j in 0..5 {
                local_quadratic.curvature[i][j] = if i == j { 2.0 } else { 0.1 * (i + j) as f32 };
            }
        }
        let quadratic = local_quadratic.with_shape([0.2, -0.1, 0.3]);
        let [u, v] = quadratic.minimum();
        for (du, dv) in [(0.05, 0.0), (-0.05, 0.0), (0.0, 0.05), (0.0, -0.05)] {
            assert!(quadratic.at([u, v]) < quadratic.at([u + du, v + dv]));
        }
    }

    #[test]
    fn the_best_moves_are_kept_in_order() {
        let mut moves = Moves::default();
        for i in [5u32, 3, 9, 1, 7, 2, 8, 4, 6, 0] {
            moves.add(i as f32, PackedGaussian { x: i, ..PackedGaussian::default() });
        }
        assert_eq!(moves.iter().map(|g| g.x).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5]);
    }
}
