//! What people ask for at a shell: times that are kept, pictures that are resized, files that are never larger, and
//! plain answers for formats that are not read.

use std::fs::{self, File, FileTimes};
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, SystemTime};

use crate::folder::Folder;
use image::{DynamicImage, ImageEncoder, Rgb, RgbImage};
use serde_json::Value;

fn ssplat(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ssplat")).args(args).output().unwrap()
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn said(output: &Output) -> String {
    assert!(output.status.success(), "{}", told(output));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A photograph-like picture of so many pixels.
fn picture(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        Rgb([(x * 255 / width) as u8, (y * 255 / height) as u8, (x * y % 251) as u8])
    })
}

fn png(folder: &Folder, name: &str, width: u32, height: u32) -> std::path::PathBuf {
    let path = folder.path(name);
    picture(width, height).save(&path).unwrap();
    path
}

/// Makes a file older than the others: its modification and access times.
fn age(path: &Path) -> [SystemTime; 2] {
    let [modified, accessed] = [1_000_000_000, 1_100_000_000].map(|s| SystemTime::UNIX_EPOCH + Duration::from_secs(s));
    let file = File::options().write(true).open(path).unwrap();
    file.set_times(FileTimes::new().set_modified(modified).set_accessed(accessed)).unwrap();
    [modified, accessed]
}

fn times(path: &Path) -> [SystemTime; 2] {
    let found = fs::metadata(path).unwrap();
    [found.modified().unwrap(), found.accessed().unwrap()]
}

/// A picture of two pixels in fewer bytes than any .ssplat file has.
const TINY: &[u8] = b"P6\n2 1\n255\n\x09\x09\x09\xFF\x09\x09";

const FAST: [&str; 4] = ["--effort", "1", "--bytes", "2000"];

#[test]
fn outputs_get_the_times_of_their_inputs_when_asked() {
    let folder = Folder::new();
    let input = png(&folder, "a.png", 64, 40);
    let (coded, out, dir) = (folder.path("a.ssplat"), folder.path("o.png"), folder.path("dir"));
    let encode = |more: &[&str]| said(&ssplat(&[&["encode", text(&input), text(&coded)][..], &FAST, more].concat()));
    let aged = age(&input);
    encode(&[]);
    assert_ne!(times(&coded)[0], aged[0]);
    age(&input);
    encode(&["--keep-times"]);
    assert_eq!(times(&coded), aged);
    // In tiles, where the picture stays in its file.
    age(&input);
    encode(&["--keep-times", "--tiles=128"]);
    assert_eq!(times(&coded), aged);
    for more in [&[][..], &["--thumbnail", "16"], &["--auto-orient", "--background", "ffffff"]] {
        age(&coded);
        said(&ssplat(&[&["decode", text(&coded), text(&out), "--keep-times"][..], more].concat()));
        assert_eq!(times(&out), aged, "{more:?}");
    }
    age(&input);
    said(&ssplat(&[&["encode", text(&input), "--out-dir", text(&dir), "--keep-times"][..], &FAST].concat()));
    assert_eq!(times(&dir.join("a.ssplat")), aged);
}

#[test]
fn standard_input_and_output_have_no_times_to_keep() {
    let folder = Folder::new();
    let input = png(&folder, "a.png", 64, 40);
    let out = folder.path("a.ssplat");
    for (paths, name) in [(["-", text(&out)], "standard input"), ([text(&input), "-"], "standard output")] {
        let found = ssplat(&["encode", paths[0], paths[1], "--keep-times"]);
        assert_eq!(found.status.code(), Some(2), "{}", told(&found));
        assert!(told(&found).contains(name) && !out.exists(), "{}", told(&found));
    }
}

