//! The bytes that the encoder writes: a checksum for each kind of picture and option. A change that should not alter
//! files leaves them equal, on every machine. `SSPLAT_PIN=1 cargo test --release --test writing pinned` writes them anew after
//! a change that should.

use std::fmt::Write as _;

use crate::sha256::sha256;
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::unstable::{EncodeOptions, Needs, encode};
use ssplat::{Backend, Blend, Channels, Detail, HiddenColors, Pixels, Samples, Target, Thumbnail, Tune};

const PINNED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/pinned.txt");

/// Returns the middle of a photograph.
fn photograph(width: u32, height: u32) -> Pixels {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/images/kodim15.png");
    let picture = image::open(path).unwrap().crop_imm(250, 90, width, height).into_rgb8();
    Pixels::new(width, height, Channels::Rgb, Samples::U8(picture.into_raw())).unwrap()
}

/// Returns a picture of `sample(x, y, channel)`, an integer formula: floating point would differ between machines.
fn formula(width: u32, height: u32, channels: Channels, sample: impl Fn(u32, u32, u32) -> u32) -> Pixels {
    let count = channels.count() as u32;
    let all = (0..width * height * count).map(|i| sample(i / count % width, i / count / width, i % count) as u8);
    Pixels::new(width, height, channels, Samples::U8(all.collect())).unwrap()
}

/// Returns `pixels` with other channels: luma is green, alpha a disc with a soft edge.
fn with_channels(pixels: &Pixels, channels: Channels) -> Pixels {
    let Samples::U8(samples) = pixels.samples() else { panic!("8 bits") };
    let [width, height] = [pixels.width(), pixels.height()];
    formula(width, height, channels, |x, y, k| {
        let at = |k: u32| u32::from(samples[((y * width + x) * 3 + k) as usize]);
        let square = (2 * x).abs_diff(width).pow(2) + (2 * y).abs_diff(height).pow(2);
        let alpha = (255 * 8 * 1024 / (square + 1)).saturating_sub(255).min(255);
        if channels.alpha() == Some(k as usize) { alpha } else { at(if channels.count() < 3 { 1 } else { k }) }
    })
}

/// Returns 16-bit samples whose low bytes are not those of scaled 8-bit ones.
fn deep(pixels: &Pixels) -> Pixels {
    let Samples::U8(samples) = pixels.samples() else { panic!("8 bits") };
    let wide = samples.iter().enumerate().map(|(i, &v)| u16::from(v) * 256 + (i * 37 % 256) as u16).collect();
    Pixels::new(pixels.width(), pixels.height(), pixels.channels(), Samples::U16(wide)).unwrap()
}

/// Returns a page: a photograph, and lines of dark marks on white below it.
fn page() -> Pixels {
    let photograph = photograph(200, 100);
    let Samples::U8(samples) = photograph.samples() else { panic!("8 bits") };
    let hash = |v: u32| v.wrapping_mul(2_654_435_761) >> 24;
    formula(200, 200, Channels::Rgb, |x, y, k| match y.checked_sub(100) {
        None => samples[((y * 200 + x) * 3 + k) as usize].into(),
        Some(y) if y % 14 < 9 && hash(x / 3 * 31 + y / 3 * 977) < 110 => 20,
        Some(_) => 255,
    })
}

/// Returns a drawing: lines, squares and a circle in four colours.
fn drawing() -> Pixels {
    formula(224, 160, Channels::Rgb, |x, y, k| {
        let circle = (x.abs_diff(150).pow(2) + y.abs_diff(80).pow(2)).abs_diff(2500) < 300;
        let text = x < 90 && y % 16 < 9 && (x * 7 + y / 16 * 5) % 11 < 3;
        match (circle, text, x == y || x == 130) {
            (true, ..) => [220, 30, 40][k as usize],
            (_, true, _) => 20,
            (.., true) => [30, 90, 200][k as usize],
            _ => 255,
        }
    })
}

type Set = fn(&mut EncodeOptions);

