//! Parts of an encode that are omitted: the file keeps its size and the picture its channels, and the report lists
//! them.

use ssplat::report::SkipReason;
use ssplat::unstable::EncodeOptions;
use ssplat::unstable::Needs;
use ssplat::unstable::bitstream;
use ssplat::{Backend, Blend, Channels, Detail, Limits, Pixels, Samples, Target, Tune};
use ssplat::{Renderer, View};

fn options(effort: u8, target: Target) -> EncodeOptions {
    let mut options = EncodeOptions::default();
    (options.effort, options.target) = (effort, target);
    // Uniform weights would be left out as well.
    options.tune = Some(Tune::Psnr);
    // Otherwise, some of these pictures would be stored without loss.
    options.detail = Detail::Off;
    options
}

fn decoded(bytes: &[u8]) -> Pixels {
    let splats = bitstream::read(bytes, &Limits::default()).unwrap();
    let picture = splats.to_gaussians();
    Renderer::new(&picture, &View::new(picture.width, picture.height), &Limits::default())
        .unwrap()
        .render(splats.depth)
        .unwrap()
}

fn wave(channels: Channels, value: impl Fn(u32, u32, usize) -> u8) -> Pixels {
    let n = channels.count();
    let samples = (0..40 * 30 * n).map(|i| value((i / n) as u32 % 40, (i / n) as u32 / 40, i % n)).collect();
    Pixels::new(40, 30, channels, Samples::U8(samples)).unwrap()
}

#[test]
fn opaque_and_grey_pictures_keep_their_channels() {
    for blend in [Blend::Normalized, Blend::Sum] {
        let pixels = wave(Channels::Rgba, |x, y, k| if k == 3 { 255 } else { (3 * x + 2 * y) as u8 });
        let mut options = options(1, Target::Bytes(200));
        options.blend = Some(blend);
        let encoded = ssplat::unstable::encode(&pixels, &options).unwrap();
        assert!(encoded.bytes.len() <= 200, "{}", encoded.bytes.len());
        assert_eq!(encoded.report.skipped.first().map(|l| &l.what), Some(&SkipReason::ColorAndAlpha));
        let back = decoded(&encoded.bytes);
        assert_eq!(back.channels(), Channels::Rgba);
        let Samples::U8(v) = back.samples() else { panic!("8 bits") };
        assert!(v.chunks_exact(4).all(|p| p[0] == p[1] && p[1] == p[2] && p[3] == 255));
        let found = ssplat::unstable::metrics::psnr(&pixels, &back).unwrap();
        // The report is computed before rounding to code values. Where rounding is like noise, it adds 1/12 of a
        // squared code value; where errors are below half a code value, it removes some. The tolerance of half a
        // decibel allows for the small number of pixels, 1200.
        let drawn = encoded.report.psnr;
        let rounding = 1.0 / (12.0 * 255.0 * 255.0);
        let least = -10.0 * (10f64.powf(-0.1 * drawn) + rounding).log10();
        assert!((least - 0.5..drawn + 0.5).contains(&found), "{found}, {drawn} before it is rounded");
    }
}

#[test]
fn every_constant_grey_is_decoded_exactly() {
    for v in 0..=255 {
        let pixels = wave(Channels::Rgb, |_, _, k| if k == 0 { v } else { 255 - v });
        let encoded = ssplat::unstable::encode(&pixels, &EncodeOptions::default()).unwrap();
        assert_eq!(decoded(&encoded.bytes), pixels, "{v}");
        assert_eq!(encoded.report.gaussians, 1);
    }
}

