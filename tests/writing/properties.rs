//! The encoder keeps its promises where options meet: small pictures of every kind, with random options.
//!
//! `SSPLAT_CASES` sets the number of cases (default: 60), and `SSPLAT_SEED` the seed of the first (default: 0).
//! `.ci/slow` runs many. A failure prints the case, which `SSPLAT_SEED=SEED SSPLAT_CASES=1` repeats.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use ssplat::unstable::{EncodeOptions, encode, metrics};
use ssplat::{
    Blend, Channels, Cicp, Decoder, Depth, Detail, Encoded, Encoder, Error, Gaussian, Gaussians, HiddenColors, Layout,
    Limit, Limits, Pixels, Reader, Samples, Target, Thumbnail, Tune,
};
use std::time::Duration;

/// A picture to encode and the options.
#[derive(Debug)]
struct Case {
    kind: Kind,
    alpha: Alpha,
    depth: Depth,
    pixels: Pixels,
    options: EncodeOptions,
}

/// What the colours of a picture show.
#[derive(Debug, Clone, Copy)]
enum Kind {
    Noise,
    Gradient,
    Checks,
    Stripes,
    Spike,
    Letters,
    /// Smooth, with less than a thousandth of the range of 16 bits.
    Faint,
    Flat,
}

/// What the alpha of a picture is, if it has one.
#[derive(Debug, Clone, Copy)]
enum Alpha {
    Opaque,
    Mask,
    Soft,
    Faint,
}

fn one_of<T: Copy>(rng: &mut Pcg64, values: &[T]) -> T {
    values[rng.random_range(0..values.len())]
}

/// Returns the values, `0..=1`, of a pixel.
fn value(kind: Kind, rng: &mut Pcg64, [x, y]: [u32; 2], [width, height]: [u32; 2], k: usize) -> f64 {
    let [u, v] = [f64::from(x) / f64::from(width), f64::from(y) / f64::from(height)];
    match kind {
        Kind::Noise => rng.random(),
        Kind::Gradient => 0.1 + 0.8 * (u * (k + 1) as f64 / 3.0 + v) / 2.0,
        Kind::Checks => f64::from((x / 2 + y / 2) % 2),
        Kind::Stripes => f64::from(x % 3 / 2),
        Kind::Spike => f64::from(x == width / 2 && y == height / 2),
        Kind::Letters => f64::from(!(x % 7 < 4 && y % 9 < 6 && (x / 7 * 31 + y / 9 * 17 + x * y % 3) % 4 > 0)),
        Kind::Faint => 0.3 + 0.0004 * (9.0 * u + 5.0 * v + k as f64).sin(),
        Kind::Flat => 0.2 + 0.3 * k as f64,
    }
}

fn pixels(kind: Kind, alpha: Alpha, depth: Depth, channels: Channels, size: [u32; 2], rng: &mut Pcg64) -> Pixels {
    let most = f64::from(depth.max());
    let mut samples = Vec::new();
    for y in 0..size[1] {
        for x in 0..size[0] {
            for k in 0..channels.count() {
                let v = match alpha {
                    _ if channels.alpha() != Some(k) => value(kind, rng, [x, y], size, k),
                    Alpha::Opaque => 1.0,
                    Alpha::Mask => f64::from((x / 5 + y / 4) % 3 > 0),
                    Alpha::Soft => (f64::from(x) + 0.5 * f64::from(y)) / f64::from(size[0] + size[1]),
                    Alpha::Faint => 0.1,
                };
                samples.push((v * most + 0.5) as u16);
            }
        }
    }
    let samples = match depth {
        Depth::Eight => Samples::U8(samples.into_iter().map(|v| v as u8).collect()),
        Depth::Sixteen => Samples::U16(samples),
    };
    Pixels::new(size[0], size[1], channels, samples).unwrap()
}

