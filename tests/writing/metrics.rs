//! Compares PSNR, SSIM and MS-SSIM with values of an independent implementation (numpy and OpenCV, following the
//! PyTorch package pytorch-msssim), computed once for the same pictures.

use ssplat::unstable::metrics;
use ssplat::{Channels, Pixels, Samples};

/// f32 sums in another order; the reference also filters in f32.
const TOLERANCE: f64 = 2e-5;

/// A picture of gradients and seeded noise that is easy to generate in any language.
fn synthetic(width: u32, height: u32, channels: Channels, salt: u64) -> Pixels {
    let count = channels.count() as u64;
    let mut samples = Vec::new();
    for y in 0..u64::from(height) {
        for x in 0..u64::from(width) {
            for k in 0..count {
                let noise = (x * 7 + y * 13 + k * 29 + salt) * 2_654_435_761 >> 7;
                samples.push(((x * x / 97 + y * 3 + k * 40) % 200 + noise % (1 + salt)) as u8);
            }
        }
    }
    Pixels::new(width, height, channels, Samples::U8(samples)).unwrap()
}

fn kodim05() -> Vec<u8> {
    image::open("tests/images/kodim05.png").unwrap().into_rgb8().into_raw()
}

fn photograph(samples: Vec<u8>) -> Pixels {
    Pixels::new(768, 512, Channels::Rgb, Samples::U8(samples)).unwrap()
}

#[track_caller]
fn agrees(a: &Pixels, b: &Pixels, psnr: f64, ssim: f64, ms_ssim: f64) {
    let found = metrics::compare(a, b).unwrap();
    assert!((found.psnr - psnr).abs() < 1e-9, "{found:?}, expected PSNR {psnr}");
    assert!((found.ssim.unwrap() - ssim).abs() < TOLERANCE, "{found:?}, expected SSIM {ssim}");
    assert!((found.ms_ssim.unwrap() - ms_ssim).abs() < TOLERANCE, "{found:?}, expected MS-SSIM {ms_ssim}");
}

#[test]
fn odd_sides_agree_with_the_reference() {
    let [a, b] = [9, 40].map(|salt| synthetic(333, 205, Channels::Rgb, salt));
    agrees(&a, &b, 22.237_553_552_130_443, 0.595_612_977, 0.961_370_761);
}

#[test]
fn grey_agrees_with_the_reference() {
    let [a, b] = [9, 55].map(|salt| synthetic(333, 205, Channels::Grey, salt));
    agrees(&a, &b, 19.107_129_299_490_076, 0.452_375_081, 0.949_643_144);
}

#[test]
fn photographs_agree_with_the_reference() {
    let original = kodim05();
    let coarse = original.iter().map(|v| (u32::from(*v) / 24 * 24 + 12).min(255) as u8).collect();
    let negative = original.iter().map(|v| 255 - v).collect();
    let shifted = original.chunks_exact(3 * 768).flat_map(|row| [&row[3 * 766..], &row[..3 * 766]].concat()).collect();
    let original = photograph(original);
    agrees(&original, &photograph(coarse), 31.291_396_359_254_89, 0.898_684_653, 0.981_915_894);
    agrees(&original, &photograph(negative), 5.388_144_144_056_413, -0.396_766_182, 0.0);
    agrees(&original, &photograph(shifted), 17.829_375_676_070_175, 0.383_710_448, 0.782_178_985);
}

#[test]
fn equal_pictures_have_infinite_psnr_and_similarity_one() {
    let a = synthetic(176, 176, Channels::Rgba, 3);
    let found = metrics::compare(&a, &a).unwrap();
    assert_eq!(found.psnr, f64::INFINITY);
    assert!((found.ssim.unwrap() - 1.0).abs() < 1e-6 && (found.ms_ssim.unwrap() - 1.0).abs() < 1e-6);
}

