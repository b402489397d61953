//! What the program reports about its inputs and keeps of them: colours, further pictures, larger outputs, and
//! untrusted text.

use std::ffi::OsStr;
use std::fs;
use std::io::Cursor;
use std::path::Path;
use std::process::{Command, Output};

use crate::folder::Folder;
use image::{DynamicImage, ImageEncoder, ImageFormat, RgbImage};
use ssplat::unstable::colour::{Profiles, is_srgb, look};

fn ssplat<S: AsRef<OsStr>>(args: &[S]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ssplat")).args(args.iter().map(AsRef::as_ref)).output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// As [`said`], for where that name is taken.
fn told(output: &Output) -> String {
    said(output)
}

fn picture() -> RgbImage {
    RgbImage::from_fn(64, 40, |x, y| image::Rgb([x as u8 * 4, y as u8 * 6, (x * y / 10) as u8]))
}

fn encoded(format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    DynamicImage::from(picture()).write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// Returns a PNG with `chunks` after its header.
fn png_with(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
    let png = encoded(ImageFormat::Png);
    let mut with = png[..33].to_vec();
    for (name, data) in chunks {
        let body = [&name[..], data].concat();
        with.extend((data.len() as u32).to_be_bytes());
        with.extend(&body);
        with.extend(checksum(&body).to_be_bytes());
    }
    with.extend(&png[33..]);
    with
}

/// Computes a CRC-32.
fn checksum(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| if crc & 1 != 0 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 };
    !bytes.iter().fold(!0, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), step))
}

/// Encodes `input`. Returns the profile in the file, and the notes.
fn profile_of(folder: &Folder, input: &Path, more: &[&str]) -> (Option<Vec<u8>>, String) {
    let out = folder.root().join("o.ssplat");
    let args = [input.to_str().unwrap(), out.to_str().unwrap(), "--effort", "1", "--bytes", "2000"];
    let found = ssplat(&[&["encode"][..], &args, more].concat());
    assert!(found.status.success(), "{}", said(&found));
    let bytes = fs::read(out).unwrap();
    let opened = ssplat::Reader::new(&bytes, &ssplat::Limits::default()).unwrap().read().unwrap();
    (opened.metadata().icc.clone(), said(&found))
}

#[test]
fn colours_that_a_png_states_become_a_profile_unless_they_are_srgb() {
    let folder = Folder::new();
    let chunk = |values: &[u32]| values.iter().flat_map(|v| v.to_be_bytes()).collect::<Vec<u8>>();
    let (linear, usual) = (chunk(&[100_000]), chunk(&[45_455]));
    let srgb = chunk(&[31_270, 32_900, 64_000, 33_000, 30_000, 60_000, 15_000, 6_000]);
    let p3 = chunk(&[31_270, 32_900, 68_000, 32_000, 26_500, 69_000, 15_000, 6_000]);
    let other = |chunks: &[(&[u8; 4], &[u8])]| profile_of(&folder, &folder.file("a.png", &png_with(chunks)), &[]);
    assert_eq!(other(&[]).0, None);
    assert_eq!(other(&[(b"gAMA", &usual), (b"cHRM", &srgb)]).0, None);
    assert_eq!(other(&[(b"sRGB", &[0]), (b"gAMA", &linear)]).0, None);
    assert_eq!(other(&[(b"cICP", &[1, 13, 0, 1])]).0, None);
    for chunks in [
        &[(b"gAMA", &linear[..])][..],
        &[(b"gAMA", &usual), (b"cHRM", &p3)],
        &[(b"cICP", &[12, 13, 0, 1])],
        &[(b"cICP", &[9, 1, 0, 1])],
    ] {
        let (icc, said) = other(chunks);
        let icc = icc.unwrap_or_else(|| panic!("{chunks:?}: {said}"));
        assert!(!is_srgb(&icc) && icc.len() < 900, "{chunks:?}: {}", icc.len());
        // The same when the picture is read in parts, and by the library.
        let (tiled, _) = profile_of(&folder, &folder.root().join("a.png"), &["--tiles=128"]);
        assert!(tiled.as_ref() == Some(&icc));
        let out = folder.root().join("t.ssplat");
        ssplat::Encoder::new().effort(1).bytes(2000).transcode(folder.root().join("a.png"), &out).unwrap();
        let bytes = fs::read(out).unwrap();
        let reader = ssplat::Reader::new(&bytes, &ssplat::Limits::default()).unwrap();
        assert!(reader.read().unwrap().metadata().icc.as_ref() == Some(&icc));
    }
}

/// Returns the contents of the first chunk `name` of a PNG.
fn chunk_of(png: &[u8], name: &[u8; 4]) -> Option<Vec<u8>> {
    let at = png.windows(4).position(|w| w == name)?;
    let length = u32::from_be_bytes(png[at - 4..at].try_into().unwrap()) as usize;
    Some(png[at + 4..at + 4 + length].to_vec())
}

