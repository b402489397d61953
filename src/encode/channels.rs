//! What a picture does not need: channels that say nothing, the fit where one colour does, iterations and primitives
//! beyond what rounding to code values shows.
//!
//! The file keeps the caller's channels: what was left out of the fit is put back into the integers, where the coded
//! layout stores a constant in next to nothing.

use crate::bitstream::splats::{PackedGaussian, PackedSplats, Steps};
use crate::fit::model::field::{Field, Output, Scene};
use crate::fit::model::planes::Target as Planes;
use crate::fit::model::project::Projected;
use crate::fit::model::relocate;
use crate::fit::model::rows::RowSet;
use crate::gaussian::{CUTOFF_WEIGHT, Channels, EPSILON};
use crate::options::Target;
use crate::pixels::{Depth, Pixels, Samples};
use crate::round::descend::{self, Activity, Objective};
use crate::round::finish;

/// A picture with only the channels that say something.
#[derive(Debug)]
pub(crate) struct Narrow {
    pub pixels: Pixels,
    /// What was left out, in words.
    pub what: &'static str,
}

/// `pixels` without alpha where all is opaque and without colour where all is grey; `None` where all channels count.
pub(crate) fn narrow(pixels: &Pixels) -> Option<Narrow> {
    let channels = pixels.channels();
    let (grey, opaque) = match pixels.samples() {
        Samples::U8(v) => (is_grey(v, channels), is_opaque(v, channels, u8::MAX)),
        Samples::U16(v) => (is_grey(v, channels), is_opaque(v, channels, u16::MAX)),
    };
    let color = channels.count() >= 3 && !grey;
    let alpha = channels.alpha().is_some() && !opaque;
    let (to, what) = match (color, alpha) {
        (true, false) if channels == Channels::Rgba => (Channels::Rgb, "alpha: all is opaque"),
        (false, true) if channels == Channels::Rgba => (Channels::GreyAlpha, "colour: all is grey"),
        (false, false) if channels == Channels::Rgba => (Channels::Grey, "colour and alpha: all is grey and opaque"),
        (false, false) if channels == Channels::Rgb => (Channels::Grey, "colour: all is grey"),
        (false, false) if channels == Channels::GreyAlpha => (Channels::Grey, "alpha: all is opaque"),
        _ => return None,
    };
    let samples = match pixels.samples() {
        Samples::U8(v) => Samples::U8(kept(v, channels, to)),
        Samples::U16(v) => Samples::U16(kept(v, channels, to)),
    };
    let pixels = Pixels::new(pixels.width(), pixels.height(), to, samples).expect("as many samples as the size says");
    Some(Narrow { pixels, what })
}

fn is_grey<T: PartialEq>(samples: &[T], channels: Channels) -> bool {
    channels.count() < 3 || samples.chunks_exact(channels.count()).all(|p| p[0] == p[1] && p[1] == p[2])
}

fn is_opaque<T: PartialEq>(samples: &[T], channels: Channels, white: T) -> bool {
    channels.alpha().is_none_or(|a| samples.chunks_exact(channels.count()).all(|p| p[a] == white))
}

fn kept<T: Copy>(samples: &[T], from: Channels, to: Channels) -> Vec<T> {
    let pixels = samples.chunks_exact(from.count());
    pixels
        .flat_map(|p| (0..to.count()).map(move |k| if to.alpha() == Some(k) { p[from.count() - 1] } else { p[k] }))
        .collect()
}

