//! Inputs on which an earlier version failed: profiles that expand, kinds of pictures that were read wrongly or refused
//! without advice, and outputs that replaced inputs. `docs/studies/finds.md` lists them.

use std::ffi::OsStr;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::folder::Folder;
use image::metadata::Orientation;
use image::{DynamicImage, GenericImageView, ImageEncoder, ImageFormat, Rgb, RgbImage};
use ssplat::{Channels, Pixels, Samples};
use ssplat_cli::source::{self, Source, Turn};

fn ssplat<S: AsRef<OsStr>>(args: &[S]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ssplat")).args(args.iter().map(AsRef::as_ref)).output().unwrap()
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Runs the program, which must end with `status`. Returns what it said.
fn ends<S: AsRef<OsStr>>(status: i32, args: &[S]) -> String {
    let found = ssplat(args);
    assert_eq!(found.status.code(), Some(status), "{}", told(&found));
    told(&found) + &String::from_utf8_lossy(&found.stdout)
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn find(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/finds").join(name)
}

fn open(path: &Path) -> Source {
    source::open(path, Turn::Keep).unwrap_or_else(|e| panic!("{}: {}", path.display(), e.message))
}

/// Encodes in little time.
fn encode(input: &Path, output: &Path, more: &[&str]) -> Output {
    let args = ["encode", text(input), text(output), "--effort", "1", "--bytes", "3000"];
    ssplat(&[&args[..], more].concat())
}

fn encoded(input: &Path, output: &Path, more: &[&str]) -> String {
    let found = encode(input, output, more);
    assert!(found.status.success(), "{}", told(&found));
    told(&found)
}

fn profile_in(file: &Path) -> Option<Vec<u8>> {
    let bytes = fs::read(file).unwrap();
    let opened = ssplat::Reader::new(&bytes, &ssplat::Limits::default()).unwrap().read().unwrap();
    opened.metadata().icc.clone()
}

fn picture() -> RgbImage {
    RgbImage::from_fn(48, 40, |x, y| Rgb([x as u8 * 5, y as u8 * 6, 90]))
}

fn file_of(format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    DynamicImage::from(picture()).write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// Computes a CRC-32.
fn crc(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| if crc & 1 != 0 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 };
    !bytes.iter().fold(!0, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), step))
}

fn chunk(name: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let body = [&name[..], data].concat();
    [&(data.len() as u32).to_be_bytes()[..], &body, &crc(&body).to_be_bytes()].concat()
}

/// Returns a PNG with `chunks` behind its header.
fn png_with(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
    let png = file_of(ImageFormat::Png);
    let chunks: Vec<u8> = chunks.iter().flat_map(|(name, data)| chunk(name, data)).collect();
    [&png[..33], &chunks, &png[33..]].concat()
}

/// Bits of a deflate stream.
#[derive(Default)]
struct Bits(Vec<u8>, u32);

impl Bits {
    fn put(&mut self, value: u32, count: u32) {
        for k in 0..count {
            if self.1.is_multiple_of(8) {
                self.0.push(0);
            }
            *self.0.last_mut().unwrap() |= ((value >> k & 1) as u8) << (self.1 % 8);
            self.1 += 1;
        }
    }
}

/// Returns a zlib stream of the header of a profile for `space` and of zeros, `length` bytes in all, in a thousandth of
/// them.
fn packed_profile(space: &[u8; 4], length: usize) -> Vec<u8> {
    let profile = profile(space, 160);
    let mut bits = Bits::default();
    // One block with fixed codes, whose bits are stored from the highest.
    bits.put(0b011, 3);
    let literal = |bits: &mut Bits, byte: u8| match byte {
        0..=143 => bits.put((0x30 + u32::from(byte)).reverse_bits() >> 24, 8),
        byte => bits.put((0x190 + u32::from(byte) - 144).reverse_bits() >> 23, 9),
    };
    profile.iter().for_each(|&byte| literal(&mut bits, byte));
    // The length 258 (code 285, 8 bits) at a distance of one.
    for _ in 0..(length - profile.len()) / 258 {
        bits.put((0xC0u32 + 285 - 280).reverse_bits() >> 24, 8);
        bits.put(0, 5);
    }
    bits.put(0, 7);
    // Adler-32.
    let zeros = (length - profile.len()) / 258 * 258;
    let add = |(a, b): (u32, u32), &byte: &u8| ((a + u32::from(byte)) % 65521, (a + u32::from(byte) + b) % 65521);
    let (a, b) = profile.iter().chain(std::iter::repeat_n(&0, zeros)).fold((1, 0), add);
    [&[0x78, 0x9C][..], &bits.0, &(b << 16 | a).to_be_bytes()].concat()
}

/// Returns the start of a profile for a colour space, `length` bytes long.
fn profile(space: &[u8; 4], length: usize) -> Vec<u8> {
    let mut profile = vec![0; length];
    profile[..4].copy_from_slice(&(length as u32).to_be_bytes());
    profile[8] = 4;
    profile[12..16].copy_from_slice(b"mntr");
    profile[16..20].copy_from_slice(space);
    profile[20..24].copy_from_slice(b"XYZ ");
    profile[36..40].copy_from_slice(b"acsp");
    profile
}

