//! The exact layer: files without loss, whatever the size, the channels and the depth of the picture.
#![cfg(feature = "unstable")]

use ssplat::{Channels, Damage, Decoder, Encoder, HiddenColors, Limits, Pixels, Reader, Rect, Samples};

const CHANNELS: [Channels; 4] = [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba];

/// Kinds of pictures.
const KINDS: [&str; 4] = ["flat", "noise", "text", "smooth"];

fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    *state >> 33
}

/// Returns a picture of one of the [`KINDS`].
fn picture(kind: &str, [width, height]: [u32; 2], channels: Channels, bits: u32) -> Pixels {
    let mut state = u64::from(width * 31 + height);
    let top = (1u32 << bits) - 1;
    let mut samples = Vec::new();
    for y in 0..height {
        for x in 0..width {
            for k in 0..channels.count() as u32 {
                samples.push(match kind {
                    "flat" => top / (k + 1),
                    "noise" => random(&mut state) as u32 & top,
                    // Glyphs that repeat, on flat ground.
                    "text" => match (x % 7 * 3 + y % 9 * 5 + x / 7 % 3) % 11 {
                        0..3 if y % 9 < 6 => top / 5 * k,
                        3 if y % 9 < 6 => top / 3,
                        _ => top,
                    },
                    _ => (x * 5 + y * 3 + k * 40 + random(&mut state) as u32 % 3) & top,
                });
            }
        }
    }
    let samples = match bits {
        8 => Samples::U8(samples.iter().map(|&v| v as u8).collect()),
        _ => Samples::U16(samples.iter().map(|&v| v as u16).collect()),
    };
    Pixels::new(width, height, channels, samples).unwrap()
}

fn exact(pixels: &Pixels) -> Vec<u8> {
    Encoder::new().lossless().hidden_colors(HiddenColors::Keep).encode(pixels).unwrap().bytes
}

#[test]
fn every_sample_returns() {
    for size in [[1, 1], [2, 1], [1, 3], [9, 8], [40, 33], [70, 3]] {
        for channels in CHANNELS {
            for bits in [8, 16] {
                for kind in KINDS {
                    let pixels = picture(kind, size, channels, bits);
                    let file = exact(&pixels);
                    let decoded = Decoder::new().decode(&file).unwrap().pixels;
                    assert!(decoded == pixels, "{kind} {size:?} {channels:?} {bits}");
                }
            }
        }
    }
}

#[test]
fn several_tiles_and_their_regions_return() {
    // Noise is stored in tiles of 512 pixels.
    let pixels = picture("noise", [530, 24], Channels::Grey, 8);
    let file = exact(&pixels);
    assert_eq!(Decoder::new().decode(&file).unwrap().pixels, pixels);
    let (Samples::U8(all), region) = (pixels.samples(), Rect::new(500, 5, 25, 10)) else { unreachable!() };
    let Samples::U8(part) = Decoder::new().region(region).decode(&file).unwrap().pixels.into_samples() else {
        panic!("8 bits")
    };
    for y in 0..10 {
        assert_eq!(part[y * 25..][..25], all[(5 + y) * 530 + 500..][..25]);
    }
}

#[test]
fn the_image_crate_reads_the_same_samples() {
    ssplat::register();
    for channels in CHANNELS {
        for bits in [8, 16] {
            let pixels = picture("text", [21, 17], channels, bits);
            let read = image::load_from_memory(&exact(&pixels)).unwrap();
            let bytes: Vec<u8> = match pixels.samples() {
                Samples::U8(v) => v.clone(),
                Samples::U16(v) => v.iter().flat_map(|v| v.to_ne_bytes()).collect(),
            };
            assert_eq!(read.as_bytes(), bytes, "{channels:?} {bits}");
        }
    }
}

#[test]
fn flat_ground_takes_next_to_no_bytes() {
    let small = exact(&picture("flat", [8, 8], Channels::Rgb, 8)).len();
    let large = exact(&picture("flat", [800, 600], Channels::Rgb, 8)).len();
    assert!(large <= small + 40, "{small} and {large}");
}

