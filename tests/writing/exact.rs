//! The exact layer: files without loss, whatever the size, the channels and the depth of the picture.

use ssplat::report::SkipReason;
use ssplat::{Channels, Damage, Decoder, Detail, Encoder, HiddenColors, Limits, Pixels, Reader, Rect, Samples};

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
    let opened = Reader::new(&exact(&pixels), &Limits::default()).unwrap().read().unwrap();
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
    let opened = Reader::new(&exact(&pixels), &Limits::default()).unwrap().read().unwrap();
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
    assert_eq!((some.missing.exact_tiles, some.missing.of_exact_tiles), (1, 2));
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
    // The layer and the pixels have 12 MB each.
    limits.alloc = 20 << 20;
    assert!(matches!(Decoder::new().limits(limits).decode(&file), Err(ssplat::Error::LimitExceeded { .. })));
    let mut limits = Limits::default();
    limits.work = 1 << 20;
    assert!(matches!(Decoder::new().limits(limits).decode(&file), Err(ssplat::Error::LimitExceeded { .. })));
}

/// Returns a page: lines of letters in many shades on white, and a photograph below it where `has_photograph`.
fn page([width, height]: [u32; 2], has_photograph: bool) -> Pixels {
    let photograph = image::open(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/images/kodim15.png")).unwrap().into_rgb8();
    let mut state = 1;
    let shades: Vec<u8> = (0..4096).map(|_| (random(&mut state) % 120) as u8).collect();
    let mut samples = Vec::new();
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        if has_photograph && y >= height / 2 {
            samples.extend(photograph.get_pixel(x + 200, y).0);
        } else {
            let glyph = (x / 9 * 31 + y / 16 * 17) % 61;
            let is_ink = x % 9 < 5 && y % 16 < 8 && (x % 9 * 5 + y % 16 * 3 + glyph) % 4 < 2;
            // Letters repeat exactly beside a photograph, and in other shades otherwise.
            let copy = if has_photograph { 0 } else { x / 31 * 7 };
            let shade = shades[(glyph * 64 + y % 16 * 8 + x % 9 + copy) as usize % 4096];
            samples.extend(if is_ink { [shade, shade, shade / 2 + 20] } else { [255; 3] });
        }
    }
    Pixels::new(width, height, Channels::Rgb, Samples::U8(samples)).unwrap()
}

fn bytes_of(pixels: &Pixels) -> &[u8] {
    let Samples::U8(samples) = pixels.samples() else { panic!("8 bits") };
    samples
}

#[test]
fn a_page_that_fits_is_stored_without_loss_whatever_is_requested() {
    let pixels = page([200, 120], false);
    let size = exact(&pixels).len() as u64;
    let encode = |encoder: Encoder| encoder.effort(1).encode(&pixels).unwrap();
    for encoder in [Encoder::new().bytes(size), Encoder::new().ratio(200.0 * 120.0 * 3.0 / (size as f64 + 0.5))] {
        let encoded = encode(encoder);
        assert!(encoded.bytes == exact(&pixels) && encoded.report.psnr.is_infinite());
        assert!(encoded.report.skipped.iter().any(|l| l.what == SkipReason::Loss));
    }
    // A byte less is not enough.
    let less = encode(Encoder::new().bytes(size - 1));
    assert!(less.bytes.len() < size as usize && less.report.psnr.is_finite());
    // Without the layer, as requested.
    assert!(encode(Encoder::new().bytes(size).detail(Detail::Off)).report.gaussians > 0);
}

#[test]
fn colours_of_a_page_that_does_not_fit_are_near_and_its_ground_is_exact() {
    let pixels = page([240, 200], false);
    let size = exact(&pixels).len() as u64;
    for share in [0.8, 0.6] {
        let most = (share * size as f64) as u64;
        let encoded = Encoder::new().bytes(most).effort(1).encode(&pixels).unwrap();
        assert!(encoded.bytes.len() as u64 <= most && encoded.report.gaussians == 0);
        assert!(encoded.report.skipped.iter().any(|l| l.what == SkipReason::NearColors));
        let decoded = Decoder::new().decode(&encoded.bytes).unwrap().pixels;
        for (own, other) in bytes_of(&pixels).iter().zip(bytes_of(&decoded)) {
            // 48 is the largest tolerance.
            assert!(own.abs_diff(*other) <= 48 && (*own == 255) == (*other == 255), "{own} {other}");
        }
        assert!(encoded.report.psnr > 30.0, "{}", encoded.report.psnr);
    }
}

