//! JPEG XL as an input: pixels, orientation, profiles and EXIF blocks of files by `cjxl` 0.7.0, and files that were
//! damaged.
//!
//! The files in `jxl/` were made of a picture of ramps, 40 × 30 pixels, and of an animation of two frames: `cjxl -d 0`
//! (`rgb`, `grey16`, `rgba`), `-d 1` (`lossy`), `-d 0 --container=1` (`container`), `-d 1 -x
//! color_space=RGB_D65_DCI_Rel_SRG` (`p3`), `-d 1 -x color_space=RGB_D65_202_Rel_PeQ` (`pq`); of a JPEG with
//! orientation 6, `cjxl` (`turned`) and `cjxl -j 0 -d 1` (`turned-lossy`); of a GIF, `cjxl` (`animation`).

use std::fs;
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::folder::Folder;
use ssplat::{Channels, Pixels, Samples};
use ssplat_cli::failure::{Failure, Kind};
use ssplat_cli::input::Input;
use ssplat_cli::source::{self, Reading, Source, Turn};

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/jxl").join(name)
}

fn open(name: &str) -> Source {
    source::open(&path(name), Turn::Keep).unwrap_or_else(|e| panic!("{name}: {}", e.message))
}

fn read(bytes: Vec<u8>) -> Result<Source, Failure> {
    source::read(Path::new("a.jxl"), Input::Memory(Cursor::new(bytes)), &Reading::turned(Turn::Keep))
}

