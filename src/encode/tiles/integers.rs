//! Optimization of the integers of a tile: a sweep of descent, while the primitives around the tile stay fixed.

use super::global::GlobalContext;
use super::grid::Window;
use super::mosaic::{Placed, TileResult, WindowPrimitives};
use crate::bitstream::splats::{PackedGaussian, PackedSplats};
use crate::constants::tiles;
use crate::encode::file;
use crate::error::Result;
use crate::fit::model::drawing::field::{Field, Output, error_within};
use crate::fit::model::drawing::project::Projected;
use crate::fit::model::problem::{Problem, Scene};
use crate::quantize::Quantizer;
use crate::rdo::descend::Descent;
use crate::rdo::size::{self, Worth};

/// A window and its integers, in the window's own coordinates.
pub(super) struct Part<'a> {
    global: &'a GlobalContext<'a>,
    window: &'a Window,
    /// The file of the window alone.
    splats: PackedSplats,
    quantizer: Quantizer,
    frozen: Vec<Projected>,
}

impl<'a> Part<'a> {
    /// Cuts a window out of the picture.
    pub(super) fn new(
        global: &'a GlobalContext<'a>,
        window: &'a Window,
        WindowPrimitives { own, neighbours }: WindowPrimitives<PackedGaussian>,
    ) -> Self {
        let quantizer_of_whole = global.blank.quantizer();
        let height = window.padded.size[1];
        let gaussians = own.iter().map(|p| moved(p, &quantizer_of_whole, window.padded.corner, Move::In)).collect();
        let origin = window.padded.origin();
        let frozen = neighbours.iter().map(|p| {
            let mut g = quantizer_of_whole.dequantize(p);
            g.mean = [g.mean[0] - origin[0], g.mean[1] - origin[1]];
            Projected::from_gaussian(&g, height)
        });
        let frozen = frozen.collect();
        let splats = PackedSplats { gaussians, ..global.draft(&window.padded) };
        Part { global, window, quantizer: splats.quantizer(), splats, frozen }
    }

    fn scene(&self) -> Scene {
        let background = self.quantizer.dequantize_color(self.splats.background);
        Scene { background, ..self.global.scene(&self.window.padded) }
    }

    /// Returns the squared error of the tile, with the weights of the fit.
    pub(super) fn error(self) -> Result<f64> {
        let target = self.global.planes(&self.window.padded)?;
        let problem = Problem { scene: self.scene(), target: &target };
        let descent = Descent::new(problem, &self.quantizer, Field::default()).with_frozen(self.frozen);
        Ok(error_within(&problem, &descent.visible(&self.splats.gaussians), self.window.own(), Output::Gradient))
    }

    /// Measures the error, with the weights of the fit, and the costs of the primitives, and finds candidates.
    pub(super) fn appraise(self) -> Result<TileResult<PackedGaussian>> {
        self.swept(None)
    }

    /// Sweeps once over the integers. A bit must save a squared error of `lambda`. Then measures as
    /// [`appraise`](Self::appraise) does, but only the error under a detail layer, where the number of primitives is
    /// not corrected.
    pub(super) fn sweep(self, lambda: f64) -> Result<TileResult<PackedGaussian>> {
        self.swept(Some(lambda))
    }

    fn swept(mut self, lambda: Option<f64>) -> Result<TileResult<PackedGaussian>> {
        let target = self.global.planes(&self.window.padded)?;
        let problem = Problem { scene: self.scene(), target: &target };
        let expected = if lambda.is_some() { file::expected(&mut self.splats, 1)? } else { Vec::new() };
        let mut descent = Descent::new(problem, &self.quantizer, Field::default()).with_frozen(self.frozen);
        let mut own = self.splats.gaussians;
        if let Some(lambda) = lambda {
            descent.sweep(&mut own, &expected, lambda as f32);
        }
        let error = error_within(&problem, &descent.visible(&own), self.window.own(), Output::Gradient);
        let worth = match self.global.settings.is_base && lambda.is_some() {
            true => Worth { costs: vec![0.0; own.len()], candidates: Vec::new() },
            false => size::worth(&mut descent, &own, candidate_count(own.len())),
        };
        let global = |p: &PackedGaussian| moved(p, &self.quantizer, self.window.padded.corner, Move::Out);
        let placed = |(p, cost): (&PackedGaussian, f32)| Placed { primitive: global(p), cost };
        let is_own = |p: &PackedGaussian| {
            let [x, y] = self.quantizer.dequantize(p).mean;
            let origin = self.window.padded.origin();
            self.window.core.holds([x + origin[0], y + origin[1]])
        };
        Ok(TileResult {
            own: own.iter().zip(worth.costs).map(placed).collect(),
            candidates: worth
                .candidates
                .iter()
                .filter(|(p, _)| is_own(p))
                .map(|(p, gain)| placed((p, *gain)))
                .collect(),
            error,
        })
    }
}

/// Returns the number of candidate primitives to search for in a tile of `own` primitives.
pub(super) fn candidate_count(own: usize) -> usize {
    (own as f32 * tiles::INTEGER_CANDIDATE_SHARE) as usize + tiles::MIN_INTEGER_CANDIDATES
}

/// Direction of a conversion: into a part, or out of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Move {
    In,
    Out,
}

/// Returns the offset of a corner from the picture's corner, in steps of `2^exponent` pixels.
pub(super) fn steps(corner: u32, exponent: i32) -> u32 {
    if exponent >= 0 { corner >> exponent } else { corner << -exponent }
}

/// Converts a position between coordinates of the picture and those of its part at `corner`. The offset is a whole
/// number of steps, because no step is longer than a [`UNIT`](super::grid::UNIT).
fn moved(p: &PackedGaussian, quantizer: &Quantizer, corner: [u32; 2], way: Move) -> PackedGaussian {
    let exponents = quantizer.lattice().exponents(p.major, p.minor, p.angle);
    let steps = |k: usize| steps(corner[k], exponents[k]);
    match way {
        Move::In => PackedGaussian { x: p.x - steps(0), y: p.y - steps(1), ..*p },
        Move::Out => PackedGaussian { x: p.x + steps(0), y: p.y + steps(1), ..*p },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bitstream::splats::{Layout, Steps};
    use crate::gaussian::Channels;

    #[test]
    fn positions_convert_exactly_between_a_part_and_the_picture() {
        let steps = Steps { scale: 4, angle: 1, position: 6, coarsest: 6, range: 10, luma: 6, chroma: 1 };
        let of = |size| Quantizer::new(&steps, Layout::Coded, size, Channels::Rgb);
        let (global, part) = (of([5000, 3000]), of([700, 500]));
        let corner = [1024, 64 * 13];
        for major in 0..40u8 {
            let inside = PackedGaussian { x: 3, y: 5, major, minor: major / 2, angle: 1, color: [1, 2, 3, 0] };
            let outside = moved(&inside, &part, corner, Move::Out);
            assert_eq!(moved(&outside, &global, corner, Move::In), inside);
            let [a, b] = [part.dequantize(&inside).mean, global.dequantize(&outside).mean];
            assert_eq!([a[0] + corner[0] as f32, a[1] + corner[1] as f32], b);
        }
    }
}
