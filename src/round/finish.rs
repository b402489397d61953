//! From fitted floats to integers of an asked size: step sizes, descent over the integers, and the number of primitives.

use crate::bitstream::splats::{Layout, PackedGaussian, PackedSplats, Steps};
use crate::error::Result;
use crate::fit::model::field::{Field, Output, Scene};
use crate::fit::model::planes::Target;
use crate::fit::model::project::{Primitive, Projected};
use crate::fit::model::rows::RowSet;
use crate::fit::model::{peaks, relocate};
use crate::fit::plan::Plan;
use crate::fit::{Drawing, State, Watch, project_all};
use crate::quantize::Quantizer;
use crate::round::descend::{self, Activity, Objective};
use crate::round::freeze;

/// Squared error that a bit must save, in units of the mean squared error per bit: the slope of the rate–distortion
/// curve, where doubling the bytes wins two to three decibels.
const SLOPE: f64 = 0.7;

/// How many more primitives rounding starts with than fit, as a factor: the descent takes bits off them, and what is still
/// too much goes by its worth.
fn excess(primitives: usize) -> f64 {
    // Kodak, twelve pictures, against 1.008: .02 to .07 dB better at ratios from 50 to 1000. With 15 000 primitives at ratio
    // 20 it won nothing and lost .0003 of MS-SSIM.
    if primitives < 10_000 { 1.05 } else { 1.008 }
}

/// What the file must fit into.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Size {
    /// At most this many bytes, and as close to it as can be.
    Bytes(u64),
    /// As it comes.
    Free,
}

/// Step sizes for `primitives` in `layout`, whose picture has a PSNR of `psnr` decibels before rounding: the better the
/// fit, the finer the steps that its bytes are best spent on.
pub(crate) fn steps(primitives: &[Primitive], layout: Layout, psnr: f64) -> Steps {
    let mut sizes: Vec<f32> = primitives.iter().map(|p| p.log_scale[0].max(p.log_scale[1])).collect();
    sizes.sort_by(f32::total_cmp);
    let at = |share: f32| sizes.get((sizes.len() as f32 * share) as usize).copied().unwrap_or(0.0);
    match layout {
        Layout::Coded => {
            // Found by trying all neighbours on photographs at ratios from 20 to 1500; the optimum is flat.
            let (scale, position, luma) = match psnr {
                ..24.0 => (5, 5, 6),
                24.0..30.0 => (4, 6, 6),
                30.0..36.0 => (4, 7, 6),
                36.0..41.0 => (3, 7, 5),
                _ => (2, 8, 4),
            };
            let log2 = at(0.97) / std::f32::consts::LN_2 - f32::from(position) / 4.0;
            let coarsest = (log2.ceil() as i8).clamp(-2, 9);
            let range = (coarsest + 4).clamp(1, 15) as u8;
            Steps { scale, angle: 1, position, coarsest, range, luma, chroma: 1 }
        }
        Layout::Packed | Layout::Planes => {
            // One step for all positions: fine enough for the small Gaussians.
            let small = at(0.25) / std::f32::consts::LN_2;
            let coarsest = ((small - 2.5).round() as i8).clamp(-4, 6);
            Steps { scale: 2, angle: 1, position: 5, coarsest, range: 0, luma: 8, chroma: 2 }
        }
    }
}