/// The integers of a narrow picture as those of `channels`, which hold the same colours: grey has no chroma, and
/// opaque is the least integer that is no less than 1.
pub(crate) fn widen(splats: &PackedSplats, channels: Channels) -> PackedSplats {
    let from = splats.channels;
    let mut wide = PackedSplats { channels, ..splats.clone() };
    let opaque = (1.0 / wide.quantizer().color_steps()[3]).ceil() as i16;
    let put = |c: [i16; 4], opaque: i16| {
        let mut out = [0; 4];
        let colors = from.count() - usize::from(from.alpha().is_some());
        out[..colors].copy_from_slice(&c[..colors]);
        if let Some(a) = channels.alpha() {
            out[a] = from.alpha().map_or(opaque, |a| c[a]);
        }
        out
    };
    wide.background = put(splats.background, opaque);
    // Under the sum blend the background alone is opaque already.
    let each = match splats.blend {
        crate::gaussian::Blend::Normalized => opaque,
        crate::gaussian::Blend::Sum => 0,
    };
    for g in &mut wide.gaussians {
        g.color = put(g.color, each);
    }
    // The order of the colours stays: only constants are put in.
    for c in wide.codebook.iter_mut().flatten() {
        *c = put(*c, each);
    }
    wide
}

/// The samples of a narrow picture as those of `channels`.
pub(crate) fn widen_pixels(pixels: Pixels, channels: Channels) -> Pixels {
    let from = pixels.channels();
    if from == channels {
        return pixels;
    }
    let samples = match pixels.samples() {
        Samples::U8(v) => Samples::U8(widened(v, from, channels, u8::MAX)),
        Samples::U16(v) => Samples::U16(widened(v, from, channels, u16::MAX)),
    };
    Pixels::new(pixels.width(), pixels.height(), channels, samples).expect("as many samples as the size says")
}

fn widened<T: Copy>(samples: &[T], from: Channels, to: Channels, white: T) -> Vec<T> {
    let colors = from.count() - usize::from(from.alpha().is_some());
    let value = |p: &[T], k: usize| match (to.alpha() == Some(k), from.alpha()) {
        (true, Some(a)) => p[a],
        (true, None) => white,
        _ => p[k.min(colors - 1)],
    };
    samples.chunks_exact(from.count()).flat_map(|p| (0..to.count()).map(move |k| value(p, k))).collect()
}

/// Mean squared error of a sample that rounding to code values makes by itself: once in the source, once when decoding.
pub(crate) fn rounding(depth: Depth) -> f64 {
    2.0 / (12.0 * f64::from(depth.max()).powi(2))
}

/// Mean squared error of a sample at which more iterations bring nothing: rounding makes as much, or the target is
/// passed by more than what the integers lose.
pub(crate) fn enough(target: Target, depth: Depth) -> f64 {
    // Decibels that quantization has been seen to lose at most, before the descent wins some back.
    const LOSS: f64 = 3.0;
    match target {
        Target::Psnr(p) => rounding(depth).max(10f64.powf(-0.1 * (p + LOSS))),
        _ => rounding(depth),
    }
}

/// Whether the errors of all pixels weigh the same within a hundredth, so that weighing them would change nothing.
pub(crate) fn is_even(target: &Planes) -> bool {
    let width = target.width as usize;
    let rows = target.amplitude.chunks_exact(target.stride).map(|row| &row[..width]);
    rows.flatten().all(|a| (a * a - 1.0).abs() < 0.01)
}

/// Each of so few primitives is tried by itself: what the others are expected to cost is not exact.
const FEW: usize = 64;