impl Case {
    fn new(seed: u64) -> Case {
        let rng = &mut Pcg64::seed_from_u64(seed);
        let kind = one_of(rng, &{
            use Kind::*;
            [Noise, Gradient, Checks, Stripes, Spike, Letters, Faint, Flat]
        });
        let alpha = one_of(rng, &[Alpha::Opaque, Alpha::Mask, Alpha::Soft, Alpha::Faint]);
        let depth = one_of(rng, &[Depth::Eight, Depth::Eight, Depth::Sixteen]);
        let channels = one_of(rng, &[Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba]);
        let side = |rng: &mut Pcg64| one_of(rng, &[1, 2, 7, 16, 23, 40, 64]);
        let mut size = [side(rng), side(rng)];
        let mut options = EncodeOptions::default();
        options.effort = one_of(rng, &[1, 1, 2, 3, 5]);
        if rng.random_range(0..8) == 0 {
            (size, options.tiles, options.effort) = ([150, 20], Some(128), 1);
        }
        let pixels = pixels(kind, alpha, depth, channels, size, rng);
        options.hidden = one_of(rng, &[HiddenColors::Continue, HiddenColors::Keep]);
        options.tune = one_of(rng, &[None, None, Some(Tune::Psnr), Some(Tune::Psnr), Some(Tune::Iq)]);
        options.blend = one_of(rng, &[None, None, None, Some(Blend::Sum)]);
        options.layout = one_of(rng, &[Layout::Coded, Layout::Coded, Layout::Coded, Layout::Packed, Layout::Planes]);
        options.target = match rng.random_range(0..9) {
            8 if options.layout == Layout::Coded => Target::Lossless,
            0 => Target::Auto,
            1 => Target::Ratio(rng.random_range(3.0..60.0)),
            2 => Target::Psnr(rng.random_range(18.0..45.0)),
            3 => Target::Quality(rng.random_range(20.0..90.0)),
            4 => Target::Gaussians(rng.random_range(0..30)),
            _ => Target::Bytes(rng.random_range(60..900)),
        };
        let is_coded = options.layout == Layout::Coded;
        if is_coded && !matches!(options.target, Target::Gaussians(_)) {
            options.detail = one_of(rng, &[Detail::Auto, Detail::Auto, Detail::Off, Detail::GaussianShare(0.2)]);
        }
        if is_coded {
            options.levels = one_of(rng, &[1, 1, 1, 3]);
        }
        if matches!(options.target, Target::Bytes(_)) {
            options.thumbnail = one_of(rng, &[Thumbnail::Auto, Thumbnail::Auto, Thumbnail::Bytes(50)]);
        }
        options.icc = one_of(rng, &[None, None, Some(3000)]).map(|n| vec![7; n]);
        options.exif = one_of(rng, &[None, None, None, Some(20_000)]).map(|n| vec![9; n]);
        options.time = one_of(rng, &[None, None, None, None, Some(Duration::from_millis(20))]);
        options.seed = rng.random_range(0..3);
        options.cicp = one_of(rng, &[None, None, Some(Cicp::BT2100_PQ)]);
        // The size is that of the picture; the metadata comes on top.
        if let Target::Bytes(bytes) = &mut options.target {
            *bytes += [&options.icc, &options.exif].into_iter().flatten().map(|m| m.len() as u64 + 12).sum::<u64>();
            *bytes += if options.cicp.is_some() { 14 } else { 0 };
        }
        Case { kind, alpha, depth, pixels, options }
    }
}

/// Decodes with the default limits.
fn decoded(encoded: &Encoded) -> Pixels {
    Decoder::new().limits(Limits::default()).decode(&encoded.bytes).expect("the encoder's own file opens").pixels
}

/// Returns the error that a PSNR stands for: the root of the mean squared error, in code values.
fn rms(psnr: f64, depth: Depth) -> f64 {
    f64::from(depth.max()) * 10f64.powf(-psnr / 20.0)
}