/// Quantizes the primitives of `state` and refines the integers until the file has its size. `splats` brings everything
/// but the primitives and the steps. Returns the file, and the squared error of the floats.
pub(crate) fn finish(
    scene: &Scene,
    target: &Target,
    mut state: State,
    splats: &mut PackedSplats,
    size: Size,
    plan: &Plan,
    watch: Watch<'_>,
) -> Result<(Vec<u8>, f64)> {
    let float_error = float_error(scene, target, &state.primitives);
    splats.steps = steps(&state.primitives, splats.layout, psnr(scene, target, float_error));
    let quantizer = splats.quantizer();
    splats.background = quantizer.quantize_color(scene.background);
    let scene = Scene { background: quantizer.dequantize_color(splats.background), ..*scene };
    if plan.freezing > 0 && !plan.is_fit_over() {
        let mut half = |done: f32, now: Drawing<'_>| watch(0.5 * done, now);
        freeze::freeze(&scene, target, &mut state, &quantizer, plan, &mut half)?;
    }
    splats.gaussians = state.primitives.iter().map(|p| quantizer.quantize(&p.to_gaussian())).collect();
    let mut field = std::mem::take(&mut state.field);

    let mut activity = Activity::new(scene.width, scene.height);
    let mut bytes = smallest(splats, plan.levels)?;
    let mut best: Option<Best> = None;
    let rounds = plan.sweeps.max(2) + 6;
    let mut quiet = 0;
    for round in 0..rounds {
        watch(0.5 + 0.5 * round as f32 / rounds as f32, &|| {
            (scene, projected(&quantizer, &splats.gaussians, scene.height))
        })?;
        let error = squared_error(&scene, target, &quantizer, &splats.gaussians, &mut field);
        let over = plan.is_over();
        if let Size::Bytes(most) = size {
            Best::keep(&mut best, error, splats, &bytes, most);
            if over && best.as_ref().is_some_and(|b| b.fills) {
                break;
            }
            // The last sweeps change the size only a little: correct it while there are enough left to settle.
            let settled = bytes.len() as u64 <= most && most - bytes.len() as u64 <= (most / 400).max(4);
            if settled && (round >= plan.sweeps || quiet > 1) {
                break;
            }
            if (over || round + 3 >= plan.sweeps) && !settled {
                // Each sweep may make a file longer by a little: one that is still too long is brought below its size.
                let most = if round >= plan.sweeps { most - most / 1000 } else { most };
                resize(&scene, target, &quantizer, splats, bytes.len() as u64, most, &mut activity, &mut field);
            }
        } else if over || round >= plan.sweeps || quiet > 1 {
            break;
        }
        // When the time is over only the size is still brought right.
        if !over {
            let bits = 8.0 * bytes.len() as f64;
            let objective = Objective { lambda: (SLOPE * error / bits) as f32, position_bits: f32::NEG_INFINITY };
            let gaussians = &mut splats.gaussians;
            let swept = descend::sweep(&scene, target, &quantizer, gaussians, &objective, &mut activity, &mut field);
            quiet = if swept.gain < 2e-4 * error { quiet + 1 } else { 0 };
        }
        bytes = smallest(splats, plan.levels)?;
    }
    if let Size::Bytes(most) = size {
        let error = squared_error(&scene, target, &quantizer, &splats.gaussians, &mut field);
        Best::keep(&mut best, error, splats, &bytes, most);
        if let Some(best) = best {
            (splats.gaussians, splats.codebook, splats.levels) = (best.gaussians, best.codebook, best.levels);
            return Ok((best.bytes, float_error));
        }
        while bytes.len() as u64 > most && !splats.gaussians.is_empty() {
            resize(&scene, target, &quantizer, splats, bytes.len() as u64, most, &mut activity, &mut field);
            bytes = smallest(splats, plan.levels)?;
        }
    }
    Ok((bytes, float_error))
}

/// The best file so far that is not too large.
struct Best {
    /// Whether it comes within 2 % of its size, or 40 bytes: that goes before the error.
    fills: bool,
    error: f64,
    gaussians: Vec<PackedGaussian>,
    codebook: Option<Vec<[i16; 4]>>,
    levels: Vec<u32>,
    bytes: Vec<u8>,
}

impl Best {
    fn keep(best: &mut Option<Self>, error: f64, splats: &PackedSplats, bytes: &[u8], most: u64) {
        let Some(left) = most.checked_sub(bytes.len() as u64) else { return };
        let fills = left <= (most / 50).max(40);
        if best.as_ref().is_none_or(|b| (fills, b.error) > (b.fills, error)) {
            let (gaussians, codebook) = (splats.gaussians.clone(), splats.codebook.clone());
            let levels = splats.levels.clone();
            *best = Some(Best { fills, error, gaussians, codebook, levels, bytes: bytes.to_vec() });
        }
    }
}

/// Orders the primitives into `levels` levels, large ones first, each with three times as many as all before it.
fn divide(splats: &mut PackedSplats, levels: u8) {
    splats.gaussians.sort_by_key(|g| std::cmp::Reverse(u16::from(g.major) + u16::from(g.minor)));
    let count = splats.gaussians.len() as u32;
    let ends: Vec<u32> = (1..=u32::from(levels)).map(|k| count / 3u32.pow(u32::from(levels) - k)).collect();
    splats.levels = ends.iter().enumerate().map(|(k, end)| end - if k > 0 { ends[k - 1] } else { 0 }).collect();
    splats.levels.retain(|&n| n > 0);
}

/// The file, with its colours in a codebook where that is smaller.
pub(crate) fn smallest(splats: &mut PackedSplats, levels: u8) -> Result<Vec<u8>> {
    if levels > 1 {
        divide(splats, levels);
    }
    splats.codebook = None;
    let direct = crate::bitstream::to_bytes(splats)?;
    let mut colors: Vec<[i16; 4]> = splats.gaussians.iter().map(|g| g.color).collect();
    colors.sort_unstable();
    colors.dedup();
    // Where most colours occur once, a codebook cannot pay; one of no colours is none.
    if colors.is_empty() || colors.len() * 3 > splats.gaussians.len() {
        return Ok(direct);
    }
    splats.codebook = Some(colors);
    let indexed = crate::bitstream::to_bytes(splats)?;
    if indexed.len() < direct.len() {
        return Ok(indexed);
    }
    splats.codebook = None;
    Ok(direct)
}