#[test]
fn pq_hlg_and_narrow_range_pass_from_png_to_png() {
    let folder = Folder::new();
    let path = |name: &str| folder.root().join(name).to_str().unwrap().to_owned();
    for (bytes, name) in [
        ([9, 16, 0, 1], "BT.2020 primaries, PQ, full range"),
        ([9, 18, 0, 1], "BT.2020 primaries, HLG, full range"),
        ([1, 13, 0, 0], "BT.709 primaries, sRGB transfer, narrow range"),
    ] {
        // A profile beside code points is ignored, as in PNG.
        let profile = [&b"p\0\0"[..], &[0x78, 0x9c, 3, 0, 0, 0, 0, 1]].concat();
        folder.file("a.png", &png_with(&[(b"cICP", &bytes), (b"iCCP", &profile)]));
        for more in [&[][..], &["--tiles=128"], &["--max-side", "32"], &["--auto-orient"], &["--metadata", "all"]] {
            let (icc, said) = profile_of(&folder, Path::new(&path("a.png")), more);
            assert!(icc.is_none() && !said.contains("cICP"), "{more:?}: {said}");
            let info = ssplat(&["info", &path("o.ssplat")]);
            let text = String::from_utf8_lossy(&info.stdout).into_owned();
            assert!(text.contains(&format!("colours     {name}\n")), "{more:?}: {text}");
            for more in [&[][..], &["--auto-orient"], &["--thumbnail", "20"]] {
                let found = ssplat(&[&["decode", &path("o.ssplat"), &path("b.png")][..], more].concat());
                assert!(found.status.success() && found.stderr.is_empty(), "{}", told(&found));
                let png = fs::read(path("b.png")).unwrap();
                assert_eq!(chunk_of(&png, b"cICP"), Some(bytes.to_vec()), "{more:?}");
                assert!(png.windows(4).position(|w| w == b"cICP") < png.windows(4).position(|w| w == b"IDAT"));
            }
        }
        // JPEG has no code points.
        let jpeg = ssplat(&["decode", &path("o.ssplat"), &path("b.jpg")]);
        assert!(jpeg.status.success() && told(&jpeg).contains(name), "{}", told(&jpeg));
        // By the library, and from one ssplat file to another.
        ssplat::Encoder::new().effort(1).bytes(2000).transcode(path("a.png"), path("t.ssplat")).unwrap();
        ssplat::Encoder::new().effort(1).bytes(2000).transcode(path("t.ssplat"), path("u.ssplat")).unwrap();
        for file in ["t.ssplat", "u.ssplat"] {
            let file = fs::read(path(file)).unwrap();
            let metadata = ssplat::Reader::new(&file, &ssplat::Limits::default()).unwrap().metadata().unwrap();
            assert_eq!((metadata.cicp, metadata.icc), (ssplat::Cicp::from_bytes(&bytes).ok(), None));
        }
        // The user's own profile replaces them.
        let icc = vec![1; 200];
        ssplat::Encoder::new()
            .effort(1)
            .bytes(2000)
            .icc(icc.clone())
            .transcode(path("a.png"), path("t.ssplat"))
            .unwrap();
        let file = fs::read(path("t.ssplat")).unwrap();
        let metadata = ssplat::Reader::new(&file, &ssplat::Limits::default()).unwrap().metadata().unwrap();
        assert_eq!((metadata.cicp, metadata.icc), (None, Some(icc)));
        let (_, said) = profile_of(&folder, Path::new(&path("a.png")), &["--metadata", "none"]);
        let info = String::from_utf8_lossy(&ssplat(&["info", &path("o.ssplat")]).stdout).into_owned();
        assert!(!info.contains("\ncolours  "), "{said}: {info}");
    }
    let (icc, said) = profile_of(&folder, &folder.file("a.png", &png_with(&[(b"cICP", &[9, 16, 9, 1])])), &[]);
    assert!(icc.is_none() && said.contains("invalid"), "{said}");
}

/// Returns a profile for sRGB.
fn srgb() -> Vec<u8> {
    let png = png_with(&[(b"cICP", &[1, 13, 0, 1])]);
    let stated = look(&mut Cursor::new(png), Profiles::Read).unwrap();
    stated.or(None).unwrap()
}

