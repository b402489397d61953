//! Finds the quantizer step with which a layer uses its byte budget.

use super::adaptive_quantization::{Masking, activities};
use super::coefficients::{self, Division};
use super::flat_cells::Ground;
use super::partition::blocks;
use super::residual::TileResidual;
use super::ringing::ringing_cells;
use super::scaled::{CachedCoefficients, KEPT_TILES};
use super::settings::{BlockChoice, SearchSettings, Setting};
use super::trellis::{Chosen, choose, priced_blocks};
use crate::bitstream::detail::DetailLayer;
use crate::bitstream::detail::levels::{CELL, SUPER, TILE};
use crate::bitstream::detail::model::{KINDS, PLANES};
use crate::constants::detail;
use crate::detail::steps::PlaneSteps;
use crate::parallel;
use crate::strict_math::StrictMath;

/// A layer and the bytes that its index and streams take in the file.
#[derive(Debug, Clone)]
pub(super) struct Coded {
    pub layer: DetailLayer,
    pub bytes: u64,
    /// Block sizes of each tile, by kind.
    pub sizes: Vec<[Vec<u8>; KINDS]>,
}

/// Codes one residual with several steps, in the same blocks.
pub(super) struct Coder<'a> {
    tiles: &'a [TileResidual],
    settings: &'a SearchSettings,
    classes: Vec<Vec<u8>>,
    kept: Vec<CachedCoefficients>,
    sizes: Option<Vec<BlockSizes>>,
}

impl<'a> Coder<'a> {
    /// Prepares to code the layer of `tiles` with about this step. `near` is a layer of nearly the same tiles, whose
    /// blocks are kept if `settings` says so. Otherwise the first run chooses the blocks.
    pub(super) fn new(
        tiles: &'a [TileResidual],
        settings: &'a SearchSettings,
        step: f64,
        near: Option<&Coded>,
    ) -> Coder<'a> {
        let activity = activities(tiles, settings);
        let classes = Masking::new(&activity, settings, step).classes(&activity);
        let kept = if tiles.len() <= KEPT_TILES { vec![CachedCoefficients::new(); tiles.len()] } else { Vec::new() };
        let sizes = near.filter(|_| settings.keeps_blocks).map(|near| near.sizes.clone());
        Coder { tiles, settings, classes, kept, sizes }
    }

    /// Codes the layer with `step`.
    pub(super) fn run(&mut self, step: u16) -> Coded {
        let coded = code(self.tiles, &self.classes, self.settings, step, (self.sizes.as_deref(), &self.kept));
        self.sizes.get_or_insert_with(|| coded.sizes.clone());
        coded
    }
}

/// Returns the layer of `tiles` with the smallest step that fits, or `None` if none fits. `near` is a layer of nearly
/// the same tiles. The search starts at its step and keeps its blocks if `settings` says so.
pub(super) fn search(tiles: &[TileResidual], settings: &SearchSettings, near: Option<&Coded>) -> Option<Coded> {
    let step = near.map_or_else(
        || Magnitudes::of(tiles, settings).step_for(settings.max_bytes as f64),
        |near| f64::from(near.layer.head.step),
    );
    let mut coder = Coder::new(tiles, settings, step, near);
    let Ok(found) = smallest_step(settings, step, |step| Ok::<_, std::convert::Infallible>(coder.run(step)));
    found
}

