//! Searches for a PSNR or a quality: a reachable target is reached, and only the largest file proves that a target is
//! unreachable.

use std::time::Duration;

use ssplat::unstable::{EncodeOptions, encode};
use ssplat::{Blend, Channels, Error, Parameter, Pixels, Samples, Target};

fn noise(side: u32, channels: Channels) -> Pixels {
    let count = side * side * channels.count() as u32;
    let samples = (0..count).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8 ^ (i.wrapping_mul(40_503) >> 7) as u8);
    Pixels::new(side, side, channels, Samples::U8(samples.collect())).unwrap()
}

fn checkerboard(side: u32) -> Pixels {
    let samples = (0..side * side).map(|i| if (i % side + i / side).is_multiple_of(2) { 30 } else { 220 });
    Pixels::new(side, side, Channels::Grey, Samples::U8(samples.collect())).unwrap()
}

/// A part of a photograph.
fn crop(left: u32, top: u32, side: u32) -> Pixels {
    let photo = image::open("tests/images/kodim05.png").unwrap().crop_imm(left, top, side, side);
    Pixels::try_from(photo).unwrap()
}

fn hard_pictures() -> Vec<(&'static str, Pixels)> {
    vec![
        ("grey noise of 16 × 16", noise(16, Channels::Grey)),
        ("noise of 32 × 32", noise(32, Channels::Rgb)),
        ("checkerboard of 32 × 32", checkerboard(32)),
        ("crop of 24 × 24", crop(300, 200, 24)),
        ("crop of 32 × 32", crop(500, 140, 32)),
    ]
}

fn options(target: Target, time: Option<Duration>) -> EncodeOptions {
    let mut options = EncodeOptions::default();
    (options.target, options.effort, options.time) = (target, 1, time);
    options
}

#[test]
fn a_psnr_is_reached_on_any_picture() {
    for (name, pixels) in hard_pictures() {
        for wanted in [18.0, 20.0, 22.0, 25.0, 30.0] {
            let encoded = encode(&pixels, &options(Target::Psnr(wanted), None));
            let encoded = encoded.unwrap_or_else(|e| panic!("{name} at {wanted} dB: {e}"));
            assert!(encoded.report.psnr >= wanted, "{name} at {wanted} dB: {}", encoded.report.psnr);
        }
    }
}

#[test]
fn a_psnr_with_a_time_budget_gives_the_best_file_so_far() {
    for (name, pixels) in hard_pictures() {
        for wanted in [18.0, 22.0, 30.0, 50.0, 90.0] {
            let encoded = encode(&pixels, &options(Target::Psnr(wanted), Some(Duration::from_millis(40))));
            let encoded = encoded.unwrap_or_else(|e| panic!("{name} at {wanted} dB: {e}"));
            assert!(encoded.report.psnr > 5.0, "{name} at {wanted} dB: {}", encoded.report.psnr);
        }
    }
}

#[test]
fn only_the_largest_file_proves_that_a_psnr_cannot_be_reached() {
    let pixels = noise(24, Channels::Grey);
    // An exact layer would reach any PSNR.
    let options = |target| {
        let mut options = options(target, None);
        options.blend = Some(Blend::Normalized);
        options
    };
    let refused = encode(&pixels, &options(Target::Psnr(140.0)));
    let Err(Error::Parameter { parameter: Parameter::Psnr, problem }) = &refused else { panic!("{refused:?}") };
    // The message states the PSNR at twice the raw size; fits differ by a few tenths of a decibel.
    let best = encode(&pixels, &options(Target::Bytes(2 * 24 * 24))).unwrap().report.psnr;
    let said: f64 = problem.split_whitespace().rev().nth(1).unwrap().parse().unwrap();
    assert!(said > best - 1.0, "{problem}, and {best} dB with twice the raw bytes");
}

#[cfg(feature = "quality")]
#[test]
fn a_quality_is_met_on_any_picture() {
    for (name, pixels) in hard_pictures() {
        for wanted in [20.0, 40.0, 60.0, 80.0] {
            let encoded = encode(&pixels, &options(Target::Quality(wanted), None)).unwrap();
            let found = encoded.report.quality.unwrap();
            assert!(found >= wanted - 0.5, "{name} at {wanted}: {found}");
        }
    }
}