#[test]
fn a_profile_that_says_srgb_is_left_out_unless_it_is_asked_for() {
    let folder = Folder::new();
    let profile = srgb();
    let mut png = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut png);
    encoder.set_icc_profile(profile.clone()).unwrap();
    encoder.write_image(picture().as_raw(), 64, 40, image::ExtendedColorType::Rgb8).unwrap();
    let input = folder.file("a.png", &png);
    let (icc, said) = profile_of(&folder, &input, &[]);
    assert!(icc.is_none() && !said.contains("profile"), "{said}");
    assert_eq!(profile_of(&folder, &input, &["--metadata", "all"]).0, Some(profile.clone()));
    assert_eq!(profile_of(&folder, &input, &["--metadata", "icc"]).0, Some(profile));
}

#[test]
fn the_profile_of_a_small_tiff_is_kept() {
    let folder = Folder::new();
    let p3 = png_with(&[(b"cICP", &[12, 13, 0, 1])]);
    let profile = look(&mut Cursor::new(p3), Profiles::Read).unwrap().or(None).unwrap();
    let mut tiff = Cursor::new(Vec::new());
    let mut encoder = image::codecs::tiff::TiffEncoder::new(&mut tiff);
    encoder.set_icc_profile(profile.clone()).unwrap();
    encoder.write_image(&[90; 300], 10, 10, image::ExtendedColorType::Rgb8).unwrap();
    let (icc, _) = profile_of(&folder, &folder.file("a.tif", &tiff.into_inner()), &[]);
    assert_eq!(icc, Some(profile));
}

#[test]
fn a_file_larger_than_its_input_is_told() {
    let folder = Folder::new();
    let flat = RgbImage::from_fn(64, 64, |x, _| image::Rgb([if x < 32 { 255 } else { 0 }; 3]));
    let mut png = Cursor::new(Vec::new());
    DynamicImage::from(flat).write_to(&mut png, ImageFormat::Png).unwrap();
    let png = png.into_inner();
    assert!(png.len() < 400);
    let input = folder.file("a.png", &png);
    let out = folder.root().join("o.ssplat");
    let encode = |gaussians: &str| {
        let args =
            ["encode", input.to_str().unwrap(), out.to_str().unwrap(), "--effort", "1", "--gaussians", gaussians];
        said(&ssplat(&args))
    };
    assert!(encode("900").contains("more than the"), "{}", encode("900"));
    assert!(!encode("2").contains("more than the"));
}

#[test]
fn an_opaque_gif_becomes_rgb_and_one_with_clear_pixels_does_not() {
    let folder = Folder::new();
    let gif = folder.file("a.gif", &encoded(ImageFormat::Gif));
    let channels = |input: &Path| {
        let out = folder.root().join("o.ssplat");
        let args = ["encode", input.to_str().unwrap(), out.to_str().unwrap(), "--effort", "1", "--bytes", "300"];
        assert!(ssplat(&args).status.success());
        let bytes = fs::read(&out).unwrap();
        ssplat::Reader::new(&bytes, &ssplat::Limits::default()).unwrap().header().channels
    };
    assert_eq!(channels(&gif), ssplat::Channels::Rgb);
    let mut clear = DynamicImage::from(picture()).into_rgba8();
    clear.pixels_mut().take(64 * 20).for_each(|p| p.0[3] = 0);
    let mut bytes = Cursor::new(Vec::new());
    DynamicImage::from(clear).write_to(&mut bytes, ImageFormat::Gif).unwrap();
    assert_eq!(channels(&folder.file("b.gif", bytes.get_ref())), ssplat::Channels::Rgba);
}

#[test]
fn further_pictures_of_a_jpeg_are_told() {
    let folder = Folder::new();
    let jpeg = encoded(ImageFormat::Jpeg);
    let mpo = [&jpeg[..2], &[0xFF, 0xE2, 0, 10], b"MPF\0II*\0", &jpeg[2..]].concat();
    let (_, said) = profile_of(&folder, &folder.file("a.jpg", &mpo), &[]);
    assert!(said.contains("only the first"), "{said}");
    let (_, said) = profile_of(&folder, &folder.file("b.jpg", &jpeg), &[]);
    assert!(!said.contains("only the first"), "{said}");
}

#[test]
fn the_gain_map_of_a_jpeg_is_told() {
    let folder = Folder::new();
    let jpeg = encoded(ImageFormat::Jpeg);
    let with = |marker: u8, body: &[u8]| {
        let length = (body.len() as u16 + 2).to_be_bytes();
        [&jpeg[..2], &[0xFF, marker], &length, body, &jpeg[2..]].concat()
    };
    let xmp = |body: &str| format!("http://ns.adobe.com/xap/1.0/\0<rdf:Description {body}/>").into_bytes();
    for (marker, body, is_gain_map) in [
        // ISO 21496-1 without an index of pictures.
        (0xE2, b"urn:iso:std:iso:ts:21496:-1\0\0\0\0\0".to_vec(), true),
        (0xE1, xmp("xmlns:hdrgm=\"http://ns.adobe.com/hdr-gain-map/1.0/\" hdrgm:Version=\"1.0\""), true),
        (0xE1, xmp("HDRGainMap:HDRGainMapVersion=\"65536\""), true),
        (0xE1, xmp("dc:title=\"a gain map\""), false),
    ] {
        let (_, said) = profile_of(&folder, &folder.file("a.jpg", &with(marker, &body)), &[]);
        assert_eq!(said.contains("its gain map is left out"), is_gain_map, "{said}");
    }
}