/// Returns the result of `run` with the smallest step whose bytes fit, or `None` if none fits. The search starts at
/// `step`.
pub(super) fn smallest_step<E>(
    settings: &SearchSettings,
    mut step: f64,
    mut run: impl FnMut(u16) -> Result<Coded, E>,
) -> Result<Option<Coded>, E> {
    // The largest step that does not fit, the smallest that does, and their bytes, all as logarithms.
    let (mut over, mut under): (Option<[f64; 2]>, Option<[f64; 2]>) = (None, None);
    let (mut fall, mut last): (f64, Option<[f64; 2]>) = (detail::STEP_EXPONENT, None);
    let mut best: Option<Coded> = None;
    let goal = (settings.max_bytes as f64 * (1.0 - settings.closeness.below)).max(1.0).strict_ln();
    // While no layer fits, the search continues for longer and with growing increments. This happens in pictures whose
    // bytes hardly decrease with a larger step.
    let mut i = 0;
    while i < settings.max_runs || best.is_none() && i < detail::EXTRA_RUNS_FACTOR * settings.max_runs {
        i += 1;
        let rounded = step.round().clamp(1.0, 65_535.0);
        let coded = run(rounded as u16)?;
        let bytes = coded.bytes + settings.more_parameter_bytes(&coded.layer.head);
        let at = [rounded.strict_ln(), (bytes as f64).max(1.0).strict_ln()];
        let short = settings.max_bytes as f64 - bytes as f64;
        if short >= 0.0 {
            under = Some(at);
            if best.as_ref().is_none_or(|best| best.bytes <= coded.bytes) {
                best = Some(coded);
            }
            if short <= settings.max_bytes as f64 * settings.closeness.max_shortfall || rounded <= 1.0 {
                break;
            }
        } else {
            over = Some(at);
            if rounded >= 65_535.0 {
                break;
            }
        }
        if let Some(last) = last.filter(|last| (at[0] - last[0]).abs() > detail::MIN_STEP_DISTANCE) {
            fall = ((last[1] - at[1]) / (at[0] - last[0])).clamp(0.5, 2.0);
        }
        last = Some(at);
        let next = match (over, under) {
            (Some(a), Some(b)) if (b[0] - a[0]).abs() < 2e-3 => break,
            (Some(a), Some(b)) => {
                let share = ((goal - a[1]) / (b[1] - a[1])).clamp(0.05, 0.95);
                // Late runs bisect the interval, in case the curve is too irregular for interpolation.
                if i > 4 { 0.5 * (a[0] + b[0]) } else { a[0] + share * (b[0] - a[0]) }
            }
            (Some(a), None) => a[0] + ((a[1] - goal) / fall).max(0.003) * f64::from(1 << (i / 3).min(8)),
            (None, Some(b)) => b[0] - ((goal - b[1]) / fall).clamp(0.001, 3.0),
            (None, None) => break,
        };
        // Steps are integers, and no step is tried twice.
        let least = over.map_or(1.0, |[step, _]| step.strict_exp().round() + 1.0);
        let most = under.map_or(65_535.0, |[step, _]| step.strict_exp().round() - 1.0);
        if least > most {
            break;
        }
        step = next.strict_exp().round().clamp(least, most);
    }
    Ok(best)
}

/// Codes the layer of `tiles` with the step of the setting, in the blocks of `near`.
pub(super) fn once(tiles: &[TileResidual], settings: &SearchSettings, near: &Coded) -> Coded {
    let step = settings.coding.head.step;
    let activity = activities(tiles, settings);
    let classes = Masking::new(&activity, settings, step.into()).classes(&activity);
    code(tiles, &classes, settings, step, (Some(&near.sizes), &[]))
}

/// Size of the block that each cell of a tile lies in, by kind.
type BlockSizes = [Vec<u8>; KINDS];

/// Codes the layer with one step, in blocks of the given `sizes` or, without them, in blocks that it chooses. If `kept`
/// is not empty, it stores the coefficients in these blocks.
pub(super) fn code(
    tiles: &[TileResidual],
    classes: &[Vec<u8>],
    settings: &SearchSettings,
    step: u16,
    (sizes, kept): (Option<&[BlockSizes]>, &[CachedCoefficients]),
) -> Coded {
    let coding = settings.setting_at(step);
    let chosen: Vec<Chosen> = parallel::map(tiles.len(), |i| match sizes {
        Some(sizes) => choose(&tiles[i], &classes[i], &coding, &sizes[i], kept.get(i)),
        None => choose_with_blocks(&tiles[i], &classes[i], &coding, kept.get(i)),
    });
    let length = |stream: &[u8]| match stream.len() as u64 {
        0 => 1,
        bytes => bytes + 2 + u64::from((bytes.ilog2()) / 7 + 1),
    };
    let bytes = chosen.iter().map(|tile| length(&tile.stream)).sum();
    let (mut levels, mut sizes) = (Vec::new(), Vec::new());
    for tile in chosen {
        levels.push(tile.levels);
        sizes.push(tile.sizes);
    }
    Coded { layer: DetailLayer { head: coding.head, tiles: levels }, bytes, sizes }
}

/// Chooses the blocks of a tile and its levels in them. Chooses them again where flat cells ring.
fn choose_with_blocks(
    tile: &TileResidual,
    classes: &[u8],
    coding: &Setting,
    kept: Option<&CachedCoefficients>,
) -> Chosen {
    let mut ground = Ground::of(tile, coding.mixed.flat_range);
    let blocks = |ground: &Ground| match coding.blocks {
        BlockChoice::Rough => blocks(tile, (classes, ground), coding),
        BlockChoice::Priced => priced_blocks(tile, (classes, ground), coding),
    };
    let mut sizes = blocks(&ground);
    let rounds = coding.mixed.ringing.map_or(0, |ringing| ringing.rounds);
    for _ in 0..rounds {
        let coefficients = CachedCoefficients::new();
        let chosen = choose(tile, classes, coding, &sizes, Some(&coefficients));
        if !find_ringing(tile, &mut ground, &chosen, coding) {
            if let (Some(kept), Some(coefficients)) = (kept, coefficients.into_inner()) {
                kept.get_or_init(|| coefficients);
            }
            return chosen;
        }
        sizes = blocks(&ground);
    }
    choose(tile, classes, coding, &sizes, kept)
}

