//! What the plain decoder promises: parts at any size, and what is left of a damaged file.

use ssplat::{Channels, Damage, DecodeOptions, EncodeOptions, Error, Pixels, Samples, Target, decode, encode};

fn picture() -> Pixels {
    let samples = (0..96 * 64 * 3).map(|i| ((i / 3 % 96) * 2 + (i / 288) * (1 + i % 3)) as u8).collect();
    Pixels::new(96, 64, Channels::Rgb, Samples::U8(samples)).unwrap()
}

fn options() -> EncodeOptions {
    let mut options = EncodeOptions::default();
    options.target = Target::Primitives(120);
    options.effort = 1;
    options
}

#[test]
fn a_region_is_the_part_of_the_whole() {
    let bytes = encode(&picture(), &options()).unwrap().bytes;
    let whole = decode(&bytes, &DecodeOptions::default()).unwrap().pixels;
    let mut of_part = DecodeOptions::default();
    of_part.region = Some([10, 20, 30, 40]);
    let part = decode(&bytes, &of_part).unwrap().pixels;
    let (Samples::U8(whole), Samples::U8(part)) = (whole.samples(), part.samples()) else { panic!("8 bits") };
    for y in 0..40 {
        assert_eq!(part[y * 90..][..90], whole[((y + 20) * 96 + 10) * 3..][..90], "row {y}");
    }
    of_part.size = Some([60, 80]);
    let large = decode(&bytes, &of_part).unwrap().pixels;
    assert_eq!((large.width(), large.height()), (60, 80));
}

#[test]
fn regions_and_sizes_that_cannot_be_are_the_callers_fault() {
    let bytes = encode(&picture(), &options()).unwrap().bytes;
    for region in [[90, 0, 10, 10], [0, 0, 0, 1], [u32::MAX, 0, 2, 2]] {
        let mut options = DecodeOptions::default();
        options.region = Some(region);
        assert!(matches!(decode(&bytes, &options), Err(Error::Parameter { .. })), "{region:?}");
    }
    let mut options = DecodeOptions::default();
    options.size = Some([0, 5]);
    assert!(matches!(decode(&bytes, &options), Err(Error::Parameter { .. })));
}

#[test]
fn a_progressive_file_cut_after_a_level_is_a_coarser_picture() {
    let pixels = picture();
    let mut options = options();
    options.levels = 3;
    let bytes = encode(&pixels, &options).unwrap().bytes;
    let mut accept = DecodeOptions::default();
    accept.damage = Damage::Accept;
    let whole = decode(&bytes, &accept).unwrap();
    assert_eq!((whole.missing.groups, whole.missing.primitives), (0, 0));
    // Every cut gives as many groups as are whole; more bytes never give fewer.
    let mut missing = u32::MAX;
    let mut seen = Vec::new();
    for end in 0..bytes.len() {
        assert!(decode(&bytes[..end], &DecodeOptions::default()).is_err(), "{end} bytes were accepted as a whole file");
        let Ok(part) = decode(&bytes[..end], &accept) else { continue };
        assert!(part.missing.groups <= missing, "at {end} bytes");
        if part.missing.groups < missing {
            seen.push(ssplat::metrics::psnr(&pixels, &part.pixels).unwrap());
        }
        missing = part.missing.groups;
    }
    assert_eq!(seen.len(), 4, "none, one, two and all three levels: {seen:?}");
    assert!(seen.windows(2).all(|w| w[1] > w[0]), "each level adds: {seen:?}");
}

#[test]
fn levels_outside_their_range_are_the_callers_fault() {
    for levels in [0, 9] {
        let mut options = options();
        options.levels = levels;
        assert!(matches!(encode(&picture(), &options), Err(Error::Parameter { name: "levels", .. })));
    }
}