#[test]
fn max_side_resizes_larger_pictures_alone_and_keeps_profile_and_orientation() {
    let folder = Folder::new();
    let out = folder.path("o.ssplat");
    let size = |input: &Path, more: &[&str]| {
        let args = [&["encode", text(input), text(&out), "--json"][..], &FAST, more].concat();
        let found: Value = serde_json::from_str(&said(&ssplat(&args))).unwrap();
        ["width", "height"].map(|name| found[name].as_u64().unwrap())
    };
    let input = png(&folder, "a.png", 300, 200);
    assert_eq!(size(&input, &["--max-side", "150"]), [150, 100]);
    assert_eq!(size(&input, &["--max-side", "150", "--tiles=128"]), [150, 100]);
    assert_eq!(size(&input, &["--max-side", "300"]), [300, 200]);
    assert_eq!(size(&input, &["--max-side", "5000"]), [300, 200]);
    // Orientation 6, and a profile that is not sRGB.
    let exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    let mut jpeg = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut jpeg);
    encoder.set_exif_metadata(exif.to_vec()).unwrap();
    let icc = moxcms::ColorProfile::new_display_p3().encode().unwrap();
    encoder.set_icc_profile(icc.clone()).unwrap();
    DynamicImage::from(picture(300, 200)).write_with_encoder(encoder).unwrap();
    let jpeg = folder.file("a.jpg", &jpeg);
    assert_eq!(size(&jpeg, &["--max-side", "150"]), [150, 100]);
    let shown = folder.path("shown.png");
    said(&ssplat(&["decode", text(&out), text(&shown), "--auto-orient"]));
    assert_eq!(image::image_dimensions(&shown).unwrap(), (100, 150));
    let found: Value = serde_json::from_str(&said(&ssplat(&["info", text(&out), "--json"]))).unwrap();
    assert_eq!(found["icc_bytes"].as_u64(), Some(icc.len() as u64));
    assert_eq!(size(&jpeg, &["--max-side", "150", "--auto-orient"]), [100, 150]);
    let refused = ssplat(&["encode", text(&input), text(&out), "--max-side", "0"]);
    assert_eq!(refused.status.code(), Some(2), "{}", told(&refused));
}

/// Of 68 000 × 4000 pixels, more than are fitted as a whole. The file has no blocks on disk.
#[test]
fn a_huge_picture_is_resized_in_bands_and_then_fits_the_time() {
    let folder = Folder::new();
    let input = folder.file("huge.pgm", b"P5\n68000 4000\n255\n");
    let header = fs::metadata(&input).unwrap().len();
    File::options().write(true).open(&input).unwrap().set_len(header + 68_000 * 4000).unwrap();
    let out = folder.path("o.ssplat");
    let args = ["encode", text(&input), text(&out), "--max-side", "340", "--time", "30", "--json", "--effort", "1"];
    let found: Value = serde_json::from_str(&said(&ssplat(&args))).unwrap();
    assert_eq!((found["width"].as_u64(), found["height"].as_u64()), (Some(340), Some(20)));
}

#[test]
fn a_file_that_would_be_larger_than_its_input_is_left_out_when_asked() {
    let folder = Folder::new();
    let (inside, dir) = (folder.path("in"), folder.path("out"));
    fs::create_dir(&inside).unwrap();
    let small = inside.join("small.ppm");
    fs::write(&small, TINY).unwrap();
    picture(200, 100).save(inside.join("large.png")).unwrap();
    let out = folder.path("o.ssplat");
    let encode = |more: &[&str]| ssplat(&[&["encode", text(&small), text(&out)][..], more].concat());
    let found = encode(&[]);
    assert!(told(&found).contains("more than") && out.exists(), "{}", told(&found));
    fs::remove_file(&out).unwrap();
    let found = encode(&["--skip-larger"]);
    assert!(said(&found).is_empty() && !out.exists(), "{}", said(&found));
    assert!(told(&found).contains("small.ppm: no file is written"), "{}", told(&found));
    let found: Value = serde_json::from_str(&said(&encode(&["--skip-larger", "--json"]))).unwrap();
    let input = fs::metadata(&small).unwrap().len();
    assert_eq!((&found["written"], &found["input_bytes"]), (&false.into(), &input.into()));
    assert!(found["bytes"].as_u64().unwrap() > input && !out.exists());
    // What is there already stays as it is.
    fs::write(&out, "old").unwrap();
    said(&encode(&["--skip-larger", "--quiet"]));
    assert_eq!(fs::read(&out).unwrap(), b"old");
    let manifest = folder.path("m.jsonl");
    let args = ["encode", text(&inside), "--out-dir", text(&dir), "--skip-larger", "--manifest", text(&manifest)];
    let found = ssplat(&[&args[..], &["--effort", "1", "--bytes", "300"]].concat());
    assert!(said(&found).contains("1 files done, 1 skipped (1 larger than the input), 0 failed"), "{}", said(&found));
    assert!(dir.join("large.ssplat").exists() && !dir.join("small.ssplat").exists());
    let lines = fs::read_to_string(manifest).unwrap();
    let written: Vec<bool> = lines
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap()["result"]["written"].as_bool().unwrap())
        .collect();
    assert!(written.contains(&true) && written.contains(&false), "{lines}");
}

