//! AVIF as an input: pixels of 8 and 10 bits, subsampled chroma, both ranges, alpha, rotation, reflection, profiles and
//! metadata, and files that were damaged.
//!
//! The files in `avif/` were made of a picture of ramps, 64 × 48 pixels, with `-s 8 -y 444 --min 0 --max 10`: of 8 bits
//! (`rgb`, `rgba`), with `-d 10` (`rgb-10`, `rgba-10`), `-y 400` (`grey`), `--irot 1` (`turned`), `--imir 0` (`mirrored`),
//! and `--icc` (`icc`) by `avifenc` 0.11.1. `rgb-420` (`range="limited"`), `rgb-422` and `premultiplied`
//! (`alpha_premultiplied=True`) are by libavif in Pillow 12, at qualities of 95 and 100; `metadata`, with an EXIF block of an
//! artist and an XMP block, and `animated`, of two frames, as well. `large` is a grey of 16385 × 8193
//! pixels.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::DynamicImage;
use image::metadata::Orientation;
use ssplat::{Channels, Depth};
use ssplat_cli::failure::{Failure, Kind};
use ssplat_cli::input::Input;
use ssplat_cli::source::{self, Reading, Source, Turn};

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/avif").join(name)
}

fn open(name: &str, turn: Turn) -> Source {
    source::open(&path(name), turn).unwrap_or_else(|e| panic!("{name}: {}", e.message))
}

fn read(bytes: Vec<u8>) -> Result<Source, Failure> {
    source::read(Path::new("a.avif"), Input::Memory(Cursor::new(bytes)), &Reading::turned(Turn::Keep))
}

/// The picture that the files were made of: red, green, blue and alpha at a place.
fn ramps(x: u32, y: u32) -> [u8; 4] {
    [x as u8 * 4, y as u8 * 5, (x + y) as u8 * 2, 255 - x as u8 * 2]
}

/// Returns the largest difference from the picture that the files were made of, of 255; `at` gives the place that is seen at
/// a place.
fn difference(source: Source, at: impl Fn(u32, u32) -> (u32, u32)) -> u8 {
    let picture = DynamicImage::from(source.pixels);
    let (has_alpha, is_grey) = (picture.color().has_alpha(), !picture.color().has_color());
    let samples = picture.into_rgba8();
    let differences = samples.enumerate_pixels().flat_map(|(x, y, seen)| {
        let (x, y) = at(x, y);
        let mut made = ramps(x, y);
        if is_grey {
            made = [made[0], made[0], made[0], made[3]];
        }
        if !has_alpha {
            made[3] = 255;
        }
        [0, 1, 2, 3].map(|k| made[k].abs_diff(seen.0[k]))
    });
    differences.max().unwrap()
}

#[test]
fn files_have_their_own_channels_and_depth_and_the_pixels_that_they_were_made_of() {
    for (name, channels, depth) in [
        ("rgb.avif", Channels::Rgb, Depth::Eight),
        ("rgb-420.avif", Channels::Rgb, Depth::Eight),
        ("rgb-422.avif", Channels::Rgb, Depth::Eight),
        ("rgb-10.avif", Channels::Rgb, Depth::Sixteen),
        ("rgba.avif", Channels::Rgba, Depth::Eight),
        ("premultiplied.avif", Channels::Rgba, Depth::Eight),
        ("rgba-10.avif", Channels::Rgba, Depth::Sixteen),
        ("grey.avif", Channels::Grey, Depth::Eight),
        ("icc.avif", Channels::Rgb, Depth::Eight),
    ] {
        let source = open(name, Turn::Keep);
        let pixels = &source.pixels;
        assert_eq!(
            (pixels.width(), pixels.height(), pixels.channels(), pixels.depth()),
            (64, 48, channels, depth),
            "{name}"
        );
        // The others have a profile of the code points of sRGB.
        let bytes = fs::read(path(name)).unwrap();
        let is_own = source.icc.as_ref().is_some_and(|icc| bytes.windows(icc.len()).any(|part| part == icc));
        assert_eq!(is_own, name == "icc.avif", "{name}");
        assert_eq!(source.orientation, Orientation::NoTransforms, "{name}");
        let off = difference(source, |x, y| (x, y));
        assert!(off <= 8, "{name}: {off}");
    }
}

/// The bytes of a file with another matrix and range in its box `colr`.
fn with_matrix(name: &str, matrix: u8, is_full_range: bool) -> Vec<u8> {
    let mut bytes = fs::read(path(name)).unwrap();
    let at = bytes.windows(8).position(|word| word == b"colrnclx").unwrap() + 8;
    (bytes[at + 5], bytes[at + 6]) = (matrix, u8::from(is_full_range) << 7);
    bytes
}

