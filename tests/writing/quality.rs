//! A requested quality is met within half a point, or reported as missed.

use ssplat::report::SkipReason;
use ssplat::unstable::metrics;
use ssplat::unstable::{DecodeOptions, EncodeOptions, encode};
use ssplat::{Channels, Detail, Encoded, Error, Parameter, Pixels, Samples, Target};

/// A part of a photograph.
fn picture(width: u32, height: u32, channels: Channels) -> Pixels {
    let photo = image::open("tests/images/kodim05.png").unwrap().crop_imm(200, 100, width, height);
    let photo = if channels == Channels::Rgba { photo.to_rgba8().into() } else { photo };
    Pixels::try_from(photo).unwrap()
}

fn quick(wanted: f64) -> EncodeOptions {
    let mut options = EncodeOptions::default();
    (options.target, options.effort) = (Target::Quality(wanted), 1);
    options
}

fn measured(pixels: &Pixels, encoded: &Encoded) -> f64 {
    let decoded = ssplat::unstable::decode(&encoded.bytes, &DecodeOptions::default()).unwrap().pixels;
    metrics::ssimulacra2(pixels, &decoded).unwrap()
}

#[test]
fn a_quality_is_met_with_one_fit_and_reported_exactly() {
    for channels in [Channels::Rgb, Channels::Rgba] {
        let pixels = picture(160, 120, channels);
        let mut bytes = Vec::new();
        for wanted in [30.0, 50.0, 70.0] {
            let encoded = encode(&pixels, &quick(wanted)).unwrap();
            let fits = encoded.report.stages.iter().filter(|s| s.name == "fit").count();
            let found = measured(&pixels, &encoded);
            assert!((found - wanted).abs() <= 0.5, "{wanted}: {found} after {fits} fits");
            assert_eq!(encoded.report.quality, Some(found));
            // Small files have no layer, so several fits are compared.
            assert!(fits == 1 || wanted < 60.0 && fits <= 6, "{wanted}: {fits} fits");
            bytes.push(encoded.bytes.len());
        }
        assert!(bytes.is_sorted_by(|a, b| a < b), "{bytes:?}");
    }
}

#[test]
fn metadata_does_not_count_towards_the_size_of_a_quality_search() {
    let pixels = picture(160, 120, Channels::Rgb);
    let mut options = quick(50.0);
    options.exif = Some(vec![9; 6000]);
    let encoded = encode(&pixels, &options).unwrap();
    assert!((measured(&pixels, &encoded) - 50.0).abs() <= 0.5);
    let plain = encode(&pixels, &quick(50.0)).unwrap().bytes.len();
    assert!((encoded.bytes.len() - 6000) < plain + plain / 3, "{} and {plain}", encoded.bytes.len());
}

/// Noise that a few primitives cannot represent.
fn noise() -> Pixels {
    let noise = (0..40 * 40u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    Pixels::new(40, 40, Channels::Grey, Samples::U8(noise)).unwrap()
}

#[test]
fn the_highest_qualities_take_no_more_bytes_than_the_picture_without_loss() {
    for pixels in [picture(96, 80, Channels::Rgb), noise()] {
        let lossless = encode(&pixels, &{
            let mut options = quick(0.0);
            options.target = Target::Lossless;
            options
        });
        let lossless = lossless.unwrap().bytes.len();
        for wanted in [97.0, 99.0, 100.0] {
            let encoded = encode(&pixels, &quick(wanted)).unwrap();
            assert!(encoded.bytes.len() <= lossless, "{wanted}: {} and {lossless} bytes", encoded.bytes.len());
            assert!(measured(&pixels, &encoded) >= wanted - 0.5);
            let is_said = encoded.report.skipped.iter().any(|s| s.what == SkipReason::Loss);
            assert!(is_said == (encoded.report.psnr == f64::INFINITY) && (is_said || wanted < 100.0), "{wanted}");
        }
    }
}

#[test]
fn an_unreachable_quality_is_reported() {
    // Without an exact layer, it cannot be stored without loss.
    let noise = noise();
    let mut options = quick(99.0);
    options.detail = Detail::Off;
    let encoded = encode(&noise, &options).unwrap();
    let found = measured(&noise, &encoded);
    assert!(found < 98.5);
    assert_eq!(encoded.report.quality, Some(found));
    // Pictures that are too small for the measure are mirrored.
    let thin = picture(7, 40, Channels::Rgb);
    let encoded = encode(&thin, &quick(50.0)).unwrap();
    assert_eq!(encoded.report.quality, Some(measured(&thin, &encoded)));
    for wanted in [-1.0, 100.5, f64::NAN] {
        assert!(matches!(encode(&noise, &quick(wanted)), Err(Error::Parameter { parameter: Parameter::Quality, .. })));
    }
}

#[test]
fn a_quality_is_met_in_tiles_as_the_mean_of_their_scores() {
    let pixels = picture(300, 260, Channels::Rgb);
    for wanted in [45.0, 75.0] {
        let mut options = quick(wanted);
        options.tiles = Some(256);
        let encoded = encode(&pixels, &options).unwrap();
        let reported = encoded.report.quality.unwrap();
        // One per cent of the bytes of so small a file is worth a point.
        assert!((reported - wanted).abs() < 2.0, "{reported}, {wanted} wanted");
        // The score of the whole picture is close to that mean.
        let whole = measured(&pixels, &encoded);
        assert!((whole - wanted).abs() < 6.0, "{whole}, {wanted} wanted");
    }
}

#[test]
fn a_constant_picture_meets_any_quality() {
    let pixels = Pixels::new(30, 20, Channels::Rgb, Samples::U8([9, 80, 200].repeat(600))).unwrap();
    let encoded = encode(&pixels, &quick(90.0)).unwrap();
    assert!(measured(&pixels, &encoded) > 99.0 && encoded.bytes.len() < 60);
}