/// `splats` with as few primitives as keep the squared error within `enough`; `None` where all are needed.
pub(crate) fn pruned(scene: &Scene, target: &Planes, splats: &PackedSplats, enough: f64) -> Option<PackedSplats> {
    // Each round takes out what is not needed; a sweep over the rest makes room for the next one.
    const ROUNDS: usize = 6;
    if !splats.levels.is_empty() {
        return None;
    }
    let quantizer = splats.quantizer();
    let project = |gaussians: &[PackedGaussian]| finish::projected(&quantizer, gaussians, scene.height);
    let mut field = Field::default();
    let mut best = splats.gaussians.clone();
    for _ in 0..ROUNDS {
        let mut trial = best.clone();
        if trial.len() < splats.gaussians.len() {
            let objective = Objective { lambda: 0.0, position_bits: f32::NEG_INFINITY };
            let mut activity = Activity::new(scene.width, scene.height);
            descend::sweep(scene, target, &quantizer, &mut trial, &objective, &mut activity, &mut field);
        }
        let projected = project(&trial);
        if field.draw(scene, target, &projected, RowSet::ALL, Output::Picture) > enough {
            break;
        }
        let costs = relocate::removal_costs(scene, target, &field, RowSet::ALL, &projected);
        let order = relocate::cheapest_first(&costs);
        // The most that can go: between `sure`, which can, and `over`, which cannot.
        let (mut sure, mut over) = (0, trial.len() + 1);
        let without = |count: usize| -> Vec<PackedGaussian> {
            let mut removed = vec![false; trial.len()];
            order[..count].iter().for_each(|&i| removed[i] = true);
            trial.iter().zip(&removed).filter(|(_, r)| !**r).map(|(g, _)| *g).collect()
        };
        while over - sure > 1 {
            let middle = (sure + over) / 2;
            let rest = project(&without(middle));
            match field.draw(scene, target, &rest, RowSet::ALL, Output::Picture) <= enough {
                true => sure = middle,
                false => over = middle,
            }
        }
        if sure == 0 {
            break;
        }
        best = without(sure);
        // What is left to win would not be worth another round.
        if sure * 50 < best.len() {
            break;
        }
    }
    if best.len() <= FEW {
        let mut error =
            |gaussians: &[PackedGaussian]| field.draw(scene, target, &project(gaussians), RowSet::ALL, Output::Picture);
        let mut i = if error(&best) <= enough { 0 } else { best.len() };
        while i < best.len() {
            let mut without = best.clone();
            without.remove(i);
            if error(&without) <= enough { best = without } else { i += 1 }
        }
    }
    if best.len() == splats.gaussians.len() {
        return None;
    }
    let mut pruned = PackedSplats { gaussians: best, ..splats.clone() };
    finish::smallest(&mut pruned, 1).ok()?;
    Some(pruned)
}

/// Seconds of one drawing for gradients, for comparing with another: of large pictures only some rows.
pub(crate) fn drawing_seconds(scene: &Scene, target: &Planes, projected: &[Projected]) -> f64 {
    let rows = RowSet { step: (scene.height / 256).clamp(1, 8), phase: 0 };
    let clock = std::time::Instant::now();
    Field::default().draw(scene, target, projected, rows, Output::Gradient);
    clock.elapsed().as_secs_f64()
}

/// Whether all pixels of `pixels` are the same.
pub(crate) fn is_constant(pixels: &Pixels) -> bool {
    fn same<T: PartialEq>(samples: &[T], count: usize) -> bool {
        samples.chunks_exact(count).all(|p| p == &samples[..count])
    }
    match pixels.samples() {
        Samples::U8(v) => same(v, pixels.channels().count()),
        Samples::U16(v) => same(v, pixels.channels().count()),
    }
}