/// Returns a PNG whose compressed profile has `length` bytes, in a stream of `packed` bytes at least.
fn bomb(length: usize, junk: usize) -> Vec<u8> {
    let stream = [&b"x\0\0"[..], &packed_profile(b"RGB ", length), &vec![0; junk]].concat();
    png_with(&[(b"iCCP", &stream)])
}

/// Returns a JPEG with a profile of `length` bytes in segments.
fn jpeg_with_profile(length: usize) -> Vec<u8> {
    let jpeg = file_of(ImageFormat::Jpeg);
    let profile = profile(b"RGB ", length);
    let pieces = profile.chunks(65_000);
    let count = pieces.len() as u8;
    let segments = pieces.zip(1u8..).flat_map(|(piece, k)| {
        let body = [&b"ICC_PROFILE\0"[..], &[k, count], piece].concat();
        [&[0xFF, 0xE2][..], &(body.len() as u16 + 2).to_be_bytes(), &body].concat()
    });
    [&jpeg[..2], &segments.collect::<Vec<u8>>(), &jpeg[2..]].concat()
}

fn tiff_with_profile(length: usize) -> Vec<u8> {
    let mut tiff = Cursor::new(Vec::new());
    let mut encoder = image::codecs::tiff::TiffEncoder::new(&mut tiff);
    encoder.set_icc_profile(profile(b"RGB ", length)).unwrap();
    encoder.write_image(picture().as_raw(), 48, 40, image::ExtendedColorType::Rgb8).unwrap();
    tiff.into_inner()
}

fn webp_with_profile(length: usize) -> Vec<u8> {
    let mut webp = Vec::new();
    let mut encoder = image::codecs::webp::WebPEncoder::new_lossless(&mut webp);
    encoder.set_icc_profile(profile(b"RGB ", length)).unwrap();
    encoder.write_image(picture().as_raw(), 48, 40, image::ExtendedColorType::Rgb8).unwrap();
    webp
}

const LIMIT: usize = ssplat::unstable::colour::MAX_PROFILE_BYTES as usize;

#[test]
fn a_profile_that_is_too_long_is_left_out_of_every_format() {
    let folder = Folder::new();
    let out = folder.path("o.ssplat");
    for (name, file) in [
        ("inflated.png", bomb(LIMIT + 40_000, 0)),
        ("packed.png", bomb(100_000, LIMIT)),
        ("a.jpg", jpeg_with_profile(LIMIT + 1)),
        ("a.tif", tiff_with_profile(LIMIT + 1)),
        ("a.webp", webp_with_profile(LIMIT + 1)),
    ] {
        let input = folder.file(name, &file);
        for more in [&[][..], &["--tiles=128"], &["--metadata", "all"]] {
            let told = encoded(&input, &out, more);
            assert!(told.contains("profile") && told.contains("left out"), "{name} {more:?}: {told}");
            assert_eq!(profile_in(&out), None, "{name} {more:?}");
        }
        // What the user leaves out anyway is no news.
        assert!(!encoded(&input, &out, &["--metadata", "none"]).contains("profile"), "{name}");
        let encoder = ssplat::Encoder::new().effort(1).bytes(3000).metadata(ssplat::MetadataPolicy::All);
        encoder.transcode(&input, &out).unwrap();
        assert_eq!(profile_in(&out), None, "{name}");
    }
}

#[test]
fn a_profile_within_the_limit_is_kept_in_every_format() {
    let folder = Folder::new();
    let out = folder.path("o.ssplat");
    for (name, file) in [
        ("a.png", bomb(100_000, 0)),
        ("a.jpg", jpeg_with_profile(100_000)),
        ("a.tif", tiff_with_profile(100_000)),
        ("a.webp", webp_with_profile(100_000)),
    ] {
        let input = folder.file(name, &file);
        let found = ssplat(&["encode", text(&input), text(&out), "--effort", "1", "--bytes", "120k"]);
        assert!(found.status.success(), "{name}: {}", told(&found));
        let length = profile_in(&out).map(|icc| icc.len());
        assert!(length.is_some_and(|length| (99_700..=100_000).contains(&length)), "{name}: {length:?}");
    }
}

#[test]
fn text_of_a_png_neither_counts_nor_hides_its_other_metadata() {
    let folder = Folder::new();
    let exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    let long = [&b"Comment\0"[..], &vec![b'a'; 14 << 20]].concat();
    let xmp = b"XML:com.adobe.xmp\0\0\0\0\0<x/>";
    let input = folder.file("a.png", &png_with(&[(b"tEXt", &long), (b"iTXt", xmp), (b"eXIf", exif)]));
    let found = open(&input);
    assert_eq!(found.orientation, Orientation::Rotate90);
    assert_eq!(found.notes, ["its XMP block is left out"]);
}

#[test]
fn a_jpeg_xl_of_any_intensity_looks_as_in_libjxl() {
    let measured = ends(0, &["compare", text(&find("nits1000.jxl")), text(&find("nits-source.png"))]);
    let psnr: f64 = measured.split(' ').nth(1).unwrap().parse().unwrap();
    // libjxl has 41.1 dB.
    assert!(psnr > 41.0, "{measured}");
}

