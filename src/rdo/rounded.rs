//! Integer primitives, the step sizes that they use, and their projection.

use crate::bitstream::splats::{Layout, PackedGaussian, Steps};
use crate::constants::rdo;
use crate::fit::model::drawing::field::{Field, Output};
use crate::fit::model::drawing::project::{self, Primitive, Projected};
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::problem::{Problem, Scene};
use crate::quantize::Quantizer;
use crate::strict_math::StrictMath;

/// Integer primitives with their step sizes.
#[derive(Debug, Clone)]
pub(crate) struct Rounded {
    pub steps: Steps,
    pub background: [i16; 4],
    pub gaussians: Vec<PackedGaussian>,
}

impl Rounded {
    /// Rounds `primitives` to the nearest integers, with steps that suit their error in some of the rows.
    pub(crate) fn nearest(problem: &Problem<'_>, layout: Layout, primitives: &[Primitive]) -> Self {
        let height = problem.scene.height;
        let step = (height / rdo::ROWS_OF_STEPS).clamp(1, rdo::MAX_ROW_DISTANCE_OF_STEPS);
        let rows = RowSet { step, phase: step / 2 };
        let error = Field::default().draw(problem, &project::all(primitives, height), rows, Output::Picture);
        Self::of_error(problem, layout, primitives, error * problem.samples(RowSet::ALL) / problem.samples(rows))
    }

    /// Rounds `primitives`, whose picture has the squared error `error`.
    pub(super) fn of_error(problem: &Problem<'_>, layout: Layout, primitives: &[Primitive], error: f64) -> Self {
        let psnr = -10.0 * (error / problem.samples(RowSet::ALL)).strict_log10();
        let steps = steps(primitives, layout, psnr);
        let quantizer = quantizer(problem, layout, &steps);
        let background = quantizer.quantize_color(problem.scene.background);
        let mut rounded = Rounded { steps, background, gaussians: Vec::new() };
        rounded.round(&quantizer, primitives);
        rounded
    }

    /// Replaces the primitives by `primitives`, rounded to the nearest integers.
    pub(super) fn round(&mut self, quantizer: &Quantizer, primitives: &[Primitive]) {
        self.gaussians = primitives.iter().map(|p| quantizer.quantize(&p.to_gaussian())).collect();
    }
}

/// Returns the quantizer of `problem` with these steps.
pub(super) fn quantizer(problem: &Problem<'_>, layout: Layout, steps: &Steps) -> Quantizer {
    let Scene { width, height, .. } = problem.scene;
    Quantizer::new(steps, layout, [width, height], problem.target.channels)
}

/// Projects integer primitives into a picture of `height` rows.
pub(crate) fn projected(quantizer: &Quantizer, gaussians: &[PackedGaussian], height: u32) -> Vec<Projected> {
    gaussians.iter().map(|g| Projected::from_gaussian(&quantizer.dequantize(g), height)).collect()
}

/// Returns the step sizes for `primitives` in `layout`, where `psnr` is the PSNR of their picture before rounding. The
/// better the fit, the finer the steps that use the bytes best.
pub(crate) fn steps(primitives: &[Primitive], layout: Layout, psnr: f64) -> Steps {
    let mut sizes: Vec<f32> = primitives.iter().map(|p| p.log_scale[0].max(p.log_scale[1])).collect();
    sizes.sort_by(f32::total_cmp);
    let at = |share: f32| sizes.get((sizes.len() as f32 * share) as usize).copied().unwrap_or(0.0);
    match layout {
        Layout::Coded => {
            // A PSNR that is not a number belongs to a picture without error.
            let passed = rdo::STEP_PSNRS.iter().filter(|&&limit| psnr >= limit || psnr.is_nan()).count();
            let [scale, position, luma] = rdo::CODED_STEPS[passed];
            let log2 = at(rdo::COARSEST_QUANTILE) / std::f32::consts::LN_2 - f32::from(position) / 4.0;
            let coarsest = (log2.ceil() as i8).clamp(-2, 9);
            let range = (coarsest + 4).clamp(1, 15) as u8;
            Steps { scale, angle: 1, position, coarsest, range, luma, chroma: 1 }
        }
        Layout::Packed | Layout::Planes => {
            // One step for all positions, fine enough for the small Gaussians.
            let small = at(rdo::SINGLE_STEP_QUANTILE) / std::f32::consts::LN_2;
            let coarsest = ((small - rdo::SINGLE_STEP_LOG_PART).round() as i8).clamp(-4, 6);
            Steps { scale: 2, angle: 1, position: 5, coarsest, range: 0, luma: 8, chroma: 2 }
        }
    }
}