/// One primitive, far wider than the picture, that makes every pixel `color` far more exactly than a step: the
/// background, which has 1/128 of its weight, corrects it. For the normalized blend and the coded layout; `splats`
/// brings everything but steps, background and primitives.
pub(crate) fn constant(splats: &mut PackedSplats, color: [f32; 4]) {
    splats.steps = Steps { scale: 15, angle: 0, position: 0, coarsest: 9, range: 0, luma: 0, chroma: 0 };
    let quantizer = splats.quantizer();
    let (axes, steps) = (quantizer.transform_color(color), quantizer.color_steps());
    let weight = 1.0 - CUTOFF_WEIGHT;
    let mut major = 0;
    // Even from a position a coarsest step away, its weight falls by less than 1e−3 over the picture.
    let reach = splats.width.max(splats.height).max(512) as f32;
    while quantizer.holds_scale(i16::from(major) + 1) && quantizer.scale(major) < 64.0 * reach {
        major += 1;
    }
    let mut g = PackedGaussian { major, minor: major, ..PackedGaussian::default() };
    for k in 0..splats.channels.count() {
        let nearest = (axes[k] / steps[k] + 0.5).floor();
        let rest = axes[k] - nearest * steps[k];
        g.color[k] = nearest as i16;
        splats.background[k] = (nearest + (rest * (weight + EPSILON) / (EPSILON * steps[k]) + 0.5).floor()) as i16;
    }
    quantizer.place(&mut g, [0.5 * splats.width as f32, 0.5 * splats.height as f32]);
    splats.gaussians = vec![g];
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bitstream;
    use crate::limits::Limits;
    use crate::options::EncodeOptions;
    use crate::raster::{Renderer, View};

    fn decoded(bytes: &[u8]) -> Pixels {
        let splats = bitstream::read(bytes, &Limits::default()).unwrap();
        let picture = splats.to_picture();
        Renderer::new(&picture, &View::full(&picture), &Limits::default()).unwrap().render(splats.depth).unwrap()
    }

    fn wave(channels: Channels, value: impl Fn(u32, u32, usize) -> u8) -> Pixels {
        let n = channels.count();
        let samples = (0..40 * 30 * n).map(|i| value((i / n) as u32 % 40, (i / n) as u32 / 40, i % n)).collect();
        Pixels::new(40, 30, channels, Samples::U8(samples)).unwrap()
    }

    #[test]
    fn opaque_and_grey_pictures_come_back_opaque_grey_and_in_their_own_channels() {
        for blend in [crate::Blend::Normalized, crate::Blend::Sum] {
            let pixels = wave(Channels::Rgba, |x, y, k| if k == 3 { 255 } else { (3 * x + 2 * y) as u8 });
            let options =
                EncodeOptions { effort: 1, blend: Some(blend), target: Target::Bytes(200), ..EncodeOptions::default() };
            let encoded = crate::encode(&pixels, &options).unwrap();
            assert!(encoded.bytes.len() <= 200, "{}", encoded.bytes.len());
            assert_eq!(
                encoded.report.left_out.first().map(|l| &*l.what),
                Some("colour and alpha: all is grey and opaque")
            );
            let back = decoded(&encoded.bytes);
            assert_eq!(back.channels(), Channels::Rgba);
            let Samples::U8(v) = back.samples() else { panic!("8 bits") };
            assert!(v.chunks_exact(4).all(|p| p[0] == p[1] && p[1] == p[2] && p[3] == 255));
            let found = crate::metrics::psnr(&pixels, &back).unwrap();
            assert!((found - encoded.report.psnr).abs() < 1.0, "{found} {}", encoded.report.psnr);
        }
    }

    #[test]
    fn every_constant_grey_comes_back_exactly() {
        for v in 0..=255 {
            let pixels = wave(Channels::Rgb, |_, _, k| if k == 0 { v } else { 255 - v });
            let encoded = crate::encode(&pixels, &EncodeOptions::default()).unwrap();
            assert_eq!(decoded(&encoded.bytes), pixels, "{v}");
            assert_eq!(encoded.report.primitives, 1);
        }
    }

    #[test]
    fn a_soft_picture_stops_early_loses_needless_primitives_and_stays_within_rounding() {
        let pixels = wave(Channels::Rgb, |x, y, k| 60 + (2 * x + (k as u32 + 1) * y) as u8);
        let mut options = EncodeOptions { target: Target::Primitives(300), ..EncodeOptions::default() };
        let encoded = crate::encode(&pixels, &options).unwrap();
        options.needs = crate::Needs::Everything;
        let everything = crate::encode(&pixels, &options).unwrap();
        let report = &encoded.report;
        assert!(report.primitives < 300, "{}", report.primitives);
        assert!(encoded.bytes.len() < everything.bytes.len());
        let [iterations, primitives] = ["iterations", "primitives"].map(|what| {
            report.left_out.iter().find(|l| l.what.starts_with(what)).unwrap_or_else(|| panic!("{what}: {report:?}"))
        });
        assert!(iterations.seconds > 0.0 && primitives.bytes > 0);
        // 55.9 dB is the error of rounding twice.
        assert!(report.psnr > 55.9, "{}", report.psnr);
        let found = crate::metrics::psnr(&pixels, &decoded(&encoded.bytes)).unwrap();
        assert!(found > 53.5, "{found}");
    }

    #[test]
    fn a_target_in_decibels_is_met_with_no_more_primitives_than_it_takes() {
        let pixels = wave(Channels::Rgb, |x, y, k| (x * x / 7 + (k as u32 + 1) * y * 3) as u8);
        let options = EncodeOptions { effort: 3, target: Target::Psnr(30.0), ..EncodeOptions::default() };
        let encoded = crate::encode(&pixels, &options).unwrap();
        assert!((30.0..30.4).contains(&encoded.report.psnr), "{}", encoded.report.psnr);
        let splats = bitstream::read(&encoded.bytes[..], &Limits::default()).unwrap();
        for i in 0..splats.gaussians.len() {
            let mut fewer = splats.clone();
            fewer.gaussians.remove(i);
            let found = crate::metrics::psnr(&pixels, &decoded(&bitstream::to_bytes(&fewer).unwrap())).unwrap();
            assert!(found < 30.0, "{found} without {i} of {}", splats.gaussians.len());
        }
    }

    fn left_out(pixels: &Pixels, options: &EncodeOptions) -> Vec<String> {
        crate::encode(pixels, options).unwrap().report.left_out.into_iter().map(|l| l.what).collect()
    }

    #[test]
    fn ssim_terms_are_left_out_where_they_are_not_asked_for_and_where_they_would_weigh_nothing() {
        let even = wave(Channels::Grey, |x, y, _| (100 + (x + y) / 4) as u8);
        let rough = wave(Channels::Grey, |x, y, _| (100 + x * y % 7 * x) as u8);
        let psnr = EncodeOptions { effort: 1, target: Target::Bytes(150), ..EncodeOptions::default() };
        let ssim = EncodeOptions { tune: crate::Tune::Ssim, ..psnr.clone() };
        let everything = EncodeOptions { needs: crate::Needs::Everything, ..ssim.clone() };
        for (pixels, options, why) in [
            (&even, &psnr, Some("SSIM terms: the fit is tuned for PSNR")),
            (&even, &ssim, Some("SSIM terms: the picture is so even that all pixels weigh the same")),
            (&even, &everything, None),
            (&rough, &ssim, None),
        ] {
            let found = left_out(pixels, options);
            assert_eq!(found.iter().find(|w| w.starts_with("SSIM")).map(String::as_str), why, "{found:?}");
        }
        let bytes = |options| crate::encode(&even, options).unwrap().bytes;
        assert_eq!(bytes(&psnr), bytes(&ssim));
    }

    #[test]
    fn a_gpu_that_was_free_to_be_taken_and_was_not_is_left_out_and_the_reason_is_told() {
        let gpu = |pixels: &Pixels, backend| {
            let options =
                EncodeOptions { effort: 1, target: Target::Primitives(3), backend, ..EncodeOptions::default() };
            left_out(pixels, &options).into_iter().find(|w| w.starts_with("the GPU"))
        };
        let small = wave(Channels::Grey, |x, y, _| (x + y) as u8);
        let why = gpu(&small, crate::Backend::Auto);
        assert_eq!(why.as_deref(), Some("the GPU: the picture has fewer than 262144 pixels"));
        assert_eq!(gpu(&small, crate::Backend::Cpu), None);
        // Without a fit nothing is fitted on anything.
        assert_eq!(gpu(&wave(Channels::Grey, |_, _, _| 9), crate::Backend::Auto), None);
        #[cfg(not(feature = "gpu"))]
        {
            let samples = (0..512 * 512u32).map(|i| (i / 4096 + i % 512 / 16) as u8).collect();
            let large = Pixels::new(512, 512, Channels::Grey, Samples::U8(samples)).unwrap();
            let why = gpu(&large, crate::Backend::Auto);
            assert_eq!(why.as_deref(), Some("the GPU: this build has no GPU support"));
        }
    }
}
