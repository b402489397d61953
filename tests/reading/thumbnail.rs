//! Guarantees of thumbnails: a file with one keeps its size, and a reader gets the thumbnail or the picture without
//! reading anything else.

use ssplat::unstable::bitstream::header::Header;
use ssplat::unstable::bitstream::{inspect, read, to_bytes};
use ssplat::unstable::metrics::psnr;
use ssplat::unstable::{DecodeOptions, EncodeOptions, decode, encode};
use ssplat::{
    Channels, Decoded, Detail, Error, Limit, Limits, Parameter, Pixels, Reader, Samples, Target, Thumbnail, Tune,
};

/// A picture whose halves differ, with some detail.
fn picture(width: u32, height: u32, channels: Channels) -> Pixels {
    let n = channels.count();
    let value = |x: u32, y: u32, k: usize| match k {
        3 => 255 - (x / 3) as u8 / 2,
        _ => (60 + 90 * (x > width / 2) as u32 + 20 * k as u32 + (x * 7 + y * 13) % 17 + y % 40) as u8,
    };
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let samples = pixels.flat_map(|(x, y)| (0..n).map(move |k| value(x, y, k))).collect();
    Pixels::new(width, height, channels, Samples::U8(samples)).unwrap()
}

fn options(bytes: u64, carried: Thumbnail) -> EncodeOptions {
    let mut options = EncodeOptions::default();
    (options.effort, options.target, options.thumbnail) = (1, Target::Bytes(bytes), carried);
    options
}

/// Renders the picture itself at this size.
fn drawn(bytes: &[u8], size: [u32; 2]) -> Pixels {
    let mut options = DecodeOptions::default();
    options.size = Some(size);
    decode(bytes, &options).unwrap().pixels
}

fn thumbnail(bytes: &[u8], within: [u32; 2], limits: &Limits) -> ssplat::Result<Decoded> {
    Reader::new(bytes, limits)?.thumbnail(within)
}

fn small(bytes: &[u8], side: u32) -> Pixels {
    thumbnail(bytes, [side; 2], &Limits::default()).unwrap().pixels
}

/// Returns the file with other contents in its thumbnail section.
fn with(bytes: &[u8], contents: Vec<u8>) -> Vec<u8> {
    let mut splats = read(bytes, &Limits::default()).unwrap();
    splats.metadata.thumbnail = Some(contents);
    to_bytes(&splats).unwrap()
}

#[test]
fn a_file_with_a_thumbnail_has_the_requested_size_and_both_pictures() {
    for channels in [Channels::Grey, Channels::Rgb, Channels::Rgba] {
        let pixels = picture(500, 300, channels);
        let mut options = options(6000, Thumbnail::Bytes(500));
        (options.icc, options.exif) = (Some(vec![1; 40]), Some(b"II*\0".to_vec()));
        let bytes = encode(&pixels, &options).unwrap().bytes;
        assert!(bytes.len() <= 6000, "{}", bytes.len());
        let carried = Reader::new(&bytes, &Limits::default()).unwrap().metadata().unwrap();
        assert_eq!((&carried.icc, &carried.exif), (&options.icc, &options.exif));
        let file = carried.thumbnail.unwrap();
        assert!(file.len() <= 500 && file.len() > 450, "{}", file.len());
        let whole = decode(&file, &DecodeOptions::default()).unwrap().pixels;
        assert_eq!((whole.width(), whole.height(), whole.channels()), (256, 154, channels));
        // The thumbnail is used up to its size, and shows the picture.
        let shown = thumbnail(&bytes, [256; 2], &Limits::default()).unwrap();
        assert_eq!((shown.pixels, shown.metadata.icc, shown.metadata.exif), (whole, options.icc, options.exif));
        let half = small(&bytes, 128);
        assert_eq!(half, drawn(&file, [128, 77]));
        assert_ne!(half, drawn(&bytes, [128, 77]));
        let off = psnr(&half, &drawn(&bytes, [128, 77])).unwrap();
        assert!(off > 25.0, "{off} dB");
        // Larger sizes are rendered from the picture.
        assert_eq!(small(&bytes, 257), drawn(&bytes, [257, 154]));
        assert_eq!(small(&bytes, 2000), drawn(&bytes, [500, 300]));
    }
}

#[test]
fn small_files_and_small_pictures_have_no_thumbnail_by_default() {
    let sections = |bytes: &[u8]| inspect(bytes, &Limits::default()).unwrap().1.sections.len();
    let pixels = picture(300, 200, Channels::Rgb);
    let without = encode(&pixels, &options(3000, Thumbnail::Never)).unwrap().bytes;
    assert_eq!(encode(&pixels, &options(3000, Thumbnail::Auto)).unwrap().bytes, without);
    // As large as requested, as for files of a hundred thousand bytes and more.
    let large = |side: u32, bytes: u64| {
        let mut options = options(bytes, Thumbnail::Auto);
        options.tune = Some(Tune::Psnr);
        options.time = Some(std::time::Duration::from_secs(1));
        // The layer's section would be counted as well.
        options.detail = Detail::Off;
        encode(&picture(side, 200, Channels::Rgb), &options).unwrap().bytes
    };
    let bytes = large(300, 100_000);
    assert!(bytes.len() <= 100_000, "{}", bytes.len());
    assert_eq!(sections(&bytes), 1);
    let carried = read(&bytes[..], &Limits::default()).unwrap().metadata.thumbnail.unwrap();
    assert!(carried.len() <= 1000, "{}", carried.len());
    assert_eq!(sections(&large(256, 100_000)), 0);
    assert_eq!(sections(&large(300, 99_000)), 0);
}

