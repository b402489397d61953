//! Properties of the whole picture that all tiles share. They are computed before any tile is fitted, so that the tiles
//! match each other.

use std::time::Duration;

use super::grid::{Area, Window};
use crate::bitstream::splats::PackedSplats;
use crate::constants::fit;
use crate::effort::EffortSettings;
use crate::encode::device::Choice;
use crate::error::Result;
use crate::fit::model::objective::masking::{self, Means};
use crate::fit::model::objective::planes::Planes;
use crate::fit::model::placing::sample;
use crate::fit::model::problem::Scene;
use crate::fit::plan::Plan;
use crate::instant::Instant;
use crate::options::{HiddenColors, Tune};
use crate::pixel_source::PixelSource;

/// Settings for the fit of all tiles.
#[derive(Debug, Clone, Copy)]
pub(super) struct TileSettings {
    pub effort: u8,
    /// Initial number of primitives in the whole picture.
    pub count: usize,
    /// Whether the target is a number of bytes, so that bits have a price.
    pub is_priced: bool,
    /// Whether a detail layer is added to the primitives.
    pub is_base: bool,
    /// Mean squared error per sample at which a fit ends early.
    pub sufficient_error: f64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Whether colours under alpha 0 count.
    pub hidden: HiddenColors,
    /// Time limit for the work on one window, seconds.
    pub seconds: Option<f64>,
}

/// Properties of the picture that all tiles share.
pub(super) struct GlobalContext<'a> {
    pub source: &'a dyn PixelSource,
    pub scene: Scene,
    pub settings: TileSettings,
    /// The file without primitives.
    pub blank: PackedSplats,
    pub weights: Weights,
    /// Sum of the detail of all tiles.
    pub detail: f64,
    /// The device that fits.
    pub device: &'a Choice,
}

/// Weights of errors, with the statistics of the whole picture that they depend on.
#[derive(Debug, Clone, Copy)]
pub(super) enum Weights {
    Alike,
    Masking(Means),
}

impl Weights {
    /// Returns the tuning that these weights implement.
    pub(super) fn tune(&self) -> Tune {
        match self {
            Weights::Alike => Tune::Psnr,
            Weights::Masking(_) => Tune::Iq,
        }
    }
}

/// Properties of an encode that are known before its picture is read.
#[derive(Debug)]
pub(super) struct Survey {
    /// The picture. The survey computes its background.
    pub scene: Scene,
    /// The file without primitives.
    pub blank: PackedSplats,
    pub settings: TileSettings,
    pub tune: Tune,
}

impl Survey {
    /// Reads `tiles`, which together cover the picture of `source`, once. Returns the properties of the whole picture.
    /// Calls `on_progress` with the fraction that is done. The tiles will be fitted on `device`.
    pub(super) fn of<'a>(
        self,
        (source, device): (&'a dyn PixelSource, &'a Choice),
        tiles: &[Window],
        mut on_progress: impl FnMut(f32) -> Result<()>,
    ) -> Result<GlobalContext<'a>> {
        let Survey { scene, blank, settings, tune } = self;
        let area = f64::from(scene.width) * f64::from(scene.height);
        let room = area / settings.count.max(1) as f64;
        let mut weights = match tune {
            Tune::Psnr => Weights::Alike,
            Tune::Iq => Weights::Masking(Means::default()),
        };
        let (mut mean, mut detail) = ([0.0f64; 4], 0.0);
        for (i, tile) in tiles.iter().enumerate() {
            on_progress(i as f32 / tiles.len() as f32)?;
            let planes = Planes::with_hidden(&source.part(tile.core.bounds())?, settings.hidden);
            let share = tile.core.pixels() / area;
            mean.iter_mut().zip(planes.mean).for_each(|(m, v)| *m += share * f64::from(v));
            detail += sample::detail(&planes, room);
            match &mut weights {
                Weights::Alike => {}
                Weights::Masking(means) => {
                    let of_part = masking::means_of_part(&planes, room as f32);
                    means.iter_mut().zip(of_part).for_each(|(m, v)| *m += share * v);
                }
            }
        }
        let scene = Scene { background: mean.map(|v| v as f32), ..scene };
        Ok(GlobalContext { source, scene, settings, blank, weights, detail, device })
    }
}

impl GlobalContext<'_> {
    /// Returns the number of pixels per primitive.
    pub(super) fn room(&self) -> f64 {
        f64::from(self.scene.width) * f64::from(self.scene.height) / self.settings.count.max(1) as f64
    }

    /// Returns the pixels of `area` and the weights of their errors.
    pub(super) fn planes(&self, area: &Area) -> Result<Planes> {
        let mut planes = Planes::with_hidden(&self.source.part(area.bounds())?, self.settings.hidden);
        let room = self.room() as f32;
        planes.amplitude = match &self.weights {
            Weights::Alike => Vec::new(),
            Weights::Masking(means) => {
                planes.channel_amplitude = masking::channel_amplitude(planes.channels);
                masking::amplitudes_of_part(&planes, room, means)
            }
        };
        Ok(planes)
    }

    /// Returns the scene of `area`.
    pub(super) fn scene(&self, area: &Area) -> Scene {
        Scene { width: area.size[0], height: area.size[1], ..self.scene }
    }

    /// Returns the file of `area` without primitives.
    pub(super) fn draft(&self, area: &Area) -> PackedSplats {
        PackedSplats { width: area.size[0], height: area.size[1], ..self.blank.clone() }
    }

    /// Returns the number of primitives for a part of the picture, based on its detail and its area.
    pub(super) fn count_of(&self, planes: &Planes) -> usize {
        let area = f64::from(planes.width) * f64::from(planes.height);
        let global = f64::from(self.scene.width) * f64::from(self.scene.height);
        let busy = sample::detail(planes, self.room()) / self.detail;
        let share = fit::DETAIL_SHARE * busy + (1.0 - fit::DETAIL_SHARE) * area / global;
        // A tile never has more primitives than pixels, whatever the settings say about the whole picture.
        ((self.settings.count as f64 * share).round() as usize).min(area as usize)
    }

    /// Returns the plan that all windows share.
    pub(super) fn plan(&self) -> Plan {
        let TileSettings { effort, count, is_base, sufficient_error, seed, .. } = self.settings;
        let fit = EffortSettings::from_preset(effort).fit;
        let plan = Plan { enough: sufficient_error, ..Plan::new(&fit, count, self.scene.pixels(), None, seed) };
        if is_base { plan.for_base(&fit.base, self.weights.tune(), None, 1.0) } else { plan }
    }

    /// Returns the plan for a window, which has its own random seed and deadline.
    pub(super) fn plan_of(&self, window: &Window) -> Plan {
        let plan = self.plan();
        let seed = plan.seed.wrapping_add((window.index + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let fit_deadline = self
            .settings
            .seconds
            .and_then(|s| Duration::try_from_secs_f64(s).ok())
            .and_then(|time| Instant::now().checked_add(time));
        Plan { seed, fit_deadline, ..plan }
    }

    /// Returns the context for the picture of `source`, which is the same picture at another size.
    pub(super) fn at_size_of<'b>(self, source: &'b dyn PixelSource, device: &'b Choice) -> GlobalContext<'b> {
        let [width, height] = source.size();
        let scene = Scene { width, height, ..self.scene };
        let blank = PackedSplats { width, height, ..self.blank };
        let GlobalContext { settings, weights, detail, .. } = self;
        GlobalContext { source, scene, settings, blank, weights, detail, device }
    }
}