pub(crate) fn projected(quantizer: &Quantizer, gaussians: &[PackedGaussian], height: u32) -> Vec<Projected> {
    gaussians.iter().map(|g| Projected::from_gaussian(&quantizer.dequantize(g), height)).collect()
}

/// Squared error of the picture of `gaussians`, clamped, weighted as the target has it.
fn squared_error(
    scene: &Scene,
    target: &Target,
    quantizer: &Quantizer,
    gaussians: &[PackedGaussian],
    field: &mut Field,
) -> f64 {
    field.draw(scene, target, &projected(quantizer, gaussians, scene.height), RowSet::ALL, Output::Gradient)
}

/// Takes away the cheapest primitives, or adds some where the error is largest, by the bytes over or under.
#[allow(clippy::too_many_arguments)]
fn resize(
    scene: &Scene,
    target: &Target,
    quantizer: &Quantizer,
    splats: &mut PackedSplats,
    bytes: u64,
    most: u64,
    activity: &mut Activity,
    field: &mut Field,
) {
    let each = (bytes.saturating_sub(20) as f64 / splats.gaussians.len().max(1) as f64).max(1.0);
    let current = projected(quantizer, &splats.gaussians, scene.height);
    field.draw(scene, target, &current, RowSet::ALL, Output::Picture);
    if bytes > most {
        if splats.gaussians.is_empty() {
            return;
        }
        let count = (((bytes - most) as f64 / each).ceil() as usize).clamp(1, splats.gaussians.len());
        let costs = relocate::removal_costs(scene, target, field, RowSet::ALL, &current);
        let mut removed = vec![false; costs.len()];
        for i in relocate::cheapest_first(&costs).into_iter().take(count) {
            removed[i] = true;
            activity.mark(&quantizer.dequantize(&splats.gaussians[i]));
        }
        let mut i = 0;
        splats.gaussians.retain(|_| {
            i += 1;
            !removed[i - 1]
        });
    } else {
        let count = ((most - bytes) as f64 / each * 0.97) as usize;
        for peak in peaks::peaks(scene, target, field, RowSet::ALL, count, splats.gaussians.len()) {
            let p = peaks::at_peak(&peak, scene, target);
            let added = quantizer.quantize(&p.to_gaussian());
            activity.mark(&quantizer.dequantize(&added));
            splats.gaussians.push(added);
        }
    }
}

/// How many primitives of this kind fit into `most` bytes: those that there are, quantized and written, set the price.
pub(crate) fn count_for(
    scene: &Scene,
    target: &Target,
    primitives: &[Primitive],
    splats: &mut PackedSplats,
    most: u64,
) -> Result<usize> {
    splats.steps = steps(primitives, splats.layout, psnr(scene, target, float_error(scene, target, primitives)));
    let quantizer = splats.quantizer();
    splats.gaussians = primitives.iter().map(|p| quantizer.quantize(&p.to_gaussian())).collect();
    let all = crate::bitstream::to_bytes(splats)?.len() as f64;
    splats.gaussians.clear();
    let fixed = crate::bitstream::to_bytes(splats)?.len() as f64;
    let each = ((all - fixed) / primitives.len().max(1) as f64).max(0.5);
    Ok(((most as f64 * excess(primitives.len()) - fixed) / each).max(0.0) as usize)
}

/// The picture of float primitives, for reports: plain squared error over all rows.
pub(crate) fn float_error(scene: &Scene, target: &Target, primitives: &[Primitive]) -> f64 {
    let mut field = Field::default();
    field.draw(scene, target, &project_all(primitives, scene.height), RowSet::ALL, Output::Picture)
}

/// A squared error as PSNR, decibels.
fn psnr(scene: &Scene, target: &Target, error: f64) -> f64 {
    let samples = f64::from(scene.width) * f64::from(scene.height) * target.channels.count() as f64;
    -10.0 * (error / samples).log10()
}

/// The squared error of integer primitives.
pub(crate) fn packed_error(scene: &Scene, target: &Target, quantizer: &Quantizer, gaussians: &[PackedGaussian]) -> f64 {
    let projected = projected(quantizer, gaussians, scene.height);
    Field::default().draw(scene, target, &projected, RowSet::ALL, Output::Picture)
}