/// Returns red, green and blue of a pixel.
fn pixel(bytes: Vec<u8>, x: u32, y: u32) -> [f64; 3] {
    let source = read(bytes).unwrap_or_else(|e| panic!("{}", e.message));
    DynamicImage::from(source.pixels).into_rgb8().get_pixel(x, y).0.map(f64::from)
}

#[test]
fn matrix_and_range_of_the_box_are_those_of_h_273() {
    for (x, y) in [(5, 7), (40, 20), (60, 40)] {
        // The planes are green, blue and red under the identity, and therefore known from its pixels.
        let [cr, luma, cb] = pixel(with_matrix("rgb.avif", 0, true), x, y);
        for (matrix, red, blue) in [(1, 0.2126, 0.0722), (6, 0.299, 0.114), (9, 0.2627, 0.0593)] {
            for is_full in [false, true] {
                // ITU-T H.273, 8.3, with 8 bits.
                let (y_, cb_, cr_) = if is_full {
                    (luma / 255.0, (cb - 128.0) / 255.0, (cr - 128.0) / 255.0)
                } else {
                    ((luma - 16.0) / 219.0, (cb - 128.0) / 224.0, (cr - 128.0) / 224.0)
                };
                let (r, b) = (y_ + 2.0 * (1.0 - red) * cr_, y_ + 2.0 * (1.0 - blue) * cb_);
                let g = (y_ - red * r - blue * b) / (1.0 - red - blue);
                let expected = [r, g, b].map(|v| (255.0 * v).clamp(0.0, 255.0));
                let seen = pixel(with_matrix("rgb.avif", matrix, is_full), x, y);
                for (seen, expected) in seen.iter().zip(expected) {
                    // Half a code value by rounding, and f32.
                    assert!((seen - expected).abs() < 0.51, "{matrix} {is_full} {x},{y}: {seen} {expected}");
                }
            }
        }
    }
    for (name, matrix) in [("rgb.avif", 14), ("rgb-420.avif", 0)] {
        let refused = read(with_matrix(name, matrix, true)).err().expect("the matrix is refused");
        assert_eq!(refused.kind, Kind::Unsupported);
        assert!(refused.message.contains(&format!("matrix of colours, {matrix} ")), "{}", refused.message);
    }
}

/// The bytes of a file with other colour primaries and transfer characteristics in its box `colr`.
fn with_code_points(name: &str, primaries: u8, transfer: u8) -> Vec<u8> {
    let mut bytes = fs::read(path(name)).unwrap();
    let at = bytes.windows(8).position(|word| word == b"colrnclx").unwrap() + 8;
    (bytes[at + 1], bytes[at + 3]) = (primaries, transfer);
    bytes
}

#[test]
fn code_points_are_kept_or_become_a_profile() {
    assert_eq!(open("rgb-10.avif", Turn::Keep).cicp, None);
    let hdr = read(with_code_points("rgb-10.avif", 9, 16)).unwrap();
    assert_eq!((hdr.cicp, hdr.icc), (Some(ssplat::Cicp::BT2100_PQ), None));
    let p3 = read(with_code_points("rgb.avif", 12, 13)).unwrap();
    assert!(p3.cicp.is_none() && p3.icc.is_some());
}

#[test]
fn rotation_and_reflection_become_the_orientation() {
    assert_eq!(open("turned.avif", Turn::Keep).orientation, Orientation::Rotate270);
    let upright = open("turned.avif", Turn::Upright);
    assert_eq!((upright.pixels.width(), upright.pixels.height()), (48, 64));
    // A quarter of a turn anticlockwise: the top row was the right column.
    let off = difference(upright, |x, y| (63 - y, x));
    assert!(off <= 8, "{off}");
    // Top and bottom are exchanged.
    assert_eq!(open("mirrored.avif", Turn::Keep).orientation, Orientation::FlipVertical);
    let off = difference(open("mirrored.avif", Turn::Upright), |x, y| (x, 47 - y));
    assert!(off <= 8, "{off}");
    let mut bytes = fs::read(path("mirrored.avif")).unwrap();
    let at = bytes.windows(4).position(|word| word == b"imir").unwrap() + 4;
    bytes[at] ^= 1;
    assert_eq!(read(bytes).unwrap().orientation, Orientation::FlipHorizontal);
}