fn ssplat(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ssplat")).args(args).output().unwrap()
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn bytes(pixels: &Pixels) -> &[u8] {
    let Samples::U8(samples) = pixels.samples() else { panic!("8 bits are expected") };
    samples
}

/// The picture that the files were made of: red, green, blue and alpha at a place.
fn ramps(x: u32, y: u32) -> [u8; 4] {
    [x as u8 * 6, y as u8 * 8, 90, (x * 7).min(255) as u8]
}

#[test]
fn lossless_files_have_the_pixels_that_they_were_made_of() {
    for (name, channels) in [("rgb.jxl", Channels::Rgb), ("container.jxl", Channels::Rgb), ("rgba.jxl", Channels::Rgba)]
    {
        let source = open(name);
        assert_eq!((source.pixels.width(), source.pixels.height(), source.pixels.channels()), (40, 30, channels));
        assert!(!source.is_cut_off && source.notes.is_empty(), "{name}: {:?}", source.notes);
        for (i, pixel) in bytes(&source.pixels).chunks_exact(channels.count()).enumerate() {
            let i = i as u32;
            assert_eq!(pixel, &ramps(i % 40, i / 40)[..channels.count()], "{name} {i}");
        }
    }
    let grey = open("grey16.jxl").pixels;
    let Samples::U16(samples) = grey.samples() else { panic!("16 bits are expected") };
    assert_eq!(grey.channels(), Channels::Grey);
    for (i, &sample) in samples.iter().enumerate() {
        assert_eq!(usize::from(sample), (i % 40 * 40 + i / 40) * 31);
    }
}

#[test]
fn lossy_files_have_the_pixels_of_djxl() {
    let source = open("lossy.jxl");
    // By `djxl` 0.7.0, at every hundredth pixel.
    let expected: [[u8; 3]; 12] = [
        [11, 0, 90],
        [121, 14, 89],
        [14, 39, 89],
        [121, 55, 88],
        [9, 80, 89],
        [121, 96, 88],
        [23, 120, 89],
        [122, 136, 89],
        [27, 160, 90],
        [123, 175, 89],
        [14, 200, 88],
        [122, 216, 87],
    ];
    for (pixel, expected) in bytes(&source.pixels).chunks_exact(3).step_by(100).zip(expected) {
        assert!(pixel.iter().zip(expected).all(|(a, b)| a.abs_diff(b) <= 1), "{pixel:?} {expected:?}");
    }
}

#[test]
fn turned_pictures_are_upright_once() {
    for (name, has_exif) in [("turned.jxl", true), ("turned-lossy.jxl", false)] {
        let source = open(name);
        assert_eq!((source.pixels.width(), source.pixels.height()), (30, 40), "{name}");
        // Orientation 6: the first row becomes the last column.
        let top_right = &bytes(&source.pixels)[29 * 3..30 * 3];
        let expected = ramps(0, 0);
        assert!(top_right.iter().zip(expected).all(|(a, b)| a.abs_diff(b) <= 16), "{name}: {top_right:?}");
        assert_eq!(source.orientation, image::metadata::Orientation::NoTransforms);
        assert_eq!(source.exif.is_some(), has_exif, "{name}");
        let Some(exif) = source.exif else { continue };
        assert!(exif.starts_with(b"MM\0*") && exif.windows(3).any(|w| w == b"abc"), "{name}: {exif:?}");
        assert!(matches!(
            image::metadata::Orientation::from_exif_chunk(&exif),
            None | Some(image::metadata::Orientation::NoTransforms)
        ));
    }
}

#[test]
fn profiles_and_code_points_are_kept_and_further_frames_are_told() {
    let p3 = open("p3.jxl");
    let icc = p3.icc.expect("a profile for Display P3");
    assert!(!ssplat::unstable::colour::is_srgb(&icc) && icc.len() < 1000, "{}", icc.len());
    for name in ["rgb.jxl", "lossy.jxl", "rgba.jxl", "grey16.jxl"] {
        assert!(open(name).icc.is_none_or(|icc| ssplat::unstable::colour::is_srgb(&icc)), "{name}");
    }
    let pq = open("pq.jxl");
    assert_eq!((pq.icc, pq.cicp, pq.notes), (None, Some(ssplat::Cicp::BT2100_PQ), Vec::new()));
    let animation = open("animation.jxl");
    assert_eq!(bytes(&animation.pixels)[..3], [255, 0, 0]);
    assert!(animation.notes.iter().any(|note| note.contains("first of its frames")), "{:?}", animation.notes);
}

#[test]
fn the_program_encodes_jpeg_xl_from_files_folders_and_pipes() {
    let folder = Folder::new();
    let [out, dir] = ["o.ssplat", "out"].map(|name| folder.path(name).to_str().unwrap().to_owned());
    let input = path("rgb.jxl");
    let options = ["--effort", "1", "--bytes", "2000", "--quiet"];
    let found = ssplat(&[&["encode", input.to_str().unwrap(), &out][..], &options].concat());
    assert!(found.status.success(), "{}", told(&found));
    let expected = fs::read(&out).unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_ssplat"));
    child.args([&["encode", "-", "-"][..], &options].concat()).stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = child.spawn().unwrap();
    child.stdin.take().unwrap().write_all(&fs::read(&input).unwrap()).unwrap();
    assert!(child.wait_with_output().unwrap().stdout == expected);
    let found = ssplat(&[&["encode", path("").to_str().unwrap(), "--out-dir", &dir][..], &options].concat());
    assert!(found.status.success(), "{}", told(&found));
    assert_eq!(fs::read_dir(&dir).unwrap().count(), fs::read_dir(path("")).unwrap().count());
    assert!(fs::read(Path::new(&dir).join("rgb.ssplat")).unwrap() == expected);
    // In whatever name, and as text.
    let misnamed = folder.file("a.png", &fs::read(&input).unwrap());
    let found = ssplat(&["compare", misnamed.to_str().unwrap(), input.to_str().unwrap()]);
    assert!(String::from_utf8_lossy(&found.stdout).contains("identical samples"), "{}", told(&found));
    assert!(String::from_utf8_lossy(&ssplat(&["formats"]).stdout).contains("JPEG XL   read  "));
}

#[test]
fn a_file_that_is_cut_off_is_refused_and_with_partial_it_may_be_encoded() {
    let folder = Folder::new();
    let whole = fs::read(path("lossy.jxl")).unwrap();
    let out = folder.path("o.ssplat");
    for length in [12, 40, whole.len() - 1] {
        let input = folder.file("cut.jxl", &whole[..length]);
        let found =
            ssplat(&["encode", input.to_str().unwrap(), out.to_str().unwrap(), "--bytes", "300", "--effort", "1"]);
        assert_eq!(found.status.code(), Some(4), "{length}: {}", told(&found));
        assert!(told(&found).contains("cut.jxl") && !out.exists(), "{}", told(&found));
    }
    let input = folder.file("cut.jxl", &whole[..whole.len() - 1]);
    let args =
        ["encode", input.to_str().unwrap(), out.to_str().unwrap(), "--bytes", "300", "--effort", "1", "--partial"];
    let found = ssplat(&args);
    assert!(found.status.success() && out.exists(), "{}", told(&found));
}

/// Every kind of failure that a damaged file may be.
fn is_of_the_file(failure: &Failure) -> bool {
    matches!(failure.kind, Kind::Format | Kind::Unsupported | Kind::Limit) && failure.message.starts_with("a.jxl: ")
}

#[test]
fn truncated_and_bit_flipped_files_are_refused_or_read_within_time_and_memory() {
    #[cfg(unix)]
    nix::sys::resource::setrlimit(nix::sys::resource::Resource::RLIMIT_AS, 6_000_000_000, 6_000_000_000).unwrap();
    let (mut tried, mut refused) = (0, 0);
    for entry in fs::read_dir(path("")).unwrap() {
        let name = entry.unwrap().file_name();
        let file = fs::read(path(name.to_str().unwrap())).unwrap();
        let truncated = (0..file.len()).map(|length| file[..length].to_vec());
        // Every fifth bit, which is another one in each byte.
        let flipped = (0..8 * file.len()).step_by(5).map(|bit| {
            let mut file = file.clone();
            file[bit / 8] ^= 1 << (bit % 8);
            file
        });
        for (i, bytes) in truncated.chain(flipped).enumerate() {
            let start = Instant::now();
            let outcome = read(bytes);
            assert!(start.elapsed() < Duration::from_secs(20), "{name:?} {i}: {:?}", start.elapsed());
            tried += 1;
            if let Err(failure) = outcome {
                refused += 1;
                assert!(is_of_the_file(&failure), "{name:?} {i}: {failure:?}");
            }
        }
    }
    assert!(tried > 5_000 && refused > tried / 3, "{refused} of {tried}");
}

/// A container with `boxes` before the codestream of `rgb.jxl`.
fn with_boxes(boxes: &[(&[u8; 4], Vec<u8>)]) -> Vec<u8> {
    let mut file = b"\0\0\0\x0CJXL \r\n\x87\n\0\0\0\x14ftypjxl \0\0\0\0jxl ".to_vec();
    let codestream = fs::read(path("rgb.jxl")).unwrap();
    for (name, body) in boxes.iter().cloned().chain([(b"jxlc", codestream)]) {
        file.extend((8 + body.len() as u32).to_be_bytes());
        file.extend(name);
        file.extend(body);
    }
    file
}

#[test]
fn metadata_that_unpacks_to_more_than_the_limit_is_left_out() {
    // `head -c 268435456 /dev/zero | brotli -c -q 5 -w 24`: 256 MiB.
    let bomb = include_bytes!("../zeros.br").to_vec();
    let start = Instant::now();
    let source = read(with_boxes(&[(b"brob", [b"Exif".to_vec(), bomb].concat())])).unwrap();
    assert!(source.exif.is_none() && start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
    let exif = [&[0; 4][..], b"II*\0rest"].concat();
    let source = read(with_boxes(&[(b"Exif", exif), (b"xml ", b"<x/>".to_vec()), (b"unkn", vec![7; 99])])).unwrap();
    assert_eq!(source.exif.as_deref(), Some(&b"II*\0rest"[..]));
    assert!(source.notes.iter().any(|note| note.contains("XMP")));
    // Broken ones are no reason to refuse the picture.
    for exif in [vec![], vec![0, 0, 0, 9, 1], vec![255; 20]] {
        let packed = [b"Exif".to_vec(), exif.clone()].concat();
        for boxes in [[(b"Exif", exif)], [(b"brob", packed)]] {
            assert!(read(with_boxes(&boxes)).unwrap().exif.is_none());
        }
    }
}