#[test]
fn nothing_is_written_to_standard_output_or_a_preview_for_a_file_that_is_left_out() {
    let folder = Folder::new();
    let small = folder.file("small.ppm", TINY);
    let preview = folder.path("p.png");
    let found = ssplat(&["encode", text(&small), "-", "--skip-larger", "--preview", text(&preview)]);
    assert!(said(&found).is_empty() && !preview.exists());
}

/// The first bytes of files by phones and cameras.
const HEIC: &[u8] = b"\0\0\0\x24ftypheic\0\0\0\0mif1MiHBMiHEMiPrmiafheic";

#[test]
fn a_heic_file_is_named_with_what_to_do() {
    let folder = Folder::new();
    let (inside, dir) = (folder.path("in"), folder.path("out"));
    fs::create_dir(&inside).unwrap();
    fs::write(inside.join("IMG_1.HEIC"), HEIC).unwrap();
    picture(30, 20).save(inside.join("a.png")).unwrap();
    let heic = inside.join("IMG_1.HEIC");
    let out = folder.path("o.ssplat");
    for args in [
        &["encode", text(&heic), text(&out)][..],
        &["compare", text(&heic), text(&heic)],
        &["placeholder", text(&heic)],
    ] {
        let found = ssplat(args);
        assert_eq!(found.status.code(), Some(5), "{}", told(&found));
        let told = told(&found);
        assert!(told.contains("IMG_1.HEIC: is a HEIC file") && told.contains("heif-convert IN.heic OUT.png"), "{told}");
    }
    let found = ssplat(&[&["encode", text(&inside), "--out-dir", text(&dir)][..], &FAST].concat());
    assert_eq!(found.status.code(), Some(5));
    assert!(told(&found).contains("IMG_1.HEIC: is a HEIC file") && dir.join("a.ssplat").exists(), "{}", told(&found));
    let mut child = Command::new(env!("CARGO_BIN_EXE_ssplat"));
    child.args(["encode", "-", text(&out)]).stdin(Stdio::piped()).stderr(Stdio::piped());
    let mut child = child.spawn().unwrap();
    child.stdin.take().unwrap().write_all(HEIC).unwrap();
    let found = child.wait_with_output().unwrap();
    assert_eq!(found.status.code(), Some(5));
    assert!(told(&found).contains("standard input: is a HEIC file"), "{}", told(&found));
}

#[test]
fn the_list_of_formats_says_what_is_built_in() {
    let said = said(&ssplat(&["formats"]));
    let line =
        |name: &str| said.lines().find(|line| line.starts_with(name)).unwrap_or_else(|| panic!("{name}: {said}"));
    assert_eq!(line("JPEG XL").contains("not in this build"), !cfg!(feature = "jxl"));
    assert_eq!(line("AVIF").contains("not in this build"), !cfg!(feature = "avif"));
    assert!(line("HEIC").contains("not read") && line("PNG").contains("read, written"));
    if !cfg!(feature = "avif") {
        let folder = Folder::new();
        let input = folder.file("a.avif", b"\0\0\0\x1cftypmif1\0\0\0\0mif1avifmiaf");
        let found = ssplat(&["placeholder", text(&input)]);
        assert_eq!(found.status.code(), Some(5));
        assert!(
            told(&found).contains("a.avif: is an AVIF file, which this build does not support"),
            "{}",
            told(&found)
        );
    }
}

#[test]
fn a_drawing_that_a_png_holds_better_is_named() {
    let folder = Folder::new();
    let (drawing, photo, out) = (folder.path("d.png"), png(&folder, "p.png", 200, 150), folder.path("o.ssplat"));
    let line =
        |x: u32, y: u32| Rgb(if x.is_multiple_of(40) || y.is_multiple_of(30) { [0; 3] } else { [255, 250, 240] });
    RgbImage::from_fn(200, 150, line).save(&drawing).unwrap();
    let encode = |input: &Path, more: &[&str]| {
        let found = ssplat(&[&["encode", text(input), text(&out), "--effort", "2", "--force"][..], more].concat());
        said(&found);
        told(&found)
    };
    let found = encode(&drawing, &["--detail", "off"]);
    assert!(found.contains("d.png: this picture is a drawing of 2 colours: a lossless PNG of it takes "), "{found}");
    let found = encode(&drawing, &["--detail", "off", "--bytes", "90"]);
    assert!(found.contains("its lines are blurred (PSNR "), "{found}");
    // Without loss, the file is smaller than a PNG.
    assert!(!encode(&drawing, &[]).contains("drawing"));
    assert!(!encode(&photo, &[]).contains("drawing"));
    assert!(!encode(&drawing, &["--quiet"]).contains("drawing"));
}