#[test]
fn sixteen_bits_measure_like_eight() {
    let [a, b] = [9, 40].map(|salt| synthetic(200, 180, Channels::Rgb, salt));
    let wide = |p: &Pixels| {
        let Samples::U8(v) = p.samples() else { unreachable!() };
        let samples = Samples::U16(v.iter().map(|&v| u16::from(v) * 257).collect());
        Pixels::new(p.width(), p.height(), p.channels(), samples).unwrap()
    };
    let (narrow, wide) = (metrics::compare(&a, &b).unwrap(), metrics::compare(&wide(&a), &wide(&b)).unwrap());
    assert!((narrow.psnr - wide.psnr).abs() < 1e-9);
    assert!((narrow.ms_ssim.unwrap() - wide.ms_ssim.unwrap()).abs() < 1e-6);
}

#[test]
fn similarity_of_small_pictures_is_none() {
    let of = |width, height| {
        let [a, b] = [9, 40].map(|salt| synthetic(width, height, Channels::Grey, salt));
        metrics::compare(&a, &b).unwrap()
    };
    assert!(of(1, 1).ssim.is_none() && of(4000, 10).ssim.is_none());
    assert!(of(160, 400).ms_ssim.is_none() && of(160, 400).ssim.is_some());
    assert!(of(161, 400).ms_ssim.is_some());
}

#[test]
fn different_shapes_are_a_parameter_error() {
    let a = synthetic(20, 20, Channels::Grey, 1);
    let deep = Pixels::new(20, 20, Channels::Grey, Samples::U16(vec![0; 400])).unwrap();
    for b in [synthetic(20, 21, Channels::Grey, 1), synthetic(20, 20, Channels::Rgb, 1), deep] {
        assert!(matches!(metrics::compare(&a, &b), Err(ssplat::Error::Parameter { .. })));
    }
}

#[test]
fn colours_are_weighted_by_the_opacity_of_the_original() {
    let picture = |color: u8, alpha: u8| {
        Pixels::new(12, 12, Channels::GreyAlpha, Samples::U8([color, alpha].repeat(144))).unwrap()
    };
    // Invisible colours do not count.
    assert_eq!(metrics::psnr(&picture(0, 0), &picture(200, 0)).unwrap(), f64::INFINITY);
    let half = metrics::psnr(&picture(100, 51), &picture(110, 51)).unwrap();
    let whole = metrics::psnr(&picture(100, 255), &picture(110, 255)).unwrap();
    assert!((half - whole - 10.0 * 5.0f64.log10()).abs() < 1e-9, "{half} {whole}");
    let deep =
        |color: u16| Pixels::new(12, 12, Channels::GreyAlpha, Samples::U16([color, 51 * 257].repeat(144))).unwrap();
    assert!((metrics::psnr(&deep(100 * 257), &deep(110 * 257)).unwrap() - half).abs() < 1e-9);
    // An error of alpha counts in full.
    let alpha = metrics::psnr(&picture(100, 0), &picture(100, 10)).unwrap();
    assert!((alpha - whole).abs() < 1e-9, "{alpha} {whole}");
}

#[test]
fn measures_ignore_colours_under_alpha_0() {
    let visible = synthetic(200, 180, Channels::Rgba, 9);
    let Samples::U8(samples) = visible.samples() else { unreachable!() };
    // A transparent half, once black and once white.
    let [black, white] = [0, 255].map(|hidden| {
        let mut samples = samples.clone();
        for (i, pixel) in samples.chunks_exact_mut(4).enumerate() {
            if i % 200 < 100 {
                pixel.copy_from_slice(&[hidden, hidden, hidden, 0]);
            }
        }
        Pixels::new(200, 180, Channels::Rgba, Samples::U8(samples)).unwrap()
    });
    let found = metrics::compare(&black, &white).unwrap();
    assert_eq!(found.psnr, f64::INFINITY);
    assert!((found.ssim.unwrap() - 1.0).abs() < 1e-6 && (found.ms_ssim.unwrap() - 1.0).abs() < 1e-6, "{found:?}");
    // Where alpha is not 0, colours count.
    assert!(metrics::compare(&visible, &black).unwrap().ssim.unwrap() < 0.9);
}
