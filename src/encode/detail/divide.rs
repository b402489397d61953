//! How the bytes of a file are divided between the Gaussians and the layer.

use crate::encode::job::Encoding;
use crate::error::Result;
use crate::fit::engine::Unwatched;
use crate::fit::job::Job;
use crate::fit::model::field::float_error;
use crate::fit::model::problem::Problem;
use crate::fit::plan::Plan;

impl Encoding<'_> {
    /// Returns the squared error of a short fit of `count` primitives.
    pub(in crate::encode) fn scout(&mut self, count: usize, steps: u32) -> Result<f64> {
        let plan = Plan::steps(steps, self.subject.options.seed);
        let problem = Problem { scene: self.subject.scene(self.planes.mean), target: &self.planes };
        let job = Job { problem, count, plan: &plan };
        let fitted = self.device.fit(&job, self.subject.pixels, &mut Unwatched)?;
        Ok(float_error(&problem, &fitted.by.primitives))
    }
}

impl Encoding<'_> {
    /// Peaks.
    pub(in crate::encode) fn promise(&self, splats: &crate::bitstream::splats::PackedSplats) -> (f64, f64) {
        use crate::fit::model::field::{Field, Output};
        use crate::fit::model::{peaks, rows::RowSet};
        let problem = Problem { scene: crate::encode::subject::stored_scene(splats), target: &self.planes };
        let drawn = crate::round::rounded::projected(&splats.quantizer(), &splats.gaussians, splats.height);
        let mut field = Field::default();
        let error = field.draw(&problem, &drawn, RowSet::ALL, Output::Picture);
        let n = splats.gaussians.len();
        let found = peaks::peaks(&problem, &field, RowSet::ALL, n, n);
        (error, found.iter().map(|p| f64::from(p.gain)).sum())
    }
}