#[test]
fn a_photograph_in_a_page_is_left_to_gaussians_and_the_detail_layer() {
    let pixels = page([320, 400], true);
    let encoded = Encoder::new().ratio(40.0).effort(2).encode(&pixels).unwrap();
    assert!(encoded.bytes.len() <= 320 * 400 * 3 / 40 && encoded.report.gaussians > 0);
    let splats = ssplat::unstable::bitstream::read(&encoded.bytes[..], &Limits::default()).unwrap();
    let covered = splats.exact.as_ref().expect("an exact layer").covered([320, 400]);
    // Half of the page, give or take a row of cells.
    assert!((320 * 184..=320 * 216).contains(&covered), "{covered} pixels");
    let decoded = Decoder::new().decode(&encoded.bytes).unwrap().pixels;
    let letters = 320 * 176 * 3;
    let near = |(own, other): (&u8, &u8)| own.abs_diff(*other) <= 48;
    assert!(bytes_of(&pixels)[..letters].iter().zip(bytes_of(&decoded)).all(near));
    // The same bytes without the layer.
    let without = Encoder::new().bytes(encoded.bytes.len() as u64).effort(2).detail(Detail::GaussianShare(0.4));
    let without = without.encode(&pixels).unwrap().report.psnr;
    assert!(encoded.report.psnr > without + 3.0, "{} dB, without the layer {without}", encoded.report.psnr);
}

/// Returns a page and a photograph with a transparent margin in which colours are hidden.
fn cut_out(size: [u32; 2]) -> Pixels {
    let [width, height] = size;
    let opaque = page(size, true);
    let mut samples = Vec::new();
    for (at, pixel) in (0u32..).zip(bytes_of(&opaque).chunks_exact(3)) {
        let [x, y] = [at % width, at / width];
        let is_hidden = x < 24 || y < 24 || x >= width - 24 || y >= height - 24;
        samples.extend(if is_hidden {
            [(x * 7) as u8, (y * 11) as u8, (x * y) as u8]
        } else {
            [pixel[0], pixel[1], pixel[2]]
        });
        samples.push(if is_hidden { 0 } else { 255 });
    }
    Pixels::new(width, height, Channels::Rgba, Samples::U8(samples)).unwrap()
}

#[test]
fn a_photograph_in_a_page_with_alpha_is_left_to_gaussians_and_the_detail_layer() {
    let size = [320, 400];
    let pixels = cut_out(size);
    let encoded = Encoder::new().ratio(60.0).effort(1).encode(&pixels).unwrap();
    assert!(encoded.bytes.len() <= 320 * 400 * 4 / 60 && encoded.report.gaussians > 0);
    let splats = ssplat::unstable::bitstream::read(&encoded.bytes[..], &Limits::default()).unwrap();
    let covered = splats.exact.as_ref().expect("an exact layer").covered(size);
    // The photograph is 272 pixels wide and 176 high.
    assert!((320 * 400 - 304 * 208..=320 * 400 - 240 * 144).contains(&covered), "{covered} pixels");
    let decoded = Decoder::new().decode(&encoded.bytes).unwrap().pixels;
    for (own, other) in bytes_of(&pixels).chunks_exact(4).zip(bytes_of(&decoded).chunks_exact(4)) {
        assert!(own[3].abs_diff(other[3]) <= 8, "{own:?} became {other:?}");
    }
    let without = Encoder::new().bytes(encoded.bytes.len() as u64).effort(1).detail(Detail::GaussianShare(0.4));
    let without = without.encode(&pixels).unwrap().report.psnr;
    assert!(encoded.report.psnr > without + 3.0, "{} dB, without the layer {without}", encoded.report.psnr);
}

/// Returns a dithered gradient with cards of letters, as browsers draw them.
fn cards([width, height]: [u32; 2]) -> Pixels {
    let letters = page([width, height], false);
    let mut samples = bytes_of(&letters).to_vec();
    for (at, pixel) in (0u32..).zip(samples.chunks_exact_mut(3)) {
        let [x, y] = [at % width, at / width];
        if y % 100 < 60 || !(40..width - 40).contains(&x) {
            let threshold = (x % 4 * 5 + y % 4 * 7) % 16;
            let level = |slope: u32| ((2400 + (x + 2 * y) * slope / 8 + threshold) / 16) as u8;
            pixel.copy_from_slice(&[level(5), level(7), level(10)]);
        }
    }
    Pixels::new(width, height, Channels::Rgb, Samples::U8(samples)).unwrap()
}