#[test]
fn profiles_that_are_made_pass_the_checks_of_libpng() {
    let folder = Folder::new();
    let (out, png) = (folder.path("o.ssplat"), folder.path("o.png"));
    encoded(&find("linear.jxl"), &out, &[]);
    ends(0, &["decode", text(&out), text(&png)]);
    let icc = profile_in(&out).unwrap();
    let word = |at: usize| u32::from_be_bytes(icc[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((word(0), word(0) % 4), (icc.len(), 0));
    assert_eq!(&icc[68..80], b"\0\0\xF6\xD6\0\x01\0\0\0\0\xD3\x2D");
    assert!((0..word(128)).all(|k| word(132 + 12 * k + 4) % 4 == 0));
    assert_eq!(open(&png).icc, Some(icc));
}

fn words(pixels: &Pixels) -> Vec<u16> {
    match pixels.samples() {
        Samples::U8(v) => v.iter().map(|&v| u16::from(v)).collect(),
        Samples::U16(v) => v.clone(),
    }
}

#[test]
fn premultiplied_alpha_of_a_tiff_is_divided() {
    let [stored, straight] = ["premultiplied.tif", "premultiplied-same-picture.png"].map(find);
    let (found, expected) = (open(&stored).pixels, open(&straight).pixels);
    assert_eq!(found.channels(), Channels::Rgba);
    for (a, b) in words(&found).chunks(4).zip(words(&expected).chunks(4)) {
        assert_eq!(a[3], b[3]);
        // A step of a premultiplied sample is 255 / alpha steps.
        let step = 255u16.checked_div(a[3]).unwrap_or(255) + 1;
        assert!((0..3).all(|k| a[k].abs_diff(b[k]) <= step), "{a:?} {b:?}");
    }
    // The library reads it as well.
    let folder = Folder::new();
    let [one, other] = ["a.ssplat", "b.ssplat"].map(|name| folder.path(name));
    encoded(&stored, &one, &[]);
    ssplat::Encoder::new().effort(1).bytes(3000).transcode(&stored, &other).unwrap();
    assert_eq!(fs::read(one).unwrap(), fs::read(other).unwrap());
}

/// Returns a TIFF of one strip of `data`, with these entries besides those that each has: tag, type, values.
fn tiff([width, height]: [u32; 2], entries: &[(u16, u16, &[u32])], data: &[u8]) -> Vec<u8> {
    let mut file = b"II*\0".to_vec();
    let mut all: Vec<(u16, u16, Vec<u32>)> = vec![
        (256, 4, vec![width]),
        (257, 4, vec![height]),
        (259, 3, vec![1]),
        (273, 4, vec![8]),
        (278, 4, vec![height]),
        (279, 4, vec![data.len() as u32]),
    ];
    all.extend(entries.iter().map(|(tag, kind, values)| (*tag, *kind, values.to_vec())));
    all.sort_by_key(|&(tag, ..)| tag);
    let mut rest = data.to_vec();
    rest.resize(rest.len().next_multiple_of(2), 0);
    let mut directory = (all.len() as u16).to_le_bytes().to_vec();
    for (tag, kind, values) in all {
        let bytes: Vec<u8> = match kind {
            3 => values.iter().flat_map(|&v| (v as u16).to_le_bytes()).collect(),
            _ => values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        };
        directory.extend([tag, kind].map(u16::to_le_bytes).concat());
        directory.extend((values.len() as u32).to_le_bytes());
        if bytes.len() <= 4 {
            directory.extend(bytes.iter().copied().chain([0; 4]).take(4));
        } else {
            directory.extend((8 + rest.len() as u32).to_le_bytes());
            rest.extend(bytes);
        }
    }
    directory.extend([0; 4]);
    file.extend((8 + rest.len() as u32).to_le_bytes());
    [file, rest, directory].concat()
}

#[test]
fn tiff_of_palettes_grey_with_alpha_and_large_samples_is_read() {
    let folder = Folder::new();
    let read = |entries: &[(u16, u16, &[u32])], data: &[u8]| {
        let pixels = open(&folder.file("a.tif", &tiff([3, 1], entries, data))).pixels;
        (pixels.channels(), words(&pixels))
    };
    let map = |values: [u32; 4]| -> Vec<u32> { (0..3).flat_map(|k| values.map(|v| v * (k + 1))).collect() };
    // Palettes of 2 and of 8 bits, with values of 16 and of 8 bits.
    let colors = map([0, 257, 514, 771]);
    let palette = read(&[(258, 3, &[2]), (262, 3, &[3]), (277, 3, &[1]), (320, 3, &colors)], &[0b11_01_00_00]);
    assert_eq!(palette, (Channels::Rgb, vec![3, 6, 9, 1, 2, 3, 0, 0, 0]));
    let mut colors = vec![0; 768];
    for at in [7, 256 + 7, 512 + 7] {
        colors[at] = at as u32 % 200;
    }
    let palette = read(&[(258, 3, &[8]), (262, 3, &[3]), (277, 3, &[1]), (320, 3, &colors)], &[7, 0, 7]);
    assert_eq!(palette, (Channels::Rgb, vec![7, 63, 119, 0, 0, 0, 7, 63, 119]));
    // Grey and alpha, straight and premultiplied.
    let grey = |kind| [(258, 3, &[8, 8][..]), (262, 3, &[1]), (277, 3, &[2]), (338, 3, kind)];
    let data = [100, 255, 50, 128, 0, 0];
    assert_eq!(read(&grey(&[2]), &data), (Channels::GreyAlpha, vec![100, 255, 50, 128, 0, 0]));
    assert_eq!(read(&grey(&[1]), &data), (Channels::GreyAlpha, vec![100, 255, 100, 128, 0, 0]));
    // Grey of 4 bits, of 32-bit integers and floats, and of 64-bit floats.
    let grey = |bits: &'static [u32], format: &'static [u32]| {
        [(258, 3, bits), (262, 3, &[1]), (277, 3, &[1]), (339, 3, format)]
    };
    assert_eq!(read(&grey(&[4], &[1]), &[0x0F, 0x80]), (Channels::Grey, vec![0, 255, 136]));
    let large = [0, u32::MAX, 1 << 31].map(u32::to_le_bytes).concat();
    assert_eq!(read(&grey(&[32], &[1]), &large), (Channels::Grey, vec![0, 65535, 32768]));
    let floats = [0.0f32, 1.0, 0.5].map(f32::to_le_bytes).concat();
    assert_eq!(read(&grey(&[32], &[3]), &floats), (Channels::Grey, vec![0, 65535, 32768]));
    let floats = [0.0f64, 1.0, 0.25].map(f64::to_le_bytes).concat();
    assert_eq!(read(&grey(&[64], &[3]), &floats), (Channels::Grey, vec![0, 65535, 16384]));
    // YCbCr without subsampling.
    let colors = [(258, 3, &[8, 8, 8][..]), (262, 3, &[6]), (277, 3, &[3]), (530, 3, &[1, 1])];
    let (channels, samples) = read(&colors, &[255, 128, 128, 76, 85, 255, 0, 128, 128]);
    assert_eq!((channels, &samples[..3], &samples[6..]), (Channels::Rgb, &[255, 255, 255][..], &[0, 0, 0][..]));
    assert!(samples[3] >= 253 && samples[4] <= 1 && samples[5] <= 1, "{samples:?}");
    for name in ["jpeg-in-tiff.tif", "palette.tif", "grey-float.tif"] {
        let found = open(&find(name));
        assert!(found.pixels.width() >= 16, "{name}");
    }
}

#[test]
fn a_tiff_that_is_not_read_is_refused_with_advice() {
    let folder = Folder::new();
    let kind = |bits: &'static [u32], photometric: &'static [u32], format: &'static [u32]| {
        let count: &[u32] = if photometric[0] == 8 { &[3] } else { &[1] };
        tiff([3, 1], &[(258, 3, bits), (262, 3, photometric), (277, 3, count), (339, 3, format)], &[1; 24])
    };
    for (name, file) in [
        ("order.tif", tiff([3, 1], &[(258, 3, &[8]), (262, 3, &[1]), (266, 3, &[2])], &[1, 2, 3])),
        ("signed.tif", kind(&[16], &[1], &[2])),
        ("lab.tif", kind(&[8, 8, 8], &[8], &[1])),
        ("small.tif", tiff([3, 1], &[(258, 3, &[32]), (262, 3, &[1])], &[5u32; 3].map(u32::to_le_bytes).concat())),
        (
            "heights.tif",
            tiff(
                [3, 1],
                &[(258, 3, &[32]), (262, 3, &[1]), (339, 3, &[3])],
                &[800.0f32; 3].map(f32::to_le_bytes).concat(),
            ),
        ),
        (
            "nan.tif",
            tiff(
                [3, 1],
                &[(258, 3, &[32]), (262, 3, &[1]), (339, 3, &[3])],
                &[f32::NAN, 0.5, 1.0].map(f32::to_le_bytes).concat(),
            ),
        ),
    ] {
        let input = folder.file(name, &file);
        let said = ends(5, &["encode", text(&input), text(&folder.path("o.ssplat"))]);
        assert!(said.contains("convert IN.tif"), "{name}: {said}");
    }
    let nan = [f32::NAN; 9].map(f32::to_le_bytes).concat();
    let rgb = tiff([3, 1], &[(258, 3, &[32, 32, 32]), (262, 3, &[2]), (277, 3, &[3]), (339, 3, &[3, 3, 3])], &nan);
    ends(5, &["encode", text(&folder.file("rgb.tif", &rgb)), text(&folder.path("o.ssplat"))]);
}

#[test]
fn clipped_samples_are_told() {
    let folder = Folder::new();
    let told = encoded(&find("float-hdr.tif"), &folder.path("o.ssplat"), &[]);
    assert!(told.contains("are clipped to 0..1"), "{told}");
}

#[test]
fn a_jpeg_without_its_end_marker_is_complete_if_it_has_all_samples() {
    let folder = Folder::new();
    let out = folder.path("o.ssplat");
    let told = encoded(&find("phone-trailer.jpg"), &out, &[]);
    assert!(told.contains("end marker is missing"), "{told}");
    let jpeg = file_of(ImageFormat::Jpeg);
    let whole = &jpeg[..jpeg.len() - 2];
    for (name, more) in [("none.jpg", &b""[..]), ("half.jpg", b"\xFF"), ("text.jpg", b"some more bytes of text")] {
        let told = encoded(&folder.file(name, &[whole, more].concat()), &out, &[]);
        assert!(told.contains("end marker is missing"), "{name}: {told}");
    }
    let whole_pixels = open(&folder.file("whole.jpg", &jpeg)).pixels;
    assert!(open(&folder.path("none.jpg")).pixels == whole_pixels);
    for missing in [6, 12, 60] {
        let cut = folder.file("cut.jpg", &whole[..whole.len() - missing]);
        let said = ends(4, &["encode", text(&cut), text(&out)]);
        assert!(said.contains("cut off"), "{missing}: {said}");
    }
}

#[test]
fn kinds_of_jpeg_that_are_not_read_are_refused_with_advice() {
    let folder = Folder::new();
    let out = folder.path("o.ssplat");
    for (name, advice) in [("arithmetic.jpg", "jpegtran"), ("twelve-bit.jpg", "djpeg")] {
        let said = ends(5, &["encode", text(&find(name)), text(&out)]);
        assert!(said.contains(advice), "{name}: {said}");
    }
    // The frame header of a baseline JPEG with the marker of another kind.
    let jpeg = file_of(ImageFormat::Jpeg);
    let frame = jpeg.windows(2).position(|w| w == [0xFF, 0xC0]).unwrap();
    for (marker, advice) in [(0xC3, "lossless"), (0xCA, "arithmetic"), (0xC5, "hierarchical"), (0xF7, "JPEG-LS")] {
        let mut other = jpeg.clone();
        other[frame + 1] = marker;
        let said = ends(5, &["encode", text(&folder.file("a.jpg", &other)), text(&out)]);
        assert!(said.contains(advice), "{marker:x}: {said}");
    }
}

#[test]
fn side_files_of_macos_are_passed_over() {
    let folder = Folder::new();
    let inside = folder.path("in");
    fs::create_dir(&inside).unwrap();
    let double = b"\0\x05\x16\x07\0\x02\0\0Mac OS X        ";
    fs::write(inside.join("a.png"), file_of(ImageFormat::Png)).unwrap();
    fs::write(inside.join("._a.png"), double).unwrap();
    fs::write(inside.join("b.png"), double).unwrap();
    let out = folder.path("out");
    let said = ends(0, &["encode", text(&inside), "--out-dir", text(&out), "--effort", "1"]);
    assert!(said.contains("1 files done") && said.contains("1 file is passed over"), "{said}");
    assert!(out.join("a.ssplat").exists());
}

#[test]
fn files_that_are_no_pictures_are_named() {
    let folder = Folder::new();
    for (name, start, status, word) in [
        ("page.jpg", &b"<!DOCTYPE html><html>"[..], 4, "HTML"),
        ("page2.jpg", b"\n  <HTML lang=en>", 4, "HTML"),
        ("lfs.png", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", 4, "git lfs pull"),
        ("drawing.png", b"<?xml version=\"1.0\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\"/>", 5, "SVG"),
        ("paper.png", b"%PDF-1.7\n", 5, "PDF"),
        ("a.jp2", b"\0\0\0\x0CjP  \r\n\x87\n", 5, "JPEG 2000"),
        ("a.png", b"8BPS\0\x01", 5, "Photoshop"),
    ] {
        let said = ends(status, &["encode", text(&folder.file(name, start)), text(&folder.path("o.ssplat"))]);
        assert!(said.contains(word), "{name}: {said}");
    }
}

#[test]
fn the_orientation_in_a_text_chunk_is_used() {
    let folder = Folder::new();
    assert_eq!(open(&find("raw-profile-exif.png")).orientation, Orientation::Rotate90);
    let digits = "49492a0008000000010012010300010000000800\n000000000000\n";
    let raw = format!("Raw profile type APP1\0\nAPP1\n      32\n457869660000{digits}");
    let found = open(&folder.file("a.png", &png_with(&[(b"tEXt", raw.as_bytes())])));
    assert_eq!((found.orientation, found.exif.map(|exif| exif.len())), (Orientation::Rotate270, Some(26)));
    // By a picture that is read in parts, too.
    let out = folder.path("o.ssplat");
    encoded(&find("raw-profile-exif.png"), &out, &["--tiles=128"]);
    assert_eq!(open(&out).orientation, Orientation::Rotate90);
}

#[test]
fn an_exif_block_behind_the_pixels_is_told() {
    let folder = Folder::new();
    let exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    let png = file_of(ImageFormat::Png);
    let end = png.len() - 12;
    let late = [&png[..end], &chunk(b"eXIf", exif), &png[end..]].concat();
    let found = open(&folder.file("a.png", &late));
    assert_eq!(found.orientation, Orientation::NoTransforms);
    assert!(found.notes.iter().any(|note| note.contains("follows the pixels")), "{:?}", found.notes);
}

#[test]
fn an_export_tells_that_it_is_not_turned() {
    let folder = Folder::new();
    let out = folder.path("o.ssplat");
    encoded(&find("orientation6.jpg"), &out, &["--detail", "off"]);
    for extension in ["svg", "ply"] {
        let said = ends(0, &["export", text(&out), text(&folder.path("o").with_extension(extension))]);
        assert!(said.contains("orientation is not exported"), "{extension}: {said}");
    }
}

/// Writes an .ssplat file with a profile, of a flat picture.
fn with_profile(path: &Path, channels: Channels, icc: Vec<u8>) {
    let samples = vec![90; 16 * 16 * channels.count()];
    let pixels = Pixels::new(16, 16, channels, Samples::U8(samples)).unwrap();
    let encoder = ssplat::Encoder::new().effort(1).metadata(ssplat::MetadataPolicy::All).icc(icc);
    fs::write(path, encoder.encode(&pixels).unwrap().bytes).unwrap();
}

#[test]
fn a_profile_for_other_samples_is_left_out_of_every_output() {
    let folder = Folder::new();
    let file = folder.path("a.ssplat");
    for (channels, space, formats) in [
        (Channels::Rgb, b"GRAY", &["png", "jpg", "webp", "tiff"][..]),
        (Channels::Grey, b"RGB ", &["png", "jpg", "tiff"]),
        // WebP stores grey as RGB.
        (Channels::Grey, b"GRAY", &["webp"]),
        (Channels::Rgb, b"CMYK", &["png", "jpg", "webp", "tiff"]),
    ] {
        with_profile(&file, channels, profile(space, 200));
        for format in formats {
            let out = folder.path("o").with_extension(format);
            let said = ends(0, &["decode", text(&file), text(&out)]);
            assert!(said.contains("profile is for") && said.contains("left out"), "{space:?} {format}: {said}");
            assert_eq!(open(&out).icc, None, "{space:?} {format}");
        }
    }
    with_profile(&file, Channels::Rgb, profile(b"RGB ", 200));
    let out = folder.path("o.png");
    assert_eq!(ends(0, &["decode", text(&file), text(&out)]), "");
    assert_eq!(open(&out).icc, Some(profile(b"RGB ", 200)));
}

#[test]
fn portable_pixmaps_have_the_kind_of_their_extension() {
    let folder = Folder::new();
    let file = folder.path("a.ssplat");
    for (channels, kinds) in [
        (Channels::Grey, ["P6", "P5", "P5", "P7"]),
        (Channels::GreyAlpha, ["P6", "P5", "P7", "P7"]),
        (Channels::Rgb, ["P6", "", "P6", "P7"]),
        (Channels::Rgba, ["P6", "", "P7", "P7"]),
    ] {
        let samples = vec![90; 16 * 16 * channels.count()];
        let pixels = Pixels::new(16, 16, channels, Samples::U8(samples)).unwrap();
        fs::write(&file, ssplat::Encoder::new().effort(1).encode(&pixels).unwrap().bytes).unwrap();
        for (extension, kind) in ["ppm", "pgm", "pnm", "pam"].into_iter().zip(kinds) {
            let out = folder.path("o").with_extension(extension);
            let said = ends(if kind.is_empty() { 2 } else { 0 }, &["decode", text(&file), text(&out)]);
            let is_blended = !kind.is_empty() && channels.alpha().is_some() && ["ppm", "pgm"].contains(&extension);
            assert_eq!(said.contains("blended over white"), is_blended, "{channels:?} {extension}: {said}");
            if !kind.is_empty() {
                assert!(fs::read(&out).unwrap().starts_with(kind.as_bytes()), "{channels:?} {extension}");
                assert_eq!(image::open(&out).unwrap().dimensions(), (16, 16));
            }
        }
    }
}

#[test]
fn grey_with_alpha_is_kept_in_every_format_that_stores_alpha() {
    let folder = Folder::new();
    let file = folder.path("a.ssplat");
    for depth in [8, 16] {
        let value = |i: u16| i * 60 + 9;
        let samples = match depth {
            8 => Samples::U8((0..4).map(|i| value(i) as u8).collect()),
            _ => Samples::U16((0..4).map(|i| value(i) * 257).collect()),
        };
        let pixels = Pixels::new(2, 1, Channels::GreyAlpha, samples).unwrap();
        let exact = ssplat::Encoder::new().target(ssplat::Target::Lossless).encode(&pixels).unwrap();
        fs::write(&file, exact.bytes).unwrap();
        let want = image::DynamicImage::from(pixels).into_rgba8();
        for extension in ["bmp", "ff", "pam", "png", "qoi", "tga", "tiff", "webp"] {
            let out = folder.path("o").with_extension(extension);
            ends(0, &["decode", text(&file), text(&out)]);
            assert_eq!(image::open(&out).unwrap().into_rgba8(), want, "{extension}, {depth} bits");
        }
    }
}

#[test]
fn limits_of_output_formats_are_checked_first() {
    let folder = Folder::new();
    let file = folder.path("a.ssplat");
    for (width, formats) in [(16_384, &["webp"][..]), (65_536, &["webp", "jpg", "tga"])] {
        let pixels = Pixels::new(width, 1, Channels::Grey, Samples::U8(vec![7; width as usize])).unwrap();
        fs::write(&file, ssplat::Encoder::new().effort(1).encode(&pixels).unwrap().bytes).unwrap();
        for format in formats {
            let said = ends(2, &["decode", text(&file), text(&folder.path("o").with_extension(format))]);
            assert!(said.contains("holds at most") && said.contains(&width.to_string()), "{format}: {said}");
        }
    }
    assert_eq!(folder.names(), ["a.ssplat"]);
}

#[test]
fn a_picture_that_is_too_long_is_downscaled_or_refused() {
    let folder = Folder::new();
    let wide = image::GrayImage::from_fn(2_000_000, 1, |x, _| image::Luma([if x < 1_000_000 { 30 } else { 200 }]));
    let (png, out) = (folder.path("a.png"), folder.path("o.ssplat"));
    wide.save(&png).unwrap();
    let said = ends(6, &["encode", text(&png), text(&out)]);
    assert!(said.contains("--max-side"), "{said}");
    encoded(&png, &out, &["--max-side", "500"]);
    let found = open(&out).pixels;
    let samples = words(&found);
    assert_eq!((found.width(), found.height()), (500, 1));
    assert!(samples[50].abs_diff(30) < 12 && samples[450].abs_diff(200) < 12, "{samples:?}");
}

#[test]
fn a_name_that_begins_with_a_dash_makes_no_folder() {
    let folder = Folder::new();
    folder.file("-dash.png", &file_of(ImageFormat::Png));
    let run = |args: &[&str]| {
        let found = Command::new(env!("CARGO_BIN_EXE_ssplat")).args(args).current_dir(folder.root()).output().unwrap();
        (found.status.code(), told(&found))
    };
    let (status, said) = run(&["encode", "-dash.png", "out.ssplat"]);
    assert!(status == Some(2) && said.contains("./-dash.png"), "{said}");
    let (status, said) = run(&["encode", "missing.png", "--out-dir", "new"]);
    assert_eq!(status, Some(3), "{said}");
    assert_eq!(folder.names(), ["-dash.png"]);
}

#[test]
fn compare_sees_pictures_as_they_are_shown() {
    let folder = Folder::new();
    let upright = folder.path("upright.png");
    open(&find("orientation6.jpg"))
        .upright(&upright)
        .map(|source| {
            DynamicImage::from(source.pixels).save(&upright).unwrap();
        })
        .unwrap_or_else(|e| panic!("{}", e.message));
    let said = ends(0, &["compare", text(&find("orientation6.jpg")), text(&upright)]);
    assert!(said.contains("identical samples") && said.contains("orientations differ"), "{said}");
    let chunk = 100_000u32.to_be_bytes();
    let [plain, linear] =
        [("a.png", png_with(&[])), ("b.png", png_with(&[(b"gAMA", &chunk)]))].map(|(n, f)| folder.file(n, &f));
    assert!(ends(0, &["compare", text(&plain), text(&linear)]).contains("profiles differ"));
    assert!(!ends(0, &["compare", text(&plain), text(&plain)]).contains("differ"));
}

#[test]
fn a_manifest_is_neither_input_nor_output_nor_another_file() {
    let folder = Folder::new();
    let (png, file) = (folder.file("a.png", &file_of(ImageFormat::Png)), folder.path("q.ssplat"));
    encoded(&png, &file, &[]);
    let before = fs::read(&file).unwrap();
    let out = folder.path("out");
    let refused = |args: &[&str]| {
        let said = ends(2, args);
        assert!(said.contains("cannot be the manifest"), "{said}");
    };
    refused(&["decode", text(&file), "--out-dir", text(&out), "--manifest", text(&file)]);
    assert_eq!(fs::read(&file).unwrap(), before);
    // As when the shell expands `--manifest *.png`.
    let other = folder.file("b.png", &file_of(ImageFormat::Png));
    refused(&["encode", "--out-dir", text(&out), "--manifest", text(&png), text(&other)]);
    assert_eq!(fs::read(&png).unwrap(), file_of(ImageFormat::Png));
    // An output that does not exist yet.
    let root = text(folder.root());
    refused(&["encode", text(&png), "--out-dir", root, "--manifest", text(&folder.path("a.ssplat"))]);
    assert_eq!(folder.names(), ["a.png", "b.png", "q.ssplat"]);
    let lines = folder.file("m.jsonl", b"{}\n");
    ends(0, &["encode", text(&png), "--out-dir", text(&out), "--manifest", text(&lines), "--effort", "1", "--quiet"]);
    assert!(fs::read_to_string(&lines).unwrap().starts_with("{}\n{"));
    #[cfg(unix)]
    {
        let link = folder.path("link.jsonl");
        std::os::unix::fs::symlink(&png, &link).unwrap();
        refused(&["encode", text(&png), "--out-dir", text(&out), "--manifest", text(&link), "--overwrite"]);
        fs::remove_file(&link).unwrap();
        fs::hard_link(&file, &link).unwrap();
        refused(&["decode", text(&file), "--out-dir", text(&out), "--manifest", text(&link)]);
    }
}

#[cfg(unix)]
mod unix {
    use std::os::unix::fs::{PermissionsExt, symlink};
    use std::process::Stdio;
    use std::time::{Duration, Instant};

    use nix::sys::signal::{Signal, kill};
    use nix::unistd::Pid;

    use super::*;

    #[test]
    fn standard_input_that_is_the_output_is_not_overwritten() {
        let folder = Folder::new();
        let png = folder.file("i.png", &file_of(ImageFormat::Png));
        let run = |output: &Path| {
            let mut command = Command::new(env!("CARGO_BIN_EXE_ssplat"));
            command.args(["encode", "-", text(output), "--force", "--effort", "1"]);
            command.stdin(fs::File::open(&png).unwrap()).output().unwrap()
        };
        let link = folder.path("link.png");
        symlink(&png, &link).unwrap();
        for output in [&png, &link] {
            let found = run(output);
            assert_eq!(found.status.code(), Some(2), "{}", told(&found));
            assert_eq!(fs::read(&png).unwrap(), file_of(ImageFormat::Png));
        }
        assert!(run(&folder.path("o.ssplat")).status.success());
    }

    #[test]
    fn an_output_is_not_the_input_of_another_task_nor_its_output() {
        let folder = Folder::new();
        let [a, b] = ["a.png", "b.png"].map(|name| folder.file(name, &file_of(ImageFormat::Png)));
        let out = folder.path("out");
        fs::create_dir(&out).unwrap();
        symlink(&b, out.join("a.ssplat")).unwrap();
        let args = ["encode", text(&a), text(&b), "--out-dir", text(&out), "--overwrite", "--effort", "1"];
        let said = ends(2, &args);
        assert!(said.contains("is the input"), "{said}");
        assert_eq!(fs::read(&b).unwrap(), file_of(ImageFormat::Png));
        fs::remove_file(out.join("a.ssplat")).unwrap();
        fs::write(out.join("b.ssplat"), "old").unwrap();
        symlink(out.join("b.ssplat"), out.join("a.ssplat")).unwrap();
        let said = ends(2, &args);
        assert!(said.contains("the same file"), "{said}");
        assert_eq!(fs::read(out.join("b.ssplat")).unwrap(), b"old");
    }

    #[test]
    fn a_read_only_output_is_replaced_only_on_request() {
        let folder = Folder::new();
        let (png, out) = (folder.file("a.png", &file_of(ImageFormat::Png)), folder.file("o.ssplat", b"old"));
        fs::set_permissions(&out, fs::Permissions::from_mode(0o444)).unwrap();
        let found = encode(&png, &out, &[]);
        assert_eq!(found.status.code(), Some(3), "{}", told(&found));
        assert_eq!(fs::read(&out).unwrap(), b"old");
        encoded(&png, &out, &["--force"]);
        assert_ne!(fs::read(&out).unwrap(), b"old");
        let back = folder.file("o.png", b"old");
        fs::set_permissions(&back, fs::Permissions::from_mode(0o444)).unwrap();
        ends(3, &["decode", text(&out), text(&back)]);
        ends(0, &["decode", text(&out), text(&back), "--overwrite"]);
    }

    #[test]
    fn a_report_that_cannot_be_written_leaves_no_output() {
        let folder = Folder::new();
        let (png, out) = (folder.file("a.png", &file_of(ImageFormat::Png)), folder.path("o.ssplat"));
        let full = || Stdio::from(fs::File::options().write(true).open("/dev/full").unwrap());
        let run = |args: &[&str]| {
            Command::new(env!("CARGO_BIN_EXE_ssplat")).args(args).stdout(full()).status().unwrap().code()
        };
        let preview = folder.path("p.png");
        for more in [&[][..], &["--json"], &["--tiles=128"], &["--preview", text(&preview)]] {
            let args = [&["encode", text(&png), text(&out), "--effort", "1"][..], more].concat();
            assert_eq!(run(&args), Some(3), "{more:?}");
        }
        assert_eq!(folder.names(), ["a.png"]);
        encoded(&png, &out, &[]);
        let back = folder.path("b.png");
        for more in [&[][..], &["--thumbnail", "16"]] {
            let args = [&["decode", text(&out), text(&back), "--json"][..], more].concat();
            assert_eq!(run(&args), Some(3), "{more:?}");
        }
        assert_eq!(folder.names(), ["a.png", "o.ssplat"]);
        // Notes that cannot be printed are no failure.
        let mut command = Command::new(env!("CARGO_BIN_EXE_ssplat"));
        let found = command.args(["decode", text(&out), text(&folder.path("b.ppm"))]).stderr(full()).status().unwrap();
        assert!(found.success());
    }

    #[test]
    fn signals_and_size_limits_leave_no_files() {
        let folder = Folder::new();
        let noise = RgbImage::from_fn(400, 300, |x, y| {
            let at = |k: u32| ((y * 400 + x) * 3 + k).wrapping_mul(2_654_435_761) >> 24;
            Rgb([at(0) as u8, at(1) as u8, at(2) as u8])
        });
        let png = folder.path("a.png");
        noise.save(&png).unwrap();
        let limited = |args: &str| {
            let script = format!("ulimit -f 4; exec \"$0\" {args}");
            Command::new("bash")
                .args(["-c", &script, env!("CARGO_BIN_EXE_ssplat")])
                .current_dir(folder.root())
                .output()
                .unwrap()
        };
        let found = limited("encode a.png o.ssplat --effort 1 --ratio 5");
        assert_eq!(found.status.code(), Some(3), "{}", told(&found));
        assert_eq!(folder.names(), ["a.png"]);
        for signal in [Signal::SIGQUIT, Signal::SIGTERM] {
            let mut command = Command::new(env!("CARGO_BIN_EXE_ssplat"));
            command.args(["encode", "a.png", "o.ssplat", "--effort", "9"]).current_dir(folder.root());
            let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
            let start = Instant::now();
            // The temporary file appears before the work.
            while folder.names().len() < 2 {
                assert!(start.elapsed() < Duration::from_secs(60), "no output was begun");
                std::thread::sleep(Duration::from_millis(5));
            }
            kill(Pid::from_raw(child.id() as i32), signal).unwrap();
            assert_eq!(child.wait().unwrap().code(), Some(130), "{signal}");
            assert_eq!(folder.names(), ["a.png"], "{signal}");
        }
    }
}

#[test]
fn the_quality_of_a_picture_of_one_colour_is_reported() {
    let folder = Folder::new();
    let png = folder.path("a.png");
    RgbImage::from_pixel(40, 30, Rgb([200, 30, 90])).save(&png).unwrap();
    let out = folder.path("o.ssplat");
    let args = ["encode", text(&png), text(&out), "--quality", "70", "--json", "--effort", "1"];
    let said: serde_json::Value = serde_json::from_slice(&ssplat(&args).stdout).unwrap();
    assert!(said["quality"].as_f64().is_some_and(|quality| quality > 90.0), "{said}");
}