/// Adds the cells that ring in a coded tile to those of `ground`. Returns whether there are new ones: cells may ring in
/// the blocks of one round and not in those of another.
fn find_ringing(tile: &TileResidual, ground: &mut Ground, chosen: &Chosen, coding: &Setting) -> bool {
    let (Some(levels), Some(ringing)) = (&chosen.levels, coding.mixed.ringing) else { return false };
    let found = ringing_cells(tile, ground, (levels, &coding.head, coding.channels), ringing);
    ground.add_ringing(&found, ringing.factor)
}

/// The magnitudes of the coefficients of a residual in blocks of 8 and 16, which tell about how many bytes a layer takes.
pub(super) struct Magnitudes {
    /// Number of coefficients by the binary logarithm of their magnitude.
    counts: Vec<u32>,
}

impl Magnitudes {
    /// Number of bins per octave.
    const FINE: f32 = 4.0;
    const BINS: usize = 128;
    /// Number of rows of blocks for each row that is counted.
    const SAMPLED: usize = 4;
    /// Step in which the coefficients are measured.
    const UNIT: u16 = 1024;

    pub(super) fn of(tiles: &[TileResidual], settings: &SearchSettings) -> Magnitudes {
        let mut head = settings.coding.head;
        (head.step, head.classes) = (Self::UNIT, 1);
        settings.slopes.apply(&mut head);
        let bins = parallel::map(tiles.len(), |i| {
            let tile = &tiles[i];
            let mut bins = vec![0u32; Self::BINS];
            let cells = tile.size.map(|side| side.div_ceil(SUPER) * (SUPER / CELL));
            for plane in 0..PLANES {
                let size = if plane == 1 || plane == 2 { 2 } else { 1 };
                let values = coefficients::plane(tile, plane, Division::Even(size));
                if values.is_empty() {
                    continue;
                }
                let steps = PlaneSteps::new(&head, plane, 0);
                let n = CELL << size;
                for y in (0..cells[1] * CELL).filter(|y| (y / n).is_multiple_of(Self::SAMPLED)) {
                    for x in 0..cells[0] * CELL {
                        let step = steps.step(size.into(), x % n, y % n);
                        let value = values[y * TILE + x].abs() * 4.0 / step as f32;
                        // The exponent and the first two bits of the mantissa make about four times the binary logarithm.
                        let bin = ((value.to_bits() >> 21) as usize + Self::BINS / 2)
                            .saturating_sub(127 << 2)
                            .min(Self::BINS - 1);
                        bins[bin] += Self::SAMPLED as u32;
                    }
                }
            }
            bins
        });
        Magnitudes { counts: (0..Self::BINS).map(|bin| bins.iter().map(|b| b[bin]).sum()).collect() }
    }

    /// Returns about the step with which a layer takes `bytes` bytes.
    pub(super) fn step_for(&self, bytes: f64) -> f64 {
        let wanted = bytes * 8.0 / detail::GUESSED_LEVEL_BITS;
        let mut count = 0.0;
        let mut bin = Self::BINS - 1;
        while bin > 0 {
            count += f64::from(self.counts[bin]);
            if count > wanted {
                break;
            }
            bin -= 1;
        }
        let value = ((bin as f32 + 1.0 - Self::BINS as f32 / 2.0) / Self::FINE).strict_exp2();
        (f64::from(value / detail::GUESSED_LEVEL_MAGNITUDE) * f64::from(Self::UNIT)).clamp(8.0, 60_000.0)
    }