#[test]
fn letters_beside_a_dithered_gradient_have_the_exact_layer() {
    let size = [400, 300];
    let pixels = cards(size);
    let encoded = Encoder::new().ratio(60.0).effort(1).encode(&pixels).unwrap();
    let splats = ssplat::unstable::bitstream::read(&encoded.bytes[..], &Limits::default()).unwrap();
    let layer = splats.exact.as_ref().expect("an exact layer");
    // Whether a cell in the middle of the first card is covered, and that there is one for every 64 pixels.
    let cells = layer.cells(size);
    assert!(cells[(80 / 8) * 50 + 200 / 8] && cells.len() == 50 * 38);
    let decoded = Decoder::new().decode(&encoded.bytes).unwrap().pixels;
    let ground = |pixels: &Pixels| {
        let at = (85 * 400 + 60) * 3;
        bytes_of(pixels)[at..][..3].to_vec()
    };
    assert_eq!(ground(&decoded), ground(&pixels));
    let without = Encoder::new().bytes(encoded.bytes.len() as u64).effort(1).detail(Detail::GaussianShare(0.4));
    let without = without.encode(&pixels).unwrap().report.psnr;
    assert!(encoded.report.psnr > without + 3.0, "{} dB, without the layer {without}", encoded.report.psnr);
}

#[test]
fn a_psnr_that_near_colours_reach_takes_fewer_bytes_than_no_loss() {
    let pixels = page([240, 200], false);
    let encoded = Encoder::new().psnr(40.0).effort(1).encode(&pixels).unwrap();
    assert!(encoded.report.psnr >= 40.0 && encoded.bytes.len() < exact(&pixels).len());
    let all = Encoder::new().psnr(99.0).effort(1).encode(&pixels).unwrap();
    assert!(all.bytes.len() <= exact(&pixels).len());
}

/// Returns letters on paper with noise in all channels, in a depth of `bits` bits.
fn scan([width, height]: [u32; 2], channels: Channels, bits: u32) -> Pixels {
    let mut state = 3;
    let mut samples = Vec::new();
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let glyph = (x / 9 * 31 + y / 16 * 17) % 61;
        let is_ink = x % 9 < 5 && y % 16 < 8 && (x % 9 * 5 + y % 16 * 3 + glyph) % 4 < 2;
        for _ in 0..channels.count() {
            // About a normal distribution.
            let noise: u64 = (0..4).map(|_| random(&mut state) % 4).sum();
            samples.push(if is_ink { 30 } else { 230 } + noise as u16);
        }
    }
    let samples = match bits {
        8 => Samples::U8(samples.iter().map(|&v| v as u8).collect()),
        _ => Samples::U16(samples.iter().map(|&v| v * 257 + v % 7).collect()),
    };
    Pixels::new(width, height, channels, samples).unwrap()
}

#[test]
fn letters_on_paper_with_noise_stay_sharp_in_small_files() {
    for (channels, bits) in [(Channels::Grey, 8), (Channels::Grey, 16), (Channels::Rgb, 8), (Channels::Rgb, 16)] {
        let pixels = scan([240, 200], channels, bits);
        let encode = |encoder: Encoder| encoder.ratio(60.0).effort(1).encode(&pixels).unwrap().report;
        let (own, without) = (encode(Encoder::new()), encode(Encoder::new().detail(Detail::GaussianShare(0.4))));
        let what = format!("{channels:?}, {bits} bits: {} dB, without the layer {}", own.psnr, without.psnr);
        assert!(own.gaussians == 0 && own.psnr > without.psnr + 5.0, "{what}");
        assert!(own.skipped.iter().any(|l| l.what == SkipReason::NearColors), "{what}");
    }
    // A quality that needs the noise has it.
    let noisy = Encoder::new().psnr(45.0).effort(1).encode(&scan([80, 60], Channels::Grey, 8)).unwrap();
    assert!(noisy.report.psnr >= 45.0);
}
