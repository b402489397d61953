//! The detail layer of an encode: what the Gaussians leave, coded in the bytes that are left.

mod choose;
mod classes;
mod coefficients;
mod divide;
pub(super) mod error;
mod join;
mod residual;
mod search;

use std::sync::Arc;

use super::job::{Encoding, Outcome};
use super::subject::stored_scene;
use crate::bitstream::detail::levels::tile_counts;
use crate::bitstream::detail::{DetailHead, DetailLayer};
use crate::bitstream::splats::PackedSplats;
use crate::error::Result;
use crate::options::Tune;
use crate::round::rounded::projected;
use choose::{Care, Setting};
use error::Counted;
use search::{Aim, Coded, search};

/// Runs of the coder that a search may take.
const RUNS: u32 = 7;

/// How a layer is coded to favour a measure.
fn preset(tune: Tune) -> (DetailHead, f32, f32) {
    match tune {
        Tune::Psnr => (DetailHead::PLAIN, 0.10, 0.0),
        Tune::Ssim => {
            (DetailHead { chroma: [48, 32], slopes: [16, 16], biases: [2, 4], ..DetailHead::SEEN }, 0.09, 0.08)
        }
        Tune::Iq => (DetailHead::SEEN, 0.07, 0.15),
    }
}

impl Encoding<'_> {
    /// Adds a detail layer to a file of Gaussians, in what is left of `most` bytes; nothing where that is too little. The integers
    /// of the Gaussians are then fitted to it in `rounds` rounds.
    pub(super) fn add_detail(&mut self, outcome: &mut Outcome, most: u64, rounds: u32) -> Result<()> {
        let clock = self.journal.seconds();
        if let Some(mut coded) = self.coded(&outcome.splats, most, None)? {
            let mut error = self.layered_error(&outcome.splats, &coded);
            for _ in 0..rounds {
                let (_, lambda, _) = preset(self.subject.options.favoured());
                let mut splats = outcome.splats.clone();
                let step = f32::from(coded.layer.head.step) / 64.0 / 255.0;
                // An error of luma is one in each of the colours.
                let colors = if self.planes.channels.count() >= 3 { 3.0 } else { 1.0 };
                let price = colors * lambda * step * step;
                let layer = (&coded, self.subject.channels());
                join::descend(&mut splats, &self.planes, layer, price, self.subject.options.levels)?;
                let Some(next) = self.coded(&splats, most, Some(&coded))? else { break };
                let next_error = self.layered_error(&splats, &next);
                if next_error >= error {
                    break;
                }
                (error, coded, outcome.splats) = (next_error, next, splats);
            }
            outcome.splats.detail = Some(Arc::new(coded.layer));
            outcome.bytes = self.subject.file(&outcome.splats)?;
        }
        self.journal.stage("detail", clock);
        Ok(())
    }

    /// The error that is to be small, as the fit weighs it.
    fn layered_error(&self, splats: &PackedSplats, coded: &Coded) -> f64 {
        let drawn = projected(&splats.quantizer(), &splats.gaussians, splats.height);
        let layer = (&coded.layer, self.subject.channels());
        error::squared_error((stored_scene(splats), &self.planes), &drawn, layer, Counted::AsTheyWeigh)
    }

    /// Codes what the Gaussians of `splats` leave, for a file of at most `most` bytes.
    fn coded(&self, splats: &PackedSplats, most: u64, near: Option<&Coded>) -> Result<Option<Coded>> {
        let (mut head, lambda, power) = preset(self.subject.options.favoured());
        head.alpha = self.planes.channels.alpha().is_some();
        let size = [self.planes.width, self.planes.height];
        let [across, down] = tile_counts(size);
        let count = across * down;
        let mut empty = splats.clone();
        empty.detail = Some(Arc::new(DetailLayer { head, tiles: vec![None; count] }));
        let fixed = self.subject.file(&empty)?.len() as u64 - count as u64;
        let Some(left) = most.checked_sub(fixed).filter(|&left| left > 2 * count as u64) else { return Ok(None) };
        let drawn = projected(&splats.quantizer(), &splats.gaussians, splats.height);
        let tiles = residual::residuals(stored_scene(splats), &self.planes, &drawn);
        let setting = Setting { head, channels: self.subject.channels(), lambda, care: Care::Thorough };
        Ok(search(&tiles, &Aim { setting, power, most: left, runs: RUNS }, near))
    }
}