/// Returns `metadata.avif` after `change` of the bytes from the first `word` on.
fn with_metadata(word: &[u8], change: impl Fn(&mut [u8])) -> Source {
    let mut bytes = fs::read(path("metadata.avif")).unwrap();
    let at = bytes.windows(word.len()).position(|found| found == word).unwrap();
    change(&mut bytes[at..]);
    read(bytes).unwrap()
}

#[test]
fn exif_is_kept_and_what_is_left_out_is_told() {
    let xmp = "its XMP block is left out";
    let found = open("metadata.avif", Turn::Keep);
    let exif = found.exif.unwrap();
    assert!(exif.starts_with(b"MM\0*") || exif.starts_with(b"II*\0"), "{exif:?}");
    assert!(exif.windows(14).any(|bytes| bytes == b"Test of ssplat"));
    assert_eq!(found.notes, [xmp]);
    let broken = with_metadata(b"Test of", |bytes| bytes[..7].fill(0xff));
    assert_eq!(broken.notes, [xmp], "text of any bytes is no damage");
    let broken = with_metadata(b"MM\0*", |bytes| bytes[..4].fill(0));
    assert_eq!((broken.exif, broken.notes.len()), (None, 2));
    assert!(broken.notes[0].starts_with("its EXIF block is damaged and left out: "), "{}", broken.notes[0]);
    let with_gain_map = with_metadata(b"Exif", |bytes| bytes[..4].copy_from_slice(b"tmap"));
    assert_eq!(with_gain_map.exif, None);
    assert_eq!(with_gain_map.notes, [xmp, "its gain map is left out; the picture is its base"]);
}

#[test]
fn the_first_frame_of_an_animation_is_read_and_the_others_are_told() {
    let found = open("animated.avif", Turn::Keep);
    assert_eq!(found.notes, ["only the first of its frames or pages is used"]);
    let off = difference(found, |x, y| (x, y));
    assert!(off <= 40, "{off}");
}

#[test]
fn files_of_kinds_that_are_not_read_are_refused_as_such() {
    let mut grid = fs::read(path("metadata.avif")).unwrap();
    let kind = grid.windows(9).position(|found| found == b"av01Color").unwrap();
    grid[kind..kind + 4].copy_from_slice(b"grid");
    let failure = read(grid).err().expect("a grid is refused");
    assert_eq!(failure.kind, Kind::Unsupported, "{}", failure.message);
    assert!(failure.message.starts_with("a.avif: is a grid of pictures, is cropped, or"), "{}", failure.message);
}

#[test]
fn damaged_files_are_errors_and_none_takes_forever() {
    let whole = fs::read(path("rgba.avif")).unwrap();
    let data = whole.windows(4).position(|word| word == b"mdat").unwrap() + 4;
    for length in [12, 40, 200, data, data + 9, whole.len() - 1] {
        let failure = read(whole[..length].to_vec()).err().unwrap_or_else(|| panic!("{length} bytes are read"));
        assert_eq!(failure.kind, Kind::Format, "{length}: {}", failure.message);
    }
    // Data without a picture: zeros, and temporal delimiters alone.
    for filler in [[0, 0], [0x12, 0]] {
        let mut bytes = whole.clone();
        bytes[data..].iter_mut().zip(filler.into_iter().cycle()).for_each(|(byte, with)| *byte = with);
        assert_eq!(read(bytes).err().map(|e| e.kind), Some(Kind::Format), "{filler:?}");
    }
    // A box that states more bytes than any memory has.
    let mut bytes = whole[..data - 8].to_vec();
    bytes.extend([0, 0, 0, 1, b'm', b'd', b'a', b't', 0, 0, 0x40, 0, 0, 0, 0, 0]);
    bytes.extend(&whole[data..]);
    assert!(read(bytes).is_err());
    // Each byte of the boxes, and of the EXIF block after them, changed.
    for (whole, end) in [(whole, data), (fs::read(path("metadata.avif")).unwrap(), 0x1d0)] {
        for at in 0..end {
            for with in [0, 0xff, whole[at] ^ 1] {
                let mut bytes = whole.clone();
                bytes[at] = with;
                let _ = read(bytes);
            }
        }
    }
}

#[test]
fn a_picture_beyond_the_limit_is_refused_before_it_is_decoded() {
    let refused = source::open(&path("large.avif"), Turn::Keep).err().expect("134 megapixels are refused");
    assert_eq!(
        (refused.kind, refused.message.contains("134217728 pixels")),
        (Kind::Limit, true),
        "{}",
        refused.message
    );
}