#[test]
fn hidden_colors_become_black_unless_they_are_kept() {
    let pixels = Pixels::new(2, 1, Channels::Rgba, Samples::U8(vec![10, 20, 30, 0, 40, 50, 60, 1])).unwrap();
    let bytes = Encoder::new().lossless().encode(&pixels).unwrap().bytes;
    let decoded = Decoder::new().decode(&bytes).unwrap().pixels;
    assert_eq!(decoded.samples(), &Samples::U8(vec![0, 0, 0, 0, 40, 50, 60, 1]));
    assert_eq!(Decoder::new().decode(&exact(&pixels)).unwrap().pixels, pixels);
}

#[test]
fn enlarged_pixels_have_sharp_edges() {
    let pixels = picture("text", [20, 11], Channels::Rgba, 8);
    let opened = Reader::new(&exact(&pixels), &Limits::default()).unwrap().read(Damage::Refuse).unwrap();
    let Samples::U8(all) = pixels.samples() else { unreachable!() };
    for factor in [2, 3, 7] {
        let view = opened.view().resized(20 * factor, 11 * factor).unwrap();
        let Samples::U8(large) = opened.render(&view).unwrap().into_samples() else { panic!("8 bits") };
        for (i, pixel) in large.chunks_exact(4).enumerate() {
            let (x, y) = (i as u32 % (20 * factor) / factor, i as u32 / (20 * factor) / factor);
            assert_eq!(pixel, &all[(y * 20 + x) as usize * 4..][..4], "{factor}: {i}");
        }
    }
}

#[test]
fn halves_are_the_means_of_four_pixels() {
    let pixels = picture("noise", [10, 6], Channels::Grey, 8);
    let opened = Reader::new(&exact(&pixels), &Limits::default()).unwrap().read(Damage::Refuse).unwrap();
    let view = opened.view().resized(5, 3).unwrap();
    let (Samples::U8(all), Samples::U8(half)) = (pixels.samples(), opened.render(&view).unwrap().into_samples()) else {
        panic!("8 bits")
    };
    for (i, &v) in half.iter().enumerate() {
        let at = i / 5 * 20 + i % 5 * 2;
        let sum: u32 = [0, 1, 10, 11].iter().map(|&k| u32::from(all[at + k])).sum();
        assert!(u32::from(v).abs_diff((sum + 2) / 4) <= 1, "{i}: {v}, {sum}");
    }
}

#[test]
fn truncated_files_are_errors_and_keep_their_intact_tiles() {
    let pixels = picture("noise", [600, 20], Channels::Grey, 8);
    let file = exact(&pixels);
    let whole = file.len();
    for length in (0..120).chain((120..whole).step_by(997)).chain(whole - 8..whole) {
        assert!(Decoder::new().decode(&file[..length]).is_err(), "{length}");
        let some = Decoder::new().damage(Damage::Accept).decode(&file[..length]);
        if let Ok(some) = some {
            assert!(
                some.missing.damaged && some.missing.tiles <= some.missing.of_tiles,
                "{length}: {:?}",
                some.missing
            );
        }
    }
    // The end of the second tile is missing.
    let some = Decoder::new().damage(Damage::Accept).decode(&file[..whole - 100]).unwrap();
    assert_eq!((some.missing.tiles, some.missing.of_tiles), (1, 2));
    let (Samples::U8(all), Samples::U8(found)) = (pixels.samples(), some.pixels.samples()) else { panic!("8 bits") };
    for y in 0..20 {
        assert_eq!(all[y * 600..][..512], found[y * 600..][..512]);
        assert_ne!(all[y * 600 + 512..][..88], found[y * 600 + 512..][..88]);
    }
}

#[test]
fn flipped_bits_are_errors() {
    let pixels = picture("text", [40, 12], Channels::Rgb, 8);
    let file = exact(&pixels);
    for bit in 0..8 * file.len() {
        let mut damaged = file.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        let read = Decoder::new().decode(&damaged);
        assert!(read.is_err(), "bit {bit}");
        // Intact parts are read or refused, but never invented.
        let _ = Decoder::new().damage(Damage::Accept).decode(&damaged);
    }
}

#[test]
fn limits_hold_before_memory_is_allocated() {
    let file = exact(&picture("flat", [2000, 2000], Channels::Rgb, 8));
    let mut limits = Limits::default();
    limits.alloc = 20 << 20;
    assert!(matches!(Decoder::new().limits(limits).decode(&file), Err(ssplat::Error::LimitExceeded { .. })));
    let mut limits = Limits::default();
    limits.work = 1 << 20;
    assert!(matches!(Decoder::new().limits(limits).decode(&file), Err(ssplat::Error::LimitExceeded { .. })));
}