    /// Returns about the bytes of a layer with this step.
    #[cfg(feature = "quality-hook")]
    pub(super) fn bytes_at(&self, step: f64) -> f64 {
        let value = step * f64::from(detail::GUESSED_LEVEL_MAGNITUDE) / f64::from(Self::UNIT);
        let bin = f64::from(Self::FINE) * value.strict_log2() + Self::BINS as f64 / 2.0;
        let above: f64 = self.counts.iter().skip(bin.ceil().max(0.0) as usize).map(|&n| f64::from(n)).sum();
        // A part of the bin in which the value lies.
        let within = self.counts.get(bin.max(0.0) as usize).map_or(0.0, |&n| f64::from(n) * (bin.ceil() - bin));
        (above + within) * detail::GUESSED_LEVEL_BITS / 8.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bitstream::detail::DetailHead;
    use crate::encode::detail::flat_cells::Ringing;
    use crate::encode::detail::search_settings;
    use crate::gaussian::Channels;
    use crate::options::Tune;

    #[test]
    fn keeping_coefficients_does_not_change_the_bytes() {
        let settings = SearchSettings { max_bytes: 3000, ..search_settings(Tune::Iq, Channels::Rgb, false) };
        let plane = |seed: usize| (0..TILE * TILE).map(|i| ((i * seed) % 4001) as f32 - 2000.0).collect::<Vec<f32>>();
        let luma = plane(31).iter().map(|v| v / 20.0 + 100.0).collect();
        let tiles = [TileResidual { size: [128, 96], planes: [plane(97), plane(89), plane(83), Vec::new()], luma }];
        let activity = activities(&tiles, &settings);
        let classes = Masking::new(&activity, &settings, 900.0).classes(&activity);
        let kept = vec![CachedCoefficients::new(); tiles.len()];
        let first = code(&tiles, &classes, &settings, 900, (None, &kept));
        assert!(first.bytes > 100);
        // These runs use the blocks of the first run, because `kept` holds the coefficients for those blocks.
        let [with, without] =
            [&kept[..], &[]].map(|kept| code(&tiles, &classes, &settings, 1200, (Some(&first.sizes), kept)));
        assert_eq!((with.bytes, with.layer), (without.bytes, without.layer));
    }

    #[test]
    fn blocks_are_chosen_again_where_flat_cells_ring() {
        let mut settings = search_settings(Tune::Iq, Channels::Rgb, false);
        settings.coding.head.classes = 1;
        // With a factor this large, no block reaches from the waves into ground that rings.
        let usual = Ringing { factor: 100.0, ..settings.coding.mixed.ringing.unwrap() };
        // Ground that the Gaussians draw, beside waves that they do not. The border lies within large blocks.
        let pixels = || (0..TILE * TILE).map(|i| [i % TILE, i / TILE]);
        let waves = |[x, y]: [usize; 2]| 1300.0 * ((x as f32 * 0.9).sin() + (y as f32 * 0.5).cos());
        let mut count = |ringing| {
            settings.coding.mixed.ringing = ringing;
            let of_border = |border: usize| {
                let residual = pixels().map(|at| if at[0] < border { 0.0 } else { waves(at) }).collect();
                let luma = pixels().map(|at| if at[0] < border { 90.0 } else { 90.0 + waves(at) / 16.0 }).collect();
                let planes = [residual, Vec::new(), Vec::new(), Vec::new()];
                let tile = TileResidual { size: [64, 64], planes, luma };
                let ground = Ground::of(&tile, settings.coding.mixed.flat_range);
                let coded = code(std::slice::from_ref(&tile), &[Vec::new()], &settings, 2600, (None, &[]));
                let layer = (coded.layer.tiles[0].as_ref().unwrap(), &coded.layer.head, Channels::Rgb);
                ringing_cells(&tile, &ground, layer, usual).iter().filter(|&&rings| rings).count()
            };
            [20, 24, 28, 36, 40, 44].map(of_border)
        };
        let [once, again] = [None, Some(usual)].map(&mut count);
        assert!(again.iter().sum::<usize>() < once.iter().sum(), "{once:?} {again:?}");
    }

    #[test]
    fn search_tries_no_step_twice() {
        // A fine layer, whose bytes change by more than the accepted shortfall from each step to the next.
        for max_bytes in [99_000, 100_000, 101_000] {
            let settings = SearchSettings { max_bytes, ..search_settings(Tune::Psnr, Channels::Rgb, false) };
            let mut tried = Vec::new();
            let found = smallest_step(&settings, 30.0, |step| {
                tried.push(step);
                let layer = DetailLayer { head: DetailHead { step, ..settings.coding.head }, tiles: Vec::new() };
                Ok::<_, std::convert::Infallible>(Coded {
                    layer,
                    bytes: 5_000_000 / u64::from(step),
                    sizes: Vec::new(),
                })
            });
            let (Ok(found), tried) = (found.map(|coded| coded.unwrap().layer.head.step), tried);
            assert_eq!(u64::from(found), 5_000_000u64.div_ceil(max_bytes), "{tried:?}");
            assert!((1..tried.len()).all(|i| !tried[..i].contains(&tried[i])), "{tried:?}");
        }
    }

    #[test]
    fn search_finds_a_step_when_the_bytes_hardly_decrease() {
        // A picture of waves takes hardly fewer bytes when the step doubles, until it takes none at all.
        for last in [30.0, 600.0, 9000.0f64] {
            let settings = SearchSettings { max_bytes: 1000, ..search_settings(Tune::Psnr, Channels::Rgb, false) };
            let run = |step: u16| {
                let bytes = if f64::from(step) < last { 1300.0 - 200.0 * f64::from(step) / last } else { 700.0 };
                let layer = DetailLayer { head: settings.coding.head, tiles: Vec::new() };
                Ok::<_, std::convert::Infallible>(Coded { layer, bytes: bytes as u64, sizes: Vec::new() })
            };
            let Ok(found) = smallest_step(&settings, 20.0, run);
            assert!(found.is_some_and(|coded| coded.bytes == 700), "{last}");
        }
    }
}