#[test]
fn the_thumbnail_of_a_raw_file_is_not_taken_for_the_picture() {
    let folder = Folder::new();
    let mut tiff = encoded(ImageFormat::Tiff);
    // The first entry of the directory becomes NewSubfileType 1: a reduced version of another picture.
    let directory = u32::from_le_bytes(tiff[4..8].try_into().unwrap()) as usize;
    let count = u16::from_le_bytes(tiff[directory..directory + 2].try_into().unwrap());
    let mut entries = tiff[directory + 2..directory + 2 + 12 * usize::from(count)].to_vec();
    entries.splice(0..0, [254, 0, 4, 0, 1, 0, 0, 0, 1, 0, 0, 0]);
    let at = (tiff.len() as u32).next_multiple_of(2);
    tiff.resize(at as usize, 0);
    tiff.extend((count + 1).to_le_bytes());
    tiff.extend(entries);
    tiff.extend([0; 4]);
    tiff[4..8].copy_from_slice(&at.to_le_bytes());
    let input = folder.file("a.dng", &tiff);
    let found = ssplat(&["placeholder", input.to_str().unwrap()]);
    assert_eq!(found.status.code(), Some(5), "{}", said(&found));
    assert!(said(&found).contains("raw"), "{}", said(&found));
}

#[test]
fn the_exif_note_is_told_once_a_folder() {
    let folder = Folder::new();
    let inside = folder.root().join("in");
    fs::create_dir(&inside).unwrap();
    for name in ["a.png", "b.png", "c.png"] {
        fs::write(inside.join(name), png_with(&[(b"eXIf", &[&b"II*\0\x08\0\0\0\0\0\0\0\0\0"[..], &[0; 90]].concat())]))
            .unwrap();
    }
    let out = folder.root().join("out");
    let args =
        ["encode", inside.to_str().unwrap(), "--out-dir", out.to_str().unwrap(), "--effort", "1", "--bytes", "300"];
    let found = ssplat(&args);
    let said = said(&found);
    assert_eq!(said.matches("EXIF").count(), 1, "{said}");
    assert!(said.contains("3 files") && said.contains("--metadata all"), "{said}");
}

#[test]
fn formats_are_listed() {
    let found = ssplat(&["formats"]);
    let text = String::from_utf8(found.stdout).unwrap();
    for format in ["BMP", "Farbfeld", "GIF", "JPEG", "Netpbm", "PNG", "QOI", "Targa", "TIFF", "WebP", "ssplat"] {
        let line = text.lines().find(|line| line.starts_with(format)).unwrap_or_else(|| panic!("{format}: {text}"));
        assert_eq!(line.contains("written"), format != "GIF", "{line}");
    }
    assert!(text.contains(".jpg") && text.contains("not read          .heic"), "{text}");
}

#[test]
fn an_element_without_a_source_is_not_made_from_standard_input() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ssplat"));
    let found =
        command.args(["placeholder", "-", "--format", "html"]).stdin(std::process::Stdio::null()).output().unwrap();
    assert_eq!(found.status.code(), Some(2), "{}", said(&found));
    assert!(said(&found).contains("--src"), "{}", said(&found));
}

#[cfg(unix)]
#[test]
fn control_characters_of_names_and_profiles_are_shown_escaped() {
    let folder = Folder::new();
    let mut profile = srgb();
    profile[16..20].copy_from_slice(b"\x1b[2J");
    let mut png = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut png);
    encoder.set_icc_profile(profile).unwrap();
    encoder.write_image(picture().as_raw(), 64, 40, image::ExtendedColorType::Rgb8).unwrap();
    let input = folder.file("\x1b]0;owned\x07.png", &png);
    let out = folder.root().join("\x1b[31m.ssplat");
    let args = ["encode", input.to_str().unwrap(), out.to_str().unwrap(), "--effort", "1", "--bytes", "300"];
    for found in
        [ssplat(&args), ssplat(&["compare", out.to_str().unwrap(), folder.root().join("\x1bno").to_str().unwrap()])]
    {
        let all = [found.stdout, found.stderr].concat();
        let all = String::from_utf8_lossy(&all);
        assert!(!all.contains('\x1b') && all.contains("\\u{1b}"), "{all:?}");
    }
}