/// Returns the names, pictures and options of all encodes.
fn cases() -> Vec<(&'static str, Pixels, Set)> {
    let photo = || photograph(240, 176);
    let small = || photograph(120, 88);
    vec![
        ("default", photo(), |_| ()),
        ("ratio 20", photo(), |o| o.target = Target::Ratio(20.0)),
        ("ratio 100, effort 1", photo(), |o| (o.target, o.effort) = (Target::Ratio(100.0), 1)),
        ("ratio 30, effort 3", photo(), |o| (o.target, o.effort) = (Target::Ratio(30.0), 3)),
        ("ratio 10, effort 7", small(), |o| (o.target, o.effort) = (Target::Ratio(10.0), 7)),
        ("ratio 300", photo(), |o| (o.target, o.effort) = (Target::Ratio(300.0), 2)),
        ("300 bytes", photo(), |o| (o.target, o.effort) = (Target::Bytes(300), 3)),
        ("tune psnr", photo(), |o| (o.target, o.tune, o.effort) = (Target::Ratio(25.0), Some(Tune::Psnr), 3)),
        ("no layer", photo(), |o| (o.detail, o.effort) = (Detail::Off, 3)),
        ("share of .5", photo(), |o| {
            (o.target, o.detail, o.effort) = (Target::Ratio(20.0), Detail::GaussianShare(0.5), 2);
        }),
        ("500 primitives", photo(), |o| (o.target, o.effort) = (Target::Gaussians(500), 2)),
        ("packed layout", photo(), |o| (o.layout, o.effort) = (Layout::Packed, 2)),
        ("planes layout", photo(), |o| (o.layout, o.effort) = (Layout::Planes, 2)),
        ("four levels", photo(), |o| (o.levels, o.effort) = (4, 2)),
        ("blend of sums", photo(), |o| (o.blend, o.effort) = (Some(Blend::Sum), 2)),
        ("another seed", photo(), |o| (o.seed, o.effort) = (7, 2)),
        ("all steps done", photo(), |o| (o.needs, o.effort) = (Needs::Everything, 2)),
        ("a thumbnail", photograph(400, 300), |o| {
            (o.target, o.thumbnail, o.effort) = (Target::Ratio(20.0), Thumbnail::Bytes(400), 1);
        }),
        ("metadata", photo(), |o| {
            (o.icc, o.exif, o.effort) = (Some(vec![5; 300]), Some(b"II*\0\x08\0\0\0\0\0\0\0\0\0".to_vec()), 1);
        }),
        ("psnr of 32", photo(), |o| (o.target, o.effort) = (Target::Psnr(32.0), 1)),
        ("psnr of 45", small(), |o| (o.target, o.effort) = (Target::Psnr(45.0), 1)),
        ("quality of 60", photo(), |o| (o.target, o.effort) = (Target::Quality(60.0), 1)),
        ("quality of 85", small(), |o| (o.target, o.effort) = (Target::Quality(85.0), 1)),
        ("grey", with_channels(&photo(), Channels::Grey), |o| o.effort = 3),
        ("grey in colour", formula(200, 150, Channels::Rgb, |x, y, _| (x * y / 97 + x) % 256), |o| o.effort = 2),
        ("alpha", with_channels(&photo(), Channels::Rgba), |o| (o.target, o.effort) = (Target::Ratio(30.0), 3)),
        ("grey and alpha", with_channels(&photo(), Channels::GreyAlpha), |o| o.effort = 2),
        ("hidden colours kept", with_channels(&photo(), Channels::Rgba), |o| {
            (o.hidden, o.effort) = (HiddenColors::Keep, 2);
        }),
        ("16 bits", deep(&photo()), |o| (o.target, o.effort) = (Target::Ratio(60.0), 2)),
        ("drawing", drawing(), |o| (o.target, o.effort) = (Target::Ratio(40.0), 3)),
        ("page", page(), |o| (o.target, o.effort) = (Target::Ratio(30.0), 4)),
        (
            "noise",
            formula(90, 70, Channels::Rgb, |x, y, k| (x * 7919 + y * 104_729 + k * 31).wrapping_pow(3) >> 9),
            |o| {
                (o.target, o.effort) = (Target::Ratio(10.0), 2);
            },
        ),
        ("one colour", formula(64, 64, Channels::Rgb, |_, _, k| 40 + 60 * k), |_| ()),
        ("one pixel", formula(1, 1, Channels::Rgba, |_, _, k| 200 - k), |_| ()),
        ("tiles of 128", photo(), |o| (o.tiles, o.effort) = (Some(128), 2)),
        ("tiles with a layer", photograph(400, 300), |o| {
            (o.target, o.tiles, o.effort, o.tune) = (Target::Ratio(20.0), Some(256), 2, Some(Tune::Psnr));
        }),
        ("tiles with alpha", with_channels(&photo(), Channels::Rgba), |o| {
            (o.target, o.tiles, o.effort) = (Target::Bytes(1500), Some(128), 1);
        }),
        ("tiles of 300 primitives", photo(), |o| {
            (o.target, o.tiles, o.effort) = (Target::Gaussians(300), Some(128), 1);
        }),
    ]
}

#[test]
fn bytes_are_those_pinned() {
    let mut found = String::new();
    for (name, pixels, set) in cases() {
        let mut options = EncodeOptions::default();
        options.backend = Backend::Cpu;
        set(&mut options);
        let bytes = encode(&pixels, &options).unwrap_or_else(|e| panic!("{name}: {e}")).bytes;
        writeln!(found, "{:>7} {} {name}", bytes.len(), &sha256(&bytes)[..16]).unwrap();
    }
    if std::env::var_os("SSPLAT_PIN").is_some() {
        std::fs::write(PINNED, &found).unwrap();
    }
    let pinned = std::fs::read_to_string(PINNED).unwrap();
    let changed: Vec<_> = found.lines().zip(pinned.lines()).filter(|(found, pinned)| found != pinned).collect();
    let text: String = changed.iter().map(|(found, pinned)| format!("-{pinned}\n+{found}\n")).collect();
    assert!(changed.is_empty() && found.lines().count() == pinned.lines().count(), "bytes have changed:\n{text}");
}
