//! Optimizes the Gaussians' integers once more after the layer has been coded, because it now represents a part of the
//! picture.

use crate::bitstream::DetailLayer;
use crate::bitstream::splats::PackedSplats;
use crate::constants::detail;
use crate::encode::file;
use crate::encode::input::stored_scene;
use crate::encode::stored_error::Added;
use crate::error::Result;
use crate::fit::model::drawing::field::{Field, Output};
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::objective::rows::RowSet;
use crate::fit::model::problem::Problem;
use crate::gaussian::Channels;
use crate::rdo::descend::Descent;
use crate::rdo::rounded::projected;

/// Returns the target for the Gaussians of `splats` under `layer`: the picture minus the additions of the layer.
fn rest(target: &Planes, splats: &PackedSplats, layer: &DetailLayer, channels: Channels) -> Planes {
    let added = Added::new(layer, channels, target);
    let scene = stored_scene(splats);
    let mut field = Field::default();
    let drawn = projected(&splats.quantizer(), &splats.gaussians, splats.height);
    field.draw(&Problem { scene, target }, &drawn, RowSet::ALL, Output::Picture);
    let (count, stride, width) = (target.channels.count(), target.stride, target.width as usize);
    target.changed(|y, row| {
        let drawn = field.row(y, count);
        let mut more = vec![0.0; width];
        for k in 0..count {
            added.row(y, k, &mut more);
            for (x, more) in more.iter().enumerate() {
                let at = k * stride + x;
                // Rendering clips values beyond black and white before it adds the layer, so such values are not an
                // error.
                let beyond = drawn[at] - drawn[at].clamp(0.0, 1.0);
                row[at] += beyond - more;
            }
        }
    })
}

/// Changes the integers of `splats` to those with the lowest cost under `layer`. A bit costs `lambda` of squared error,
/// in squared fractions of white. The length of the file is not constrained.
pub(super) fn descend(
    splats: &mut PackedSplats,
    target: &Planes,
    (layer, channels): (&DetailLayer, Channels),
    lambda: f32,
    levels: u8,
) -> Result<()> {
    let rest = rest(target, splats, layer, channels);
    let problem = Problem { scene: stored_scene(splats), target: &rest };
    let quantizer = splats.quantizer();
    let mut descent = Descent::new(problem, &quantizer, Field::default());
    let mut bare = PackedSplats { detail: None, codebook: None, ..splats.clone() };
    for _ in 0..detail::REFINEMENT_SWEEPS {
        let expected = file::expected(&mut bare, levels)?;
        descent.sweep(&mut bare.gaussians, &expected, lambda);
    }
    file::smallest(&mut bare, levels)?;
    (splats.gaussians, splats.codebook, splats.levels) = (bare.gaussians, bare.codebook, bare.levels);
    splats.detail = None;
    Ok(())
}