/// Encodes `case` and checks what holds for every file. Returns `None` if the encoder refuses it, which it may do if the
/// target cannot be reached or if options exclude each other.
fn checked(pixels: &Pixels, options: &EncodeOptions) -> Option<(Encoded, Pixels)> {
    let encoded = match encode(pixels, options) {
        Ok(encoded) => encoded,
        Err(Error::TooSmall { .. } | Error::Parameter { .. }) => return None,
        Err(error) => panic!("{error}"),
    };
    let samples = f64::from(pixels.width()) * f64::from(pixels.height()) * pixels.channels().count() as f64;
    let length = encoded.bytes.len() as f64;
    match options.target {
        Target::Bytes(bytes) => assert!(length <= bytes as f64, "{length} bytes of {bytes}"),
        Target::Ratio(ratio) => assert!(length <= samples / ratio, "{length} bytes at a ratio of {ratio}"),
        _ => {}
    }
    let picture = decoded(&encoded);
    assert_eq!(
        (picture.width(), picture.height(), picture.channels(), picture.depth()),
        (pixels.width(), pixels.height(), pixels.channels(), pixels.depth())
    );
    // The decoder rounds each sample by at most half a code value.
    let [reported, measured] =
        [encoded.report.psnr, metrics::psnr(pixels, &picture).unwrap()].map(|psnr| rms(psnr, pixels.depth()));
    assert!((reported - measured).abs() < 0.51, "the report says an error of {reported} code values, not {measured}");
    if options.target == Target::Lossless {
        let is_seen = pixels.channels().alpha().is_some() && options.hidden != HiddenColors::Keep;
        assert!(if is_seen { measured == 0.0 } else { picture == *pixels }, "a file without loss has other samples");
    }
    if let (Target::Psnr(wanted), None) = (options.target, options.time) {
        assert!(encoded.report.psnr >= wanted, "{} dB instead of {wanted}", encoded.report.psnr);
    }
    if let (Target::Quality(_), Some(quality), None) = (options.target, encoded.report.quality, options.tiles) {
        let found = metrics::ssimulacra2(pixels, &picture).unwrap();
        assert!((quality - found).abs() < 0.01, "the report says a quality of {quality}, not {found}");
    }
    Some((encoded, picture))
}

/// Checks a case, and what must hold between it and others that differ from it in one option.
fn check(case: &Case) {
    let Case { pixels, options, .. } = case;
    let Some((encoded, picture)) = checked(pixels, options) else { return };
    let error = rms(metrics::psnr(pixels, &picture).unwrap(), pixels.depth());
    if options.time.is_some() {
        return;
    }
    let carried = Reader::new(&encoded.bytes, &Limits::default()).unwrap().metadata().unwrap();
    assert_eq!((carried.cicp, carried.icc, carried.exif), (options.cicp, options.icc.clone(), options.exif.clone()));
    // The picture is the same whatever rides along.
    if options.cicp.is_some() || options.icc.is_some() || options.exif.is_some() {
        let mut plain = options.clone();
        (plain.cicp, plain.icc, plain.exif) = (None, None, None);
        if let Target::Bytes(bytes) = &mut plain.target {
            // Each section has a name of 4 bytes, a length of 2 or 3 and a checksum of 4; their number takes a byte.
            let sections = [&options.icc, &options.exif].into_iter().flatten().map(|m| m.len() + 8);
            let lengths = options.icc.iter().map(|_| 2).chain(options.exif.iter().map(|_| 3));
            let cicp = if options.cicp.is_some() { 4 + 8 + 1 } else { 0 };
            *bytes -= (1 + sections.sum::<usize>() + lengths.sum::<usize>() + cicp) as u64;
        }
        if !matches!(options.target, Target::Ratio(_)) {
            let (_, other) = checked(pixels, &plain).expect("the same file without metadata");
            assert!(other == picture, "metadata changes the picture");
        }
    }
    // Twice the bytes are never worse. With hidden colours to keep, they may serve these.
    let hides = options.hidden == HiddenColors::Keep && pixels.channels().alpha().is_some();
    if let (Target::Bytes(bytes), false) = (options.target, hides) {
        let mut more = options.clone();
        more.target = Target::Bytes(2 * bytes);
        let (_, other) = checked(pixels, &more).expect("there is room");
        let [less, more] = [&picture, &other].map(|p| metrics::psnr(pixels, p).unwrap().min(GOOD));
        assert!(more > less - ALLOWED, "{less} dB with {bytes} bytes, {more} with twice as many");
    }
    // No file is worse than one colour of the same picture.
    if options.layout == Layout::Coded && options.blend.is_none() && !matches!(options.target, Target::Gaussians(_)) {
        let flat = flat(pixels);
        let least = rms(metrics::psnr(pixels, &flat).unwrap(), pixels.depth());
        let room = encoded.bytes.len() > 40;
        // The finest steps of 16 bits are 4 values.
        let step = if pixels.depth() == Depth::Eight { 1.0 } else { 4.0 };
        assert!(!room || error <= 1.05 * least + step, "an error of {error} code values, one colour has {least}");
    }
    // Where nothing is hidden, keeping hidden colours costs little.
    let is_visible = matches!(case.alpha, Alpha::Opaque) || pixels.channels().alpha().is_none();
    if let (Target::Bytes(_), true) = (options.target, is_visible) {
        let other = match options.hidden {
            HiddenColors::Keep => HiddenColors::Continue,
            _ => HiddenColors::Keep,
        };
        let mut kept = options.clone();
        kept.hidden = other;
        let (_, other) = checked(pixels, &kept).expect("it has room");
        assert!(other == picture, "the treatment of hidden colours changes a picture that has none");
    }
}