#[test]
fn a_smooth_picture_stops_early_and_stays_within_rounding() {
    let pixels = wave(Channels::Rgb, |x, y, k| 60 + (2 * x + (k as u32 + 1) * y) as u8);
    let mut options = options(5, Target::Gaussians(300));
    let encoded = ssplat::unstable::encode(&pixels, &options).unwrap();
    options.needs = Needs::Everything;
    let everything = ssplat::unstable::encode(&pixels, &options).unwrap();
    let report = &encoded.report;
    assert!(report.gaussians < 300, "{}", report.gaussians);
    assert!(encoded.bytes.len() < everything.bytes.len());
    let [iterations, primitives] = [SkipReason::Iterations, SkipReason::Gaussians]
        .map(|what| report.skipped.iter().find(|l| l.what == what).unwrap_or_else(|| panic!("{what}: {report:?}")));
    assert!(iterations.seconds > 0.0 && primitives.bytes > 0);
    // 55.9 dB is the error of rounding twice.
    assert!(report.psnr > 55.9, "{}", report.psnr);
    let found = ssplat::unstable::metrics::psnr(&pixels, &decoded(&encoded.bytes)).unwrap();
    assert!(found > 53.5, "{found}");
}

#[test]
fn a_psnr_target_is_met_with_no_more_primitives_than_necessary() {
    let pixels = wave(Channels::Rgb, |x, y, k| (x * x / 7 + (k as u32 + 1) * y * 3) as u8);
    let encoded = ssplat::unstable::encode(&pixels, &options(3, Target::Psnr(30.0))).unwrap();
    // The search returns the smallest file of six tries. Here, twice as many as its 32 primitives gain 11 dB, or half
    // a decibel for each, and fits with the same number differ by more.
    assert!((30.0..30.6).contains(&encoded.report.psnr), "{}", encoded.report.psnr);
    let splats = bitstream::read(&encoded.bytes[..], &Limits::default()).unwrap();
    for i in 0..splats.gaussians.len() {
        let mut fewer = splats.clone();
        fewer.gaussians.remove(i);
        let found = ssplat::unstable::metrics::psnr(&pixels, &decoded(&bitstream::to_bytes(&fewer).unwrap())).unwrap();
        assert!(found < 30.0, "{found} without {i} of {}", splats.gaussians.len());
    }
}

fn left_out(pixels: &Pixels, options: &EncodeOptions) -> Vec<SkipReason> {
    ssplat::unstable::encode(pixels, options).unwrap().report.skipped.into_iter().map(|l| l.what).collect()
}

#[test]
fn weights_are_omitted_where_they_have_no_effect() {
    let even = wave(Channels::Grey, |x, y, _| (100 + (x + y) / 4) as u8);
    let rough = wave(Channels::Grey, |x, y, _| (100 + x * y % 7 * x) as u8);
    let psnr = options(1, Target::Bytes(150));
    let mut iq = psnr.clone();
    iq.tune = Some(Tune::Iq);
    let mut everything = iq.clone();
    everything.needs = Needs::Everything;
    // With a PSNR target nothing is left out, and the report says nothing about it.
    for (pixels, options, is_left_out) in
        [(&even, &psnr, false), (&even, &iq, true), (&even, &everything, false), (&rough, &iq, false)]
    {
        let found = left_out(pixels, options);
        assert_eq!(found.contains(&SkipReason::StructureWeights), is_left_out, "{found:?}");
    }
    let bytes = |options| ssplat::unstable::encode(&even, options).unwrap().bytes;
    assert_eq!(bytes(&psnr), bytes(&iq));
}

#[test]
fn an_unused_gpu_is_reported_with_the_reason() {
    let gpu = |pixels: &Pixels, backend| {
        let mut options = options(1, Target::Gaussians(3));
        options.backend = backend;
        left_out(pixels, &options).into_iter().find(|w| matches!(w, SkipReason::Gpu { .. })).map(|w| w.to_string())
    };
    let small = wave(Channels::Grey, |x, y, _| (x + y) as u8);
    let why = gpu(&small, Backend::Auto);
    assert_eq!(why.as_deref(), Some("the GPU: the picture has fewer than 262144 pixels"));
    assert_eq!(gpu(&small, Backend::Cpu), None);
    // Without a fit, no device is used.
    assert_eq!(gpu(&wave(Channels::Grey, |_, _, _| 9), Backend::Auto), None);
    #[cfg(not(feature = "gpu"))]
    {
        let samples = (0..512 * 512u32).map(|i| (i / 4096 + i % 512 / 16) as u8).collect();
        let large = Pixels::new(512, 512, Channels::Grey, Samples::U8(samples)).unwrap();
        let why = gpu(&large, Backend::Auto);
        assert_eq!(why.as_deref(), Some("the GPU: this build has no GPU support"));
    }
}

