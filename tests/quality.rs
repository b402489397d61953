//! A quality that is asked for: met within half a point, or said to be missed.
#![cfg(feature = "quality")]

use std::ops::ControlFlow;

use ssplat::{
    Channels, DecodeOptions, EncodeOptions, Encoded, Error, Pixels, Samples, Target, encode, encode_with_progress,
    metrics,
};

/// Waves and edges of several sizes.
fn picture(width: u32, height: u32, channels: Channels) -> Pixels {
    let count = channels.count();
    let samples = (0..width as usize * height as usize * count).map(|i| {
        let (k, x, y) = (i % count, (i / count % width as usize) as f32, (i / count / width as usize) as f32);
        let waves = 35.0 * (x / 11.0 + (y / 29.0).sin()).sin() + 20.0 * (y / 6.0 + (x / 17.0).cos()).sin();
        let discs = if ((x * 0.06).sin() + (y * 0.05).cos()).abs() < 0.3 { 50.0 } else { 0.0 };
        if channels.alpha() == Some(k) { 255 } else { (110.0 + waves + discs + 9.0 * k as f32).clamp(0.0, 255.0) as u8 }
    });
    Pixels::new(width, height, channels, Samples::U8(samples.collect())).unwrap()
}

fn quick(wanted: f64) -> EncodeOptions {
    let mut options = EncodeOptions::default();
    (options.target, options.effort) = (Target::Quality(wanted), 1);
    options
}

fn measured(pixels: &Pixels, encoded: &Encoded) -> f64 {
    let decoded = ssplat::decode(&encoded.bytes, &DecodeOptions::default()).unwrap().pixels;
    metrics::ssimulacra2(pixels, &decoded).unwrap().unwrap()
}

#[test]
fn a_quality_is_met_in_at_most_three_fits_and_reported_as_it_is() {
    for channels in [Channels::Rgb, Channels::Rgba] {
        let pixels = picture(160, 120, channels);
        let mut bytes = Vec::new();
        for wanted in [30.0, 50.0, 70.0] {
            let (mut fits, mut last) = (0, f32::INFINITY);
            let encoded = encode_with_progress(&pixels, &quick(wanted), &mut |p| {
                fits += u32::from(p.stage == "fit" && p.done < last);
                last = if p.stage == "fit" { p.done } else { f32::INFINITY };
                ControlFlow::Continue(())
            });
            let encoded = encoded.unwrap();
            let found = measured(&pixels, &encoded);
            assert!((found - wanted).abs() <= 0.5, "{wanted}: {found} after {fits} fits");
            assert_eq!(encoded.report.quality, Some(found));
            assert!(fits <= 3, "{wanted}: {fits} fits");
            bytes.push(encoded.bytes.len());
        }
        assert!(bytes.is_sorted_by(|a, b| a < b), "{bytes:?}");
    }
}

#[test]
fn a_quality_beside_metadata_counts_the_picture_alone() {
    let pixels = picture(160, 120, Channels::Rgb);
    let mut options = quick(50.0);
    options.exif = Some(vec![9; 6000]);
    let encoded = encode(&pixels, &options).unwrap();
    assert!((measured(&pixels, &encoded) - 50.0).abs() <= 0.5);
    let plain = encode(&pixels, &quick(50.0)).unwrap().bytes.len();
    assert!((encoded.bytes.len() - 6000) < plain + plain / 3, "{} and {plain}", encoded.bytes.len());
}

#[test]
fn what_cannot_be_met_is_said() {
    // Noise that no few primitives resemble.
    let noise = (0..40 * 40u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let noise = Pixels::new(40, 40, Channels::Grey, Samples::U8(noise)).unwrap();
    let encoded = encode(&noise, &quick(99.0)).unwrap();
    let found = measured(&noise, &encoded);
    assert!(found < 98.5);
    assert_eq!(encoded.report.quality, Some(found));
    // Pictures that have no such measure.
    let thin = picture(7, 40, Channels::Rgb);
    assert!(matches!(encode(&thin, &quick(50.0)), Err(Error::Parameter { name: "quality", .. })));
    for wanted in [-1.0, 100.5, f64::NAN] {
        assert!(matches!(encode(&noise, &quick(wanted)), Err(Error::Parameter { name: "quality", .. })));
    }
    let mut options = quick(50.0);
    options.tiles = Some(128);
    assert!(matches!(encode(&picture(160, 120, Channels::Rgb), &options), Err(Error::Parameter { name: "tiles", .. })));
}

#[test]
fn a_picture_of_one_colour_has_any_quality() {
    let pixels = Pixels::new(30, 20, Channels::Rgb, Samples::U8([9, 80, 200].repeat(600))).unwrap();
    let encoded = encode(&pixels, &quick(90.0)).unwrap();
    assert!(measured(&pixels, &encoded) > 99.0 && encoded.bytes.len() < 60);
}