/// Decibels that a fit may lose by chance.
const ALLOWED: f64 = 1.0;
/// PSNR above which small fits differ by chance, decibels.
const GOOD: f64 = 40.0;

/// Returns the mean colour of `pixels`, weighted by opacity, in all pixels.
fn flat(pixels: &Pixels) -> Pixels {
    let (count, alpha) = (pixels.channels().count(), pixels.channels().alpha());
    let samples: Vec<u16> = match pixels.samples() {
        Samples::U8(v) => v.iter().map(|&v| v.into()).collect(),
        Samples::U16(v) => v.clone(),
    };
    let mut mean = [0u16; 4];
    for (k, mean) in mean.iter_mut().enumerate().take(count) {
        let (mut sum, mut weight) = (0.0, 0.0);
        for p in samples.chunks_exact(count) {
            let w = alpha.filter(|&a| a != k).map_or(1.0, |a| f64::from(p[a]));
            (sum, weight) = (sum + w * f64::from(p[k]), weight + w);
        }
        *mean = if weight > 0.0 { (sum / weight + 0.5) as u16 } else { 0 };
    }
    let all = samples.chunks_exact(count).flat_map(|_| mean[..count].to_vec());
    let samples = match pixels.depth() {
        Depth::Eight => Samples::U8(all.map(|v| v as u8).collect()),
        Depth::Sixteen => Samples::U16(all.collect()),
    };
    Pixels::new(pixels.width(), pixels.height(), pixels.channels(), samples).unwrap()
}

#[test]
fn the_encoder_keeps_its_promises_with_any_options() {
    let of = |name: &str, or| std::env::var(name).ok().map_or(or, |v| v.parse().expect("a number"));
    let (cases, first) = (of("SSPLAT_CASES", 60), of("SSPLAT_SEED", 0));
    let mut failed = Vec::new();
    for seed in first..first + cases {
        let case = Case::new(seed);
        let result = std::panic::catch_unwind(|| check(&case));
        if result.is_err() {
            let Case { kind, alpha, depth, pixels, options } = &case;
            let (size, channels) = ([pixels.width(), pixels.height()], pixels.channels());
            let mut options = options.clone();
            options.icc.iter_mut().chain(&mut options.exif).for_each(|block| block.truncate(1));
            eprintln!("SSPLAT_SEED={seed}: {kind:?}, {alpha:?}, {depth:?}, {channels:?}, {size:?}\n{options:?}");
            failed.push(seed);
        }
    }
    assert!(failed.is_empty(), "{} of {cases} cases: {failed:?}", failed.len());
}

/// A smooth picture with some detail: waves of several frequencies.
fn waves(size: [u32; 2], channels: Channels, alpha: impl Fn(u32, u32) -> u8) -> Pixels {
    let mut samples = Vec::new();
    for (y, x) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (y, x))) {
        for k in 0..channels.count() as u32 {
            let wave = |f: f64| (f * (f64::from(x * (k + 2)) + f64::from(2 * y)) / 40.0).sin();
            let v = 128.0 + 60.0 * wave(1.0) + 30.0 * wave(2.7) + 12.0 * wave(7.1);
            samples.push(if channels.alpha() == Some(k as usize) { alpha(x, y) } else { v as u8 });
        }
    }
    Pixels::new(size[0], size[1], channels, Samples::U8(samples)).unwrap()
}

fn to_bytes(bytes: u64, effort: u8) -> EncodeOptions {
    let mut options = EncodeOptions::default();
    (options.target, options.effort) = (Target::Bytes(bytes), effort);
    options
}