#[test]
fn time_saved_by_several_starts_is_bounded_by_the_time_per_step() {
    // With few primitives, four starts take more steps than the schedule of one fit.
    let pixels = wave(Channels::Grey, |x, y, _| (100 + (x + y) / 2) as u8);
    let encoded = ssplat::unstable::encode(&pixels, &options(5, Target::Gaussians(40))).unwrap();
    let saved = encoded.report.skipped.iter().find(|l| l.what == SkipReason::Iterations).expect("it is soft").seconds;
    assert!((0.0..1000.0).contains(&saved), "{saved} s");
}

#[test]
fn primitives_that_only_a_discarded_try_left_out_are_not_reported() {
    // The first try, at a ratio of 50, is below the rounding error without 396 bytes of its primitives. The search then
    // finds a file of 83 bytes, in which every primitive is needed.
    let sample = |x: u32, y: u32, k: usize| {
        let [x, y] = [x, y].map(f64::from);
        (128.5 + 90.0 * (x / 40.0 + k as f64).sin() * (y / 50.0).cos()) as u8
    };
    let samples = (0..200 * 200 * 3).map(|i| sample(i / 3 % 200, i / 600, i as usize % 3)).collect();
    let pixels = Pixels::new(200, 200, Channels::Rgb, Samples::U8(samples)).unwrap();
    let encoded = ssplat::unstable::encode(&pixels, &options(1, Target::Psnr(40.0))).unwrap();
    let saved = encoded.report.skipped.iter().find(|l| l.what == SkipReason::Gaussians).map_or(0, |l| l.bytes);
    let bytes = encoded.bytes.len();
    assert!(saved < bytes as u64, "{saved} bytes saved in a file of {bytes} bytes");
}

/// Three rows of squares in few colours on white, which share their colours.
fn diagram(channels: Channels, colors: impl Fn(u32, usize) -> u8) -> Pixels {
    let n = channels.count();
    let value = |i: usize| {
        let [x, y] = [(i / n) as u32 % 160, (i / n) as u32 / 160];
        let is_ink = x % 16 < 9 && y % 40 < 25;
        match (is_ink, channels.alpha() == Some(i % n)) {
            (_, true) => {
                if x < 120 {
                    255
                } else {
                    0
                }
            }
            (true, _) => colors(y / 40, i % n),
            (false, _) => 255,
        }
    };
    Pixels::new(160, 120, channels, Samples::U8((0..160 * 120 * n).map(value).collect())).unwrap()
}

#[test]
fn bytes_saved_by_a_codebook_are_those_that_a_file_without_it_takes() {
    let inks = |row: u32, k: usize| [[200, 30, 30], [20, 90, 200], [0, 0, 0]][row as usize][k.min(2)];
    let mut with_codebook = 0;
    for pixels in [
        diagram(Channels::Rgb, inks),
        diagram(Channels::Rgb, |row, _| 60 * row as u8),
        diagram(Channels::Rgba, inks),
        diagram(Channels::Grey, |row, _| 60 * row as u8),
    ] {
        for ratio in [20.0, 50.0] {
            let mut options = options(1, Target::Ratio(ratio));
            (options.tune, options.detail) = (Some(Tune::Iq), Detail::GaussianShare(0.5));
            let encoded = ssplat::unstable::encode(&pixels, &options).unwrap();
            let reported = encoded.report.skipped.iter().find(|l| l.what == SkipReason::OwnColors).map(|l| l.bytes);
            let mut splats = bitstream::read(&encoded.bytes[..], &Limits::default()).unwrap();
            let has_codebook = splats.codebook.take().is_some();
            let without = bitstream::to_bytes(&splats).unwrap().len();
            let saved = has_codebook.then(|| (without - encoded.bytes.len()) as u64);
            assert_eq!(reported, saved, "{:?} at {ratio}", pixels.channels());
            with_codebook += u32::from(has_codebook);
        }
    }
    assert!(with_codebook > 0, "no file has a codebook");
}