#[test]
fn a_thumbnail_can_be_requested_with_any_target() {
    let mut options = options(0, Thumbnail::Bytes(200));
    options.target = Target::Gaussians(50);
    let pixels = picture(300, 200, Channels::Rgb);
    let bytes = encode(&pixels, &options).unwrap().bytes;
    let carried = read(&bytes[..], &Limits::default()).unwrap().metadata.thumbnail.unwrap();
    options.thumbnail = Thumbnail::Never;
    let without = encode(&pixels, &options).unwrap().bytes;
    assert_eq!(bytes.len(), without.len() + 1 + 4 + 2 + 4 + carried.len());
    assert_eq!(drawn(&bytes, [300, 200]), drawn(&without, [300, 200]));
}

#[test]
fn an_unusable_thumbnail_is_ignored() {
    let pixels = picture(300, 200, Channels::Rgb);
    let bytes = encode(&pixels, &options(2500, Thumbnail::Bytes(300))).unwrap().bytes;
    let file = read(&bytes[..], &Limits::default()).unwrap().metadata.thumbnail.unwrap();
    let expected = drawn(&bytes, [100, 67]);
    assert_ne!(small(&bytes, 100), expected);
    let mut damaged = bytes.clone();
    let at = bytes.windows(file.len()).position(|w| w == file).unwrap();
    damaged[at + file.len() / 2] ^= 1;
    let shown = thumbnail(&damaged, [100; 2], &Limits::default()).unwrap();
    assert_eq!((shown.pixels, shown.metadata.damaged), (expected.clone(), vec![*b"thmb"]));
    let grey = encode(&picture(300, 200, Channels::Grey), &options(300, Thumbnail::Never)).unwrap().bytes;
    let tiny = encode(&picture(30, 20, Channels::Rgb), &options(300, Thumbnail::Never)).unwrap().bytes;
    for (what, contents) in [
        ("nothing", Vec::new()),
        ("no file", b"not a file".to_vec()),
        ("a file that was cut off", file[..file.len() - 9].to_vec()),
        ("other channels", grey),
        ("too small", tiny),
    ] {
        assert_eq!(small(&with(&bytes, contents), 100), expected, "{what}");
    }
    // Nested thumbnails are not opened.
    let nested = with(&bytes, with(&bytes, with(&bytes, file)));
    assert_eq!(small(&nested, 100), expected);
}

#[test]
fn impossible_thumbnail_requests_are_refused() {
    let pixels = picture(300, 200, Channels::Rgb);
    let failed = |o: &EncodeOptions| match encode(&pixels, o) {
        Err(Error::Parameter { parameter, problem }) => (parameter.name(), problem),
        other => panic!("{other:?}"),
    };
    let (name, problem) = failed(&options(3000, Thumbnail::Bytes(5)));
    assert!(name == "thumbnail" && problem.starts_with("5 bytes"), "{name} {problem}");
    let crowded = encode(&pixels, &options(300, Thumbnail::Bytes(290)));
    assert!(matches!(crowded, Err(Error::TooSmall { allowed: 300, needed: 301.., .. })), "{crowded:?}");
    let bytes = encode(&pixels, &options(2500, Thumbnail::Bytes(300))).unwrap().bytes;
    assert!(matches!(
        thumbnail(&bytes, [0, 9], &Limits::default()),
        Err(Error::Parameter { parameter: Parameter::Width, .. })
    ));
    let mut limits = Limits::default();
    limits.alloc = 100;
    assert!(matches!(thumbnail(&bytes, [100; 2], &limits), Err(Error::LimitExceeded { limit: Limit::Alloc, .. })));
    assert!(matches!(thumbnail(b"GIF89a", [100; 2], &limits), Err(Error::Format(_))));
}

#[test]
fn no_thumbnail_is_rendered_from_a_damaged_header() {
    let pixels = picture(300, 200, Channels::Rgb);
    let bytes = encode(&pixels, &options(2500, Thumbnail::Bytes(300))).unwrap().bytes;
    let rest = {
        let mut rest = &bytes[..];
        Header::read(&mut rest, &Limits::default()).unwrap();
        rest.len()
    };
    for bit in 0..8 * (bytes.len() - rest) {
        let mut hurt = bytes.clone();
        hurt[bit / 8] ^= 1 << (bit % 8);
        let shown = thumbnail(&hurt, [100; 2], &Limits::default());
        assert!(shown.is_err(), "bit {bit}: {:?}", shown.map(|s| [s.pixels.width(), s.pixels.height()]));
    }
}