/// At commit a6c9785, keeping hidden colours cost 15 dB where nothing is hidden: 39.3 and 24.1 dB.
#[test]
fn keeping_hidden_colours_costs_little_where_none_are_hidden() {
    for channels in [Channels::Rgba, Channels::GreyAlpha] {
        let pixels = waves([64, 64], channels, |x, y| 235 + ((x + y) % 21) as u8);
        let psnr = |hidden| {
            let mut options = to_bytes(250, 3);
            (options.hidden, options.detail) = (hidden, Detail::Off);
            let (encoded, _) = checked(&pixels, &options).unwrap();
            encoded.report.psnr
        };
        let [replaced, kept] = [HiddenColors::Continue, HiddenColors::Keep].map(psnr);
        assert!(kept > replaced - 1.5, "{channels:?}: {kept} dB kept, {replaced} otherwise");
    }
}

/// At commit a6c9785, the file of a picture with an alpha of 26 had 30.2 dB instead of 40.
#[test]
fn a_psnr_is_reached_under_soft_alpha() {
    for alpha in [1, 26, 128, 255] {
        let pixels = waves([64, 64], Channels::Rgba, |_, _| alpha);
        let mut options = to_bytes(0, 1);
        options.target = Target::Psnr(38.0);
        let (_, picture) = checked(&pixels, &options).unwrap();
        let found = metrics::psnr(&pixels, &picture).unwrap();
        assert!(found > 37.8, "alpha {alpha}: {found} dB");
    }
}

/// At commit a6c9785, 20 kB of metadata cost .3 dB, and a profile could flatten a smooth picture to one colour.
#[test]
fn the_picture_is_the_same_with_any_amount_of_metadata() {
    let pixels = waves([128, 96], Channels::Rgb, |_, _| 255);
    for detail in [Detail::Off, Detail::GaussianShare(0.3)] {
        let encoded = |exif: usize| {
            // Name, length, checksum, and the number of sections. A layer has a section of its own, so that number is
            // there already, and the file may be one byte smaller.
            let sections = if exif > 0 { 4 + 4 + 1 + if exif < 1 << 14 { 2 } else { 3 } } else { 0 };
            let mut options = to_bytes((1500 + exif + sections) as u64, 2);
            (options.detail, options.exif) = (detail, (exif > 0).then(|| vec![5; exif]));
            let (encoded, picture) = checked(&pixels, &options).unwrap();
            (encoded.bytes.len() - exif - sections, picture)
        };
        let (bytes, picture) = encoded(0);
        for exif in [3_000, 20_000, 200_000] {
            let (more, other) = encoded(exif);
            assert!(bytes - more <= usize::from(detail != Detail::Off), "{more} bytes beside {exif}, {bytes} alone");
            assert!(other == picture, "{exif} bytes of metadata change the picture");
        }
    }
}

/// At commit a6c9785, a grey picture stored as RGBA was fitted twice, because its file was a few bytes too long.
#[test]
fn constant_channels_need_no_second_fit() {
    let grey = waves([96, 96], Channels::Grey, |_, _| 255);
    let Samples::U8(samples) = grey.samples() else { panic!() };
    let wide = samples.iter().flat_map(|&v| [v, v, v, 255]).collect();
    let wide = Pixels::new(96, 96, Channels::Rgba, Samples::U8(wide)).unwrap();
    for bytes in [150, 400, 1500] {
        let mut options = to_bytes(bytes, 2);
        options.detail = Detail::Off;
        let (encoded, _) = checked(&wide, &options).unwrap();
        let fits = encoded.report.stages.iter().filter(|s| s.name == "fit").count();
        assert_eq!(fits, 1, "{bytes} bytes");
        // The largest file is good enough before it is full.
        assert!(encoded.bytes.len() as u64 + 12 > bytes.min(400), "{} bytes of {bytes}", encoded.bytes.len());
    }
}

/// At commit a6c9785, a strip of 300 × 12 pixels "of quality 70" had 14.3 dB.
#[test]
fn a_quality_means_the_same_for_small_pictures() {
    for size in [[300, 12], [16, 16], [3, 90], [1, 1]] {
        let pixels = waves(size, Channels::Rgb, |_, _| 255);
        let mut options = to_bytes(0, 5);
        options.target = Target::Quality(70.0);
        let (encoded, picture) = checked(&pixels, &options).unwrap();
        let found = metrics::psnr(&pixels, &picture).unwrap();
        assert!(found > 26.0 && encoded.report.quality.unwrap() > 69.4, "{size:?}: {found} dB");
    }
}

/// At commit a6c9785, a picture of 41 of the 65536 values had an error of 22 values, where one colour has 10.
#[test]
fn few_levels_of_16_bits_are_as_good_as_the_same_picture_stretched() {
    let size = [96u32, 64];
    let value = |i: u32| {
        let (x, y) = (f64::from(i % size[0]), f64::from(i / size[0]));
        (x / 9.0).sin() + 0.5 * (y / 7.0 + x / 20.0).sin()
    };
    let picture = |low: f64, range: f64| {
        let samples = (0..size[0] * size[1]).map(|i| (low + range * (value(i) + 1.5) / 3.0 + 0.5) as u16).collect();
        Pixels::new(size[0], size[1], Channels::Grey, Samples::U16(samples)).unwrap()
    };
    // Returns the error as a fraction of the range.
    let error = |low, range| {
        let pixels = picture(low, range);
        let (_, found) = checked(&pixels, &to_bytes(1200, 3)).unwrap();
        rms(metrics::psnr(&pixels, &found).unwrap(), Depth::Sixteen) / range
    };
    let whole = error(0.0, 65_535.0);
    // The lowest and the highest 12 bits, and 10 bits. The error of the smallest step, 4 values, is 5 to 6 values.
    for (low, range) in [(0.0, 4095.0), (61_440.0, 4095.0), (30_000.0, 1023.0)] {
        let part = error(low, range);
        assert!(part < 2.0 * whole + 6.0 / range, "{range} levels: {part} of the range, stretched {whole}");
    }
    // The standard deviation of the picture is .26 of the range, and the smallest step is 4 values.
    let few = error(1004.0, 40.0);
    assert!(few < 0.15, "{few} of 40 levels");
}

#[test]
fn metadata_that_no_decoder_would_read_are_refused() {
    let pixels = waves([8, 8], Channels::Grey, |_, _| 255);
    let mut options = to_bytes(1 << 30, 1);
    (options.icc, options.exif) = (Some(vec![0; 40 << 20]), Some(vec![0; 25 << 20]));
    let Err(Error::LimitExceeded { limit, requested, allowed }) = encode(&pixels, &options) else { panic!() };
    assert_eq!((limit, requested, allowed), (Limit::Metadata, 65 << 20, 64 << 20));
}

#[test]
fn gaussians_that_no_decoder_would_render_are_refused() {
    let gaussian = Gaussian { mean: [8000.0; 2], scale: [20_000.0; 2], rotation: 0.0, color: [0.5; 4] };
    let mut gaussians = Gaussians {
        width: 16_384,
        height: 16_384,
        channels: Channels::Grey,
        depth: Depth::Eight,
        blend: Blend::Normalized,
        background: [0.0; 4],
        list: vec![gaussian; 4000],
    };
    let refused = Encoder::new().encode_gaussians(&gaussians).unwrap_err();
    assert!(matches!(refused, Error::LimitExceeded { limit: Limit::Work, .. }), "{refused}");
    gaussians.list.truncate(10);
    assert!(Encoder::new().encode_gaussians(&gaussians).is_ok());
}

/// At commit a6c9785, the decoder refused the encoder's file of 1 × 400 000 pixels: its work was counted as that of tiles
/// of 128 columns.
#[test]
fn thin_pictures_cost_what_they_show() {
    let gaussian =
        |i: u32| Gaussian { mean: [0.5, 2000.0 * i as f32], scale: [0.4, 100_000.0], rotation: 0.0, color: [0.5; 4] };
    let thin = Gaussians {
        width: 1,
        height: 400_000,
        channels: Channels::Rgba,
        depth: Depth::Eight,
        blend: Blend::Normalized,
        background: [0.0; 4],
        list: (0..200).map(gaussian).collect(),
    };
    assert!(Encoder::new().encode_gaussians(&thin).is_ok());
}
