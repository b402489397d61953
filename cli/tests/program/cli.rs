//! Guarantees of the command line: results, exit statuses, messages, and no incomplete files.

use std::ffi::OsStr;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use crate::folder::Folder;
use image::{DynamicImage, ImageDecoder, ImageEncoder, ImageReader};

const PHOTO: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/images/kodim05.png");

impl Folder {
    /// Writes a small picture of ramps to `name`.
    fn picture(&self, name: &str) -> PathBuf {
        let path = self.path(name);
        small().save(&path).unwrap();
        path
    }

    /// Writes a part of the photograph to `name`.
    fn part(&self, name: &str, width: u32, height: u32) -> PathBuf {
        let path = self.path(name);
        image::open(PHOTO).unwrap().crop_imm(200, 100, width, height).save(&path).unwrap();
        path
    }

    /// Writes an .ssplat file of a few Gaussians to `name`.
    fn encoded(&self, name: &str) -> PathBuf {
        let source = self.picture("source.png");
        let path = self.path(name);
        succeeds(ssplat(&[&"encode", &source, &path, &"--gaussians", &"40", &"--effort", &"1"]));
        fs::remove_file(source).unwrap();
        path
    }
}

fn small() -> DynamicImage {
    image::RgbImage::from_fn(60, 40, |x, y| image::Rgb([x as u8 * 4, y as u8 * 6, (x * y / 10) as u8])).into()
}

fn command(args: &[&dyn AsRef<OsStr>]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ssplat"));
    command.args(args.iter().map(|a| a.as_ref()));
    command
}

fn ssplat(args: &[&dyn AsRef<OsStr>]) -> Output {
    command(args).output().unwrap()
}

/// Runs the program with `input` on standard input.
fn fed(args: &[&dyn AsRef<OsStr>], input: &[u8]) -> Output {
    let mut child = command(args).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(input).unwrap();
    child.wait_with_output().unwrap()
}

#[track_caller]
fn succeeds(output: Output) -> String {
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// Checks the exit status, and that the error is one line with `message`.
#[track_caller]
fn fails(output: Output, status: i32, message: &str) {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(status), "{said}");
    assert!(said.contains(message), "{said:?} does not contain {message:?}");
    assert!(output.stdout.is_empty() && !said.contains("panicked"), "{said}");
}

/// Returns the number under `key` of a flat JSON object.
fn number(json: &str, key: &str) -> f64 {
    let value: serde_json::Value = serde_json::from_str(json).unwrap();
    value[key].as_f64().unwrap_or_else(|| panic!("{key} in {json}"))
}

#[test]
fn encode_decode_and_compare_agree_on_a_photograph() {
    let folder = Folder::new();
    let (file, preview, decoded) = (folder.path("k.ssplat"), folder.path("p.png"), folder.path("d.png"));
    let json = succeeds(ssplat(&[
        &"encode",
        &PHOTO,
        &file,
        &"--ratio",
        &"200",
        &"--effort",
        &"1",
        &"--preview",
        &preview,
        &"--json",
    ]));
    let bytes = fs::metadata(&file).unwrap().len();
    assert_eq!(number(&json, "bytes") as u64, bytes);
    assert!(bytes as f64 <= 768.0 * 512.0 * 3.0 / 200.0, "{bytes} bytes are more than requested");
    succeeds(ssplat(&[&"decode", &file, &decoded]));
    assert_eq!(fs::read(&preview).unwrap(), fs::read(&decoded).unwrap());
    let measured = succeeds(ssplat(&[&"compare", &PHOTO, &file, &"--json"]));
    assert_eq!(measured, succeeds(ssplat(&[&"compare", &PHOTO, &decoded, &"--json"])));
    assert!((number(&measured, "psnr") - number(&json, "psnr")).abs() < 0.01, "{measured} {json}");
    // Measured: 21.89 dB, SSIM .552, MS-SSIM .860, SSIMULACRA2 -26.6, Butteraugli 7.0. A single fit scatters by .25 dB;
    // the bounds allow twice that, and as much for the other metrics. No encoder comes near the upper bounds at this
    // ratio.
    for (measure, least, most) in [
        ("psnr", 21.39, 30.0),
        ("ssim", 0.52, 0.9),
        ("ms_ssim", 0.84, 0.97),
        ("ssimulacra2", -32.4, 60.0),
        ("butteraugli", 1.0, 9.0),
    ] {
        assert!((least..most).contains(&number(&measured, measure)), "{measure}: {measured}");
    }
    assert_eq!(folder.names(), ["d.png", "k.ssplat", "p.png"]);
}

#[test]
fn perceptual_tuning_looks_better_and_costs_about_a_decibel() {
    let folder = Folder::new();
    let [psnr, iq] = ["psnr", "iq"].map(|tune| {
        let file = folder.path(tune);
        succeeds(ssplat(&[&"encode", &PHOTO, &file, &"--ratio", &"200", &"--effort", &"4", &"--tune", &tune]));
        succeeds(ssplat(&[&"compare", &PHOTO, &file, &"--json"]))
    });
    let gain = |key| number(&iq, key) - number(&psnr, key);
    // Measured: +13.8, +.007 and -.89 dB. A single fit scatters by .25 dB.
    assert!(gain("ssimulacra2") > 2.0 && gain("ms_ssim") > 0.0 && gain("psnr") > -1.5, "{psnr} {iq}");
}

#[test]
fn the_file_does_not_depend_on_the_thread_count() {
    let folder = Folder::new();
    let part = folder.part("a.png", 384, 256);
    let file = |threads: &str| {
        let path = folder.path(threads);
        succeeds(ssplat(&[&"encode", &part, &path, &"--ratio", &"300", &"--effort", &"1", &"--threads", &threads]));
        fs::read(path).unwrap()
    };
    assert!(file("1") == file("2"));
}

#[test]
fn standard_input_and_output_work_like_files() {
    let folder = Folder::new();
    let picture = fs::read(folder.picture("a.png")).unwrap();
    let encoded = fed(&[&"encode", &"-", &"-", &"--gaussians", &"20", &"--effort", &"1"], &picture);
    assert!(encoded.status.success(), "{encoded:?}");
    let png = fed(&[&"decode", &"-", &"-"], &encoded.stdout);
    let decoded = image::load_from_memory(&png.stdout).unwrap();
    assert_eq!((decoded.width(), decoded.height()), (60, 40));
    let ppm = fed(&[&"decode", &"-", &"-", &"--format", &"ppm"], &encoded.stdout);
    assert_eq!(ppm.stdout, [b"P6\n60 40\n255\n", decoded.as_bytes()].concat());
    succeeds(fed(&[&"info", &"-"], &encoded.stdout));
    succeeds(fed(&[&"compare", &"-", &folder.path("a.png")], &encoded.stdout));
}

#[test]
#[cfg(not(feature = "gpu"))]
fn a_build_without_gpu_support_refuses_a_gpu() {
    let folder = Folder::new();
    let (source, file) = (folder.picture("a.png"), folder.encoded("a.ssplat"));
    let (out, png) = (folder.path("b.ssplat"), folder.path("b.png"));
    fails(ssplat(&[&"encode", &source, &out, &"--backend", &"gpu"]), 1, "this build has no GPU support");
    fails(ssplat(&[&"decode", &file, &png, &"--backend", &"gpu"]), 1, "this build has no GPU support");
    assert_eq!(folder.names(), ["a.png", "a.ssplat"]);
}

#[test]
fn the_parts_of_info_add_up_to_the_file() {
    let folder = Folder::new();
    let file = folder.encoded("a.ssplat");
    let text = succeeds(ssplat(&[&"info", &file, &"--json"]));
    let info: serde_json::Value = serde_json::from_str(&text).unwrap();
    let sum: u64 = info["parts"].as_array().unwrap().iter().map(|p| p["bytes"].as_u64().unwrap()).sum();
    assert_eq!(sum, fs::metadata(&file).unwrap().len());
    assert_eq!(info["bytes"].as_u64().unwrap(), sum);
    assert_eq!((info["width"].as_u64(), info["height"].as_u64()), (Some(60), Some(40)));
    assert!(info["gaussians"].as_u64().unwrap() <= 40);
    assert!(succeeds(ssplat(&[&"info", &file])).contains("60 x 40 pixels, rgb, 8 bits"));
}

#[test]
fn encode_and_info_report_what_was_left_out() {
    let folder = Folder::new();
    let (picture, file) = (folder.path("grey.png"), folder.path("grey.ssplat"));
    let grey = |x: u32, y: u32| (x * 3 + y) as u8 ^ (8 * (y as u8 % 2));
    let opaque = |x, y| image::Rgba([grey(x, y), grey(x, y), grey(x, y), 255]);
    image::RgbaImage::from_fn(60, 40, opaque).save(&picture).unwrap();
    let text = succeeds(ssplat(&[&"encode", &picture, &file, &"--bytes", &"300", &"--effort", &"1", &"--explain"]));
    assert!(text.contains("colour and alpha: all pixels are grey and opaque"), "{text}");
    assert!(text.contains("the GPU: the picture has fewer than 262144 pixels\n"), "{text}");
    assert!(text.contains("sections: no code points, ICC profile, EXIF block or thumbnail"), "{text}");
    assert!(fs::metadata(&file).unwrap().len() <= 300);
    let info: serde_json::Value = serde_json::from_str(&succeeds(ssplat(&[&"info", &file, &"--json"]))).unwrap();
    let left_out = info["left_out"].as_array().unwrap();
    let levels = left_out.iter().find(|l| l["what"].as_str().unwrap().starts_with("progressive levels")).unwrap();
    // Measured: a file of the same Gaussians with levels is larger by this much.
    assert!(levels["bytes_saved"].as_u64().unwrap() > 0, "{info}");
    assert!(succeeds(ssplat(&[&"info", &file])).contains("left out\n"));
}

#[test]
fn every_output_format_holds_the_same_pixels() {
    let folder = Folder::new();
    let file = folder.encoded("a.ssplat");
    for extension in ["png", "ppm", "pnm", "pam", "webp", "bmp", "tiff", "qoi", "tga", "ff"] {
        let out = folder.path(&format!("out.{extension}"));
        succeeds(ssplat(&[&"decode", &file, &out]));
        assert_eq!(number(&succeeds(ssplat(&[&"compare", &file, &out, &"--json"])), "psnr"), 99.0, "{extension}");
    }
    let jpeg = folder.path("out.jpg");
    succeeds(ssplat(&[&"decode", &file, &jpeg]));
    assert!(number(&succeeds(ssplat(&[&"compare", &file, &jpeg, &"--json"])), "psnr") > 35.0);
}

#[test]
fn a_region_equals_a_crop_of_the_whole() {
    let folder = Folder::new();
    let file = folder.encoded("a.ssplat");
    let (whole, part) = (folder.path("whole.png"), folder.path("part.png"));
    succeeds(ssplat(&[&"decode", &file, &whole]));
    succeeds(ssplat(&[&"decode", &file, &part, &"--region", &"13,7,31,22"]));
    let cut = image::open(&whole).unwrap().crop_imm(13, 7, 31, 22);
    assert!(image::open(&part).unwrap() == cut);
}

#[test]
fn outputs_have_the_requested_sizes() {
    let folder = Folder::new();
    let file = folder.encoded("a.ssplat");
    let out = folder.path("out.png");
    let cases: [(&[&str], _); 6] = [
        (&["--width", "30"], (30, 20)),
        (&["--height", "60"], (90, 60)),
        (&["--width", "7", "--height", "90"], (7, 90)),
        (&["--scale", "2.5"], (150, 100)),
        (&["--scale", "0.001"], (1, 1)),
        (&["--region", "0,0,10,40", "--scale", "3"], (30, 120)),
    ];
    for (options, size) in cases {
        let mut args: Vec<&dyn AsRef<OsStr>> = vec![&"decode", &file, &out];
        args.extend(options.iter().map(|o| o as &dyn AsRef<OsStr>));
        succeeds(ssplat(&args));
        assert_eq!(image::image_dimensions(&out).unwrap(), size, "{options:?}");
    }
}

#[test]
fn an_eighth_of_the_width_is_the_average_of_the_pixels() {
    let folder = Folder::new();
    let part = folder.part("part.png", 384, 256);
    let (file, whole, small) = (folder.path("photo.ssplat"), folder.path("whole.png"), folder.path("small.png"));
    // Values beyond black and white are clipped at full size, but only after averaging in a reduced view.
    succeeds(ssplat(&[&"encode", &part, &file, &"--ratio", &"50", &"--effort", &"1", &"--detail", &"off"]));
    succeeds(ssplat(&[&"decode", &file, &whole]));
    succeeds(ssplat(&[&"decode", &file, &small, &"--width", &"48"]));
    let (whole, small) = (image::open(whole).unwrap().to_rgb8(), image::open(small).unwrap().to_rgb8());
    assert_eq!(small.dimensions(), (48, 32));
    for (x, y, pixel) in small.enumerate_pixels() {
        for c in 0..3 {
            let block = (0..64).map(|k| f32::from(whole.get_pixel(8 * x + k % 8, 8 * y + k / 8)[c]));
            // Half a code value for the rounding of each.
            assert!((f32::from(pixel[c]) - block.sum::<f32>() / 64.0).abs() <= 1.0, "{x},{y}");
        }
    }
}

/// An ICC profile of 500 bytes, of which only the colour space (RGB) is valid.
fn rgb_profile() -> Vec<u8> {
    [&[7u8; 16][..], b"RGB ", &[7; 480]].concat()
}

/// A PNG with an ICC profile and an EXIF block.
fn tagged(path: &Path, icc: &[u8], exif: &[u8]) {
    let mut encoder = image::codecs::png::PngEncoder::new(fs::File::create(path).unwrap());
    encoder.set_icc_profile(icc.to_vec()).unwrap();
    encoder.set_exif_metadata(exif.to_vec()).unwrap();
    small().write_with_encoder(encoder).unwrap();
}

#[test]
fn icc_profile_and_exif_pass_from_png_to_png() {
    let folder = Folder::new();
    let (source, file, out) = (folder.path("s.png"), folder.path("f.ssplat"), folder.path("o.png"));
    let (icc, exif) = (rgb_profile(), b"II*\0\x08\0\0\0\0\0\0\0\0\0".to_vec());
    tagged(&source, &icc, &exif);
    let all = ["--metadata", "all"];
    succeeds(quick(&source, &file, &all));
    for extension in ["png", "webp", "jpg"] {
        let out = out.with_extension(extension);
        succeeds(ssplat(&[&"decode", &file, &out]));
        let mut decoder = ImageReader::open(&out).unwrap().into_decoder().unwrap();
        assert_eq!(decoder.icc_profile().unwrap().as_ref(), Some(&icc), "{extension}");
        assert_eq!(decoder.exif_metadata().unwrap().as_ref(), Some(&exif), "{extension}");
    }
    // Also from one .ssplat file to another.
    let again = folder.path("again.ssplat");
    succeeds(quick(&file, &again, &all));
    let info: serde_json::Value = serde_json::from_str(&succeeds(ssplat(&[&"info", &again, &"--json"]))).unwrap();
    assert_eq!(info["icc_bytes"].as_u64(), Some(500));
    assert_eq!(info["exif_bytes"].as_u64(), Some(exif.len() as u64));
}

/// Returns the lengths of the profile and the EXIF block in a file.
fn metadata_of(file: &Path) -> [u64; 2] {
    let info: serde_json::Value = serde_json::from_str(&succeeds(ssplat(&[&"info", &file, &"--json"]))).unwrap();
    ["icc_bytes", "exif_bytes"].map(|key| info[key].as_u64().unwrap_or(0))
}

#[test]
fn camera_notes_are_dropped_and_the_orientation_is_kept() {
    let folder = Folder::new();
    let (source, file) = (folder.path("s.png"), folder.path("f.ssplat"));
    // A block with Rotate90 and much more.
    let exif = [exif_of(6), vec![5; 20_000]].concat();
    tagged(&source, &rgb_profile(), &exif);
    // A size that is too small for the notes.
    let asked = ["--bytes", "900", "--effort", "1"];
    let encode = |more: &[&str]| command(&[&"encode", &source, &file]).args(asked).args(more).output().unwrap();
    let said = told(encode(&[]));
    assert!(said.contains("20026 bytes is left out except for the orientation; --metadata all"), "{said}");
    assert_eq!(metadata_of(&file), [500, 26]);
    let out = folder.path("o.png");
    succeeds(ssplat(&[&"decode", &file, &out]));
    assert_eq!(ImageReader::open(&out).unwrap().into_decoder().unwrap().orientation().unwrap().to_exif(), 6);
    // The profile takes more than half of the file, which is reported.
    assert!(said.contains("its ICC profile and EXIF block take 526 of"), "{said}");
    assert!(told(encode(&["--metadata", "icc"])).contains("its orientation is left out; --auto-orient"));
    assert_eq!(metadata_of(&file), [500, 0]);
    let said = told(encode(&["--metadata", "none", "--auto-orient"]));
    assert!(said.is_empty(), "{said}");
    assert_eq!(metadata_of(&file), [0, 0]);
    fails(encode(&["--metadata", "all"]), 2, "900 bytes cannot hold the picture");
    fails(
        encode(&["--metadata", "all"]),
        2,
        "500 of them for the ICC profile and 20026 for the EXIF block; --metadata",
    );
    // In tiles, and without a requested size.
    let tiled = quick(&source, &file, &["--tiles=128"]);
    assert!(told(tiled).contains("--metadata all"));
    let said =
        told(command(&[&"encode", &source, &file, &"--effort", &"1"]).args(["--metadata", "all"]).output().unwrap());
    assert!(said.contains("its ICC profile and EXIF block take 20526 of"), "{said}");
    assert_eq!(metadata_of(&file), [500, 20026]);
}

#[test]
fn grey_alpha_and_sixteen_bits_are_preserved() {
    let folder = Folder::new();
    let pictures: [DynamicImage; 4] = [
        small().to_luma8().into(),
        small().to_luma_alpha16().into(),
        small().to_rgba8().into(),
        small().to_rgb16().into(),
    ];
    for picture in pictures {
        let (source, file, out) = (folder.path("s.png"), folder.path("f.ssplat"), folder.path("o.png"));
        picture.save(&source).unwrap();
        succeeds(ssplat(&[&"encode", &source, &file, &"--gaussians", &"30", &"--effort", &"1"]));
        succeeds(ssplat(&[&"decode", &file, &out]));
        assert_eq!(image::open(&out).unwrap().color(), picture.color());
    }
}

#[test]
fn odd_sizes_are_preserved() {
    let folder = Folder::new();
    for (width, height) in [(1, 1), (1, 4000), (4000, 1), (3, 2)] {
        let (source, file, out) = (folder.path("s.png"), folder.path("f.ssplat"), folder.path("o.png"));
        image::RgbImage::from_fn(width, height, |x, y| image::Rgb([(x + y) as u8, 90, 10])).save(&source).unwrap();
        succeeds(ssplat(&[&"encode", &source, &file, &"--bytes", &"120", &"--effort", &"1"]));
        // The quality of 70 takes hardly more than the samples.
        assert!(fs::metadata(&file).unwrap().len() <= 120 + u64::from(3 * width * height));
        succeeds(ssplat(&[&"decode", &file, &out]));
        assert_eq!(image::image_dimensions(&out).unwrap(), (width, height));
    }
}

#[test]
fn no_picture_is_too_small_without_a_requested_size() {
    let folder = Folder::new();
    let (tiny, file, out) = (folder.path("tiny.png"), folder.path("tiny.ssplat"), folder.path("out.png"));
    for (width, height) in [(1, 1), (8, 8), (1, 300)] {
        let pixel = |x, y| image::Rgb([(37 * x) as u8, (91 * y + 5 * x) as u8, (11 * x * y) as u8]);
        image::RgbImage::from_fn(width, height, pixel).save(&tiny).unwrap();
        succeeds(ssplat(&[&"encode", &tiny, &file]));
        // The quality of 70 takes hardly more than the samples.
        assert!(fs::metadata(&file).unwrap().len() <= 120 + u64::from(3 * width * height));
        succeeds(ssplat(&[&"decode", &file, &out]));
        assert_eq!(image::image_dimensions(&out).unwrap(), (width, height));
        // A requested size is met, or the command fails.
        fails(ssplat(&[&"encode", &tiny, &file, &"--ratio", &"500"]), 2, "cannot hold the picture");
    }
}

#[test]
fn compare_joins_channels_and_depths() {
    let folder = Folder::new();
    let colour = folder.picture("a.png");
    for (name, picture) in
        [("alpha.png", DynamicImage::from(small().to_rgba8())), ("deep.png", small().to_rgba16().into())]
    {
        let other = folder.path(name);
        picture.save(&other).unwrap();
        let json = succeeds(ssplat(&[&"compare", &colour, &other, &"--json"]));
        assert_eq!(number(&json, "psnr"), 99.0, "{name}");
        assert_eq!((number(&json, "ssimulacra2"), number(&json, "butteraugli")), (100.0, 0.0), "{name}");
        assert!(json.contains("\"ms_ssim\":null"), "{json}");
    }
    let grey = folder.path("grey.png");
    small().to_luma8().save(&grey).unwrap();
    assert!(number(&succeeds(ssplat(&[&"compare", &colour, &grey, &"--json"])), "psnr") < 40.0);
}

#[test]
fn wrong_usage_exits_with_2() {
    let folder = Folder::new();
    let (picture, out) = (folder.picture("a.png"), folder.path("o.ssplat"));
    for (options, message) in [
        (["--ratio", "0"], "--ratio"),
        (["--ratio", "-3"], "-3"),
        (["--ratio", "nan"], "nan"),
        (["--effort", "10"], "10"),
        (["--time", "0"], "--time"),
        (["--gaussians", "0"], "--gaussians"),
        (["--layout", "zip"], "zip"),
        (["--threads", "0"], "--threads"),
        (["--bytes", "1"], "a.png"),
    ] {
        fails(ssplat(&[&"encode", &picture, &out, &options[0], &options[1]]), 2, message);
    }
    fails(ssplat(&[&"encode", &picture, &out, &"--ratio", &"9", &"--bytes", &"900"]), 2, "--bytes");
    fails(ssplat(&[&"encode", &picture, &out, &"--preview", &out]), 2, "o.ssplat");
    fails(ssplat(&[&"encode", &picture, &"-", &"--json"]), 2, "--json");
    fails(ssplat(&[]), 2, "Usage");
    assert_eq!(folder.names(), ["a.png"]);

    let file = folder.encoded("a.ssplat");
    for (options, message) in [
        (["--region", "1,2,3"], "1,2,3"),
        (["--region", "1,2,0,3"], "empty"),
        (["--region", "50,0,20,20"], "--region 50,0,20,20 is not within the picture of 60×40"),
        (["--scale", "0"], "--scale"),
        (["--scale", "1e9"], "1048576"),
        (["--width", "0"], "--width"),
        (["--format", "xyz"], "xyz"),
    ] {
        fails(ssplat(&[&"decode", &file, &folder.path("o.png"), &options[0], &options[1]]), 2, message);
    }
    fails(ssplat(&[&"decode", &file, &folder.path("noextension")]), 2, "noextension");
    fails(
        ssplat(&[&"decode", &file, &folder.path("o.gif")]),
        2,
        "can be written: png, ppm, pgm, pnm, pam, bmp, ff, jpg, qoi, tga, ti",
    );
    fails(ssplat(&[&"compare", &file, &PHOTO]), 2, "the pictures differ in size: 60×40 and 768×512");
    assert_eq!(folder.names(), ["a.png", "a.ssplat"]);
}

#[test]
fn missing_files_and_folders_exit_with_3() {
    let folder = Folder::new();
    let picture = folder.picture("a.png");
    let (missing, out) = (folder.path("missing.ssplat"), folder.path("o.png"));
    fails(ssplat(&[&"decode", &missing, &out]), 3, "missing.ssplat");
    fails(ssplat(&[&"info", &missing]), 3, "missing.ssplat");
    fails(ssplat(&[&"compare", &picture, &missing]), 3, "missing.ssplat");
    fails(ssplat(&[&"encode", &missing, &folder.path("o.ssplat")]), 3, "missing.ssplat");
    fails(ssplat(&[&"encode", &picture, &folder.path("no/such/o.ssplat"), &"--effort", &"1"]), 3, "o.ssplat");
    assert_eq!(folder.names(), ["a.png"]);
}

#[test]
fn broken_files_exit_with_4_and_leave_nothing() {
    let folder = Folder::new();
    let file = folder.encoded("a.ssplat");
    let bytes = fs::read(&file).unwrap();
    let (bad, out) = (folder.path("bad.ssplat"), folder.path("o.png"));
    let flipped = |i: usize| [&bytes[..i], &[bytes[i] ^ 1], &bytes[i + 1..]].concat();
    for (broken, message) in [
        (bytes[..bytes.len() - 1].to_vec(), ""),
        (bytes[..30].to_vec(), ""),
        (Vec::new(), "bad.ssplat: empty (0 bytes), not an ssplat file"),
        (flipped(bytes.len() - 10), "checksum"),
        (b"not an ssplat file at all".to_vec(), "magic"),
        (b"\x89PNG\r\n\x1a\n".to_vec(), "not an ssplat file: it is a PNG picture"),
        // The library looks at four bytes, which these pictures do not state their format in.
        (b"RIFF\x24\0\0\0WEBPVP8L".to_vec(), "not an ssplat file: it is a WebP picture"),
        (b"\0\0\0\x14ftypavif\0\0\0\0avif".to_vec(), "not an ssplat file: it is an AVIF picture"),
    ] {
        fs::write(&bad, broken).unwrap();
        fails(ssplat(&[&"decode", &bad, &out]), 4, "bad.ssplat");
        fails(ssplat(&[&"info", &bad]), 4, message);
    }
    fs::write(&bad, &fs::read(PHOTO).unwrap()[..5000]).unwrap();
    fails(ssplat(&[&"encode", &bad, &folder.path("o.ssplat")]), 4, "bad.ssplat");
    assert_eq!(folder.names(), ["a.ssplat", "bad.ssplat"]);
}

#[test]
fn unknown_formats_and_versions_exit_with_5() {
    let folder = Folder::new();
    let (text, out) = (folder.path("text.png"), folder.path("o.ssplat"));
    fs::write(&text, "hello").unwrap();
    fails(ssplat(&[&"compare", &text, &text]), 4, "text.png");
    let unknown = folder.path("text.txt");
    fs::write(&unknown, "hello").unwrap();
    fails(ssplat(&[&"encode", &unknown, &out]), 5, "text.txt");
    let file = folder.encoded("a.ssplat");
    let mut bytes = fs::read(&file).unwrap();
    bytes[4] = 99;
    fs::write(&file, bytes).unwrap();
    fails(ssplat(&[&"info", &file]), 5, "99");
    assert_eq!(folder.names(), ["a.ssplat", "text.png", "text.txt"]);
}

#[test]
fn the_input_is_never_overwritten() {
    let folder = Folder::new();
    let picture = folder.picture("a.png");
    let before = fs::read(&picture).unwrap();
    let roundabout = folder.root().join(".").join("a.png");
    fails(ssplat(&[&"encode", &picture, &roundabout, &"--effort", &"1", &"--force"]), 2, "is the input");
    let file = folder.encoded("a.ssplat");
    fails(ssplat(&[&"encode", &file, &file, &"--effort", &"1"]), 2, "is the input");
    fails(ssplat(&[&"encode", &picture, &folder.path("x"), &"--preview", &picture]), 2, "is the input");
    assert_eq!(fs::read(&picture).unwrap(), before);
    assert_eq!(folder.names(), ["a.png", "a.ssplat"]);
}

#[test]
fn existing_outputs_are_replaced_whole_or_not_at_all() {
    let folder = Folder::new();
    let file = folder.encoded("a.ssplat");
    let out = folder.path("o.png");
    fs::write(&out, "before").unwrap();
    let bad = folder.path("bad.ssplat");
    fs::write(&bad, &fs::read(&file).unwrap()[..40]).unwrap();
    fails(ssplat(&[&"decode", &bad, &out]), 4, "bad.ssplat");
    assert_eq!(fs::read(&out).unwrap(), b"before");
    succeeds(ssplat(&[&"decode", &file, &out]));
    assert_eq!(image::image_dimensions(&out).unwrap(), (60, 40));
}

#[test]
#[cfg(unix)]
fn an_interrupt_leaves_nothing_behind() {
    let folder = Folder::new();
    let out = folder.path("o.ssplat");
    let mut child = command(&[&"encode", &PHOTO, &out, &"--ratio", &"20", &"--effort", &"9"])
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    // The temporary file shows that the work has started.
    let start = std::time::Instant::now();
    while folder.names().is_empty() {
        assert!(start.elapsed().as_secs() < 60, "no file was begun");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    std::thread::sleep(std::time::Duration::from_millis(300));
    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(folder.names().is_empty(), "{:?}", folder.names());
}

/// The main thread has a stack of 1 MiB on Windows and 8 MiB on Linux.
#[test]
#[cfg(unix)]
fn a_stack_as_small_as_on_windows_is_enough() {
    let folder = Folder::new();
    let (source, file, out) = (folder.picture("a.png"), folder.path("a.ssplat"), folder.path("out.png"));
    let limited = |args: &[&dyn AsRef<OsStr>]| {
        let mut shell = Command::new("sh");
        shell.args(["-c", "ulimit -s 1024 && exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_ssplat")]);
        succeeds(shell.args(args.iter().map(|a| a.as_ref())).output().unwrap());
    };
    limited(&[&"encode", &PHOTO, &file, &"--ratio", &"100", &"--effort", &"1", &"--threads", &"1"]);
    limited(&[&"encode", &source, &file, &"--quality", &"60", &"--effort", &"2", &"--layout", &"planes"]);
    limited(&[&"encode", &PHOTO, &file, &"--ratio", &"100", &"--effort", &"1", &"--tiles"]);
    limited(&[&"decode", &file, &out]);
    limited(&[&"compare", &PHOTO, &file]);
    limited(&[&"info", &file]);
    limited(&[&"export", &file, &folder.path("a.npz")]);
    limited(&[&"import", &folder.path("a.npz"), &folder.path("b.ssplat")]);
    limited(&[&"placeholder", &source]);
    limited(&[&"view", &file, &"--html", &folder.path("a.html")]);
    limited(&[&"man"]);
}

/// On Unix, the shell expands patterns.
#[test]
#[cfg(windows)]
fn patterns_are_expanded() {
    let folder = Folder::new();
    folder.picture("a.png");
    folder.picture("b.png");
    let out = folder.path("out");
    succeeds(ssplat(&[&"encode", &folder.path("*.png"), &"--out-dir", &out, &"--effort", &"1"]));
    assert!(out.join("a.ssplat").is_file() && out.join("b.ssplat").is_file());
}

/// Returns what the program prints on a terminal.
#[cfg(unix)]
fn on_a_terminal(args: &[&dyn AsRef<OsStr>]) -> String {
    use std::io::Read;
    let nix::pty::OpenptyResult { master, slave } = nix::pty::openpty(None, None).unwrap();
    let reader = std::thread::spawn(move || {
        let (mut file, mut said, mut part) = (fs::File::from(master), Vec::new(), [0; 4096]);
        // Reading fails when the other side is closed.
        while let Ok(count @ 1..) = file.read(&mut part) {
            said.extend_from_slice(&part[..count]);
        }
        String::from_utf8(said).unwrap()
    });
    // Without this variable, terminals count as unable to draw a bar.
    let mut terminal = command(args);
    let mut child = terminal.env("TERM", "xterm").stdout(Stdio::null()).stderr(Stdio::from(slave)).spawn().unwrap();
    // The command holds the other side of the terminal too.
    drop(terminal);
    assert!(child.wait().unwrap().success());
    reader.join().unwrap()
}

#[test]
#[cfg(unix)]
fn a_quiet_run_draws_no_bar() {
    let folder = Folder::new();
    let source = folder.picture("a.png");
    let (file, out) = (folder.path("a.ssplat"), folder.path("out"));
    let one: [&dyn AsRef<OsStr>; 6] = [&"encode", &source, &file, &"--effort", &"1", &"--quiet"];
    let many: [&dyn AsRef<OsStr>; 7] = [&"encode", &source, &"--out-dir", &out, &"--effort", &"1", &"--quiet"];
    assert_eq!(on_a_terminal(&one), "");
    assert_eq!(on_a_terminal(&many), "");
    let many: [&dyn AsRef<OsStr>; 7] = [&"encode", &source, &"--out-dir", &out, &"--effort", &"1", &"--overwrite"];
    assert!(on_a_terminal(&many).contains("a.png"), "there is a bar where it is not quiet");
}

#[test]
#[cfg(unix)]
fn outputs_have_ordinary_permissions_and_links_and_devices_are_kept() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new();
    let file = folder.encoded("a.ssplat");
    let plain = folder.path("plain");
    fs::write(&plain, "").unwrap();
    assert_eq!(fs::metadata(&file).unwrap().permissions().mode(), fs::metadata(&plain).unwrap().permissions().mode());
    let (link, target) = (folder.path("link.png"), folder.path("target.png"));
    fs::write(&target, "").unwrap();
    fs::set_permissions(&target, fs::Permissions::from_mode(0o600)).unwrap();
    std::os::unix::fs::symlink(&target, &link).unwrap();
    succeeds(ssplat(&[&"decode", &file, &link]));
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert_eq!(image::image_dimensions(&target).unwrap(), (60, 40));
    assert_eq!(fs::metadata(&target).unwrap().permissions().mode() & 0o777, 0o600);
    succeeds(ssplat(&[&"decode", &file, &"/dev/null", &"--format", &"png"]));
    assert!(!fs::metadata("/dev/null").unwrap().is_file());
}

#[test]
fn help_shows_examples() {
    for name in ["encode", "decode", "info", "compare", "export", "import"] {
        assert!(succeeds(ssplat(&[&name, &"--help"])).contains("Examples:"), "{name}");
    }
    assert!(succeeds(ssplat(&[&"--help"])).contains("Exit status"));
}

/// Writes a JPEG of `picture`, with `icc` if there is one.
fn jpeg(path: &Path, icc: Option<&[u8]>, picture: &DynamicImage) {
    let mut encoder = image::codecs::jpeg::JpegEncoder::new(fs::File::create(path).unwrap());
    if let Some(icc) = icc {
        encoder.set_icc_profile(icc.to_vec()).unwrap();
    }
    picture.write_with_encoder(encoder).unwrap();
}

/// Returns an EXIF block that contains only an orientation.
fn exif_of(orientation: u8) -> Vec<u8> {
    let entry = [0x12, 0x01, 3, 0, 1, 0, 0, 0, orientation, 0, 0, 0];
    [&b"II*\0\x08\0\0\0\x01\0"[..], &entry, &[0; 4]].concat()
}

/// Returns what a successful run printed on standard error.
#[track_caller]
fn told(output: Output) -> String {
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stderr).unwrap()
}

const QUICK: [&str; 4] = ["--gaussians", "20", "--effort", "1"];

/// Runs `encode` for one file with few Gaussians.
fn quick(input: &Path, output: &Path, more: &[&str]) -> Output {
    let mut command = command(&[&"encode", &input, &output]);
    command.args(QUICK).args(more).output().unwrap()
}

#[cfg(unix)]
#[test]
fn other_files_are_refused_by_their_start_whatever_their_length() {
    let folder = Folder::new();
    let (endless, out) = (Path::new("/dev/zero"), folder.path("out.png"));
    fails(ssplat(&[&"info", &endless]), 4, "/dev/zero");
    fails(ssplat(&[&"decode", &endless, &out]), 4, "/dev/zero");
    fails(ssplat(&[&"export", &endless, &folder.path("out.npz")]), 4, "/dev/zero");
    assert!(!out.exists());
    // Three bytes, of which the first is right.
    let short = folder.path("short.ssplat");
    fs::write(&short, b"\x89SS").unwrap();
    fails(ssplat(&[&"info", &short]), 4, "short.ssplat");
}

#[test]
fn a_truncated_picture_is_refused_in_every_format() {
    let folder = Folder::new();
    let out = folder.path("o.ssplat");
    for extension in ["jpg", "png", "webp", "gif", "bmp", "tiff", "tga", "qoi", "ppm", "pam", "ff"] {
        let (whole, cut) = (folder.path(&format!("whole.{extension}")), folder.path(&format!("cut.{extension}")));
        match extension {
            "ff" => DynamicImage::from(small().to_rgba16()).save(&whole).unwrap(),
            _ => small().save(&whole).unwrap(),
        }
        told(quick(&whole, &out, &[]));
        fs::remove_file(&out).unwrap();
        let bytes = fs::read(&whole).unwrap();
        for length in [bytes.len() / 2, bytes.len() * 9 / 10] {
            fs::write(&cut, &bytes[..length]).unwrap();
            fails(quick(&cut, &out, &[]), 4, "cut.");
            assert!(!out.exists());
        }
    }
    // The intact part of a JPEG can be encoded.
    let cut = folder.path("cut.jpg");
    assert!(told(quick(&cut, &out, &["--partial"])).contains("cut off"));
}

#[test]
fn a_jpeg_with_a_thumbnail_in_its_exif_block_must_have_its_own_end() {
    let folder = Folder::new();
    let (plain, cut, out) = (folder.path("a.jpg"), folder.path("cut.jpg"), folder.path("o.ssplat"));
    jpeg(&plain, None, &small());
    let bytes = fs::read(&plain).unwrap();
    // The segment contains the end marker of a thumbnail.
    let thumbnail = [&[0xFF, 0xE1, 0, 12][..], b"Exif\0\0", &[0xFF, 0xD9, 1, 2]].concat();
    let with = [&bytes[..2], &thumbnail, &bytes[2..]].concat();
    fs::write(&plain, &with).unwrap();
    told(quick(&plain, &out, &[]));
    fs::write(&cut, &with[..with.len() - 30]).unwrap();
    fails(quick(&cut, &out, &[]), 4, "cut.jpg");
}

#[test]
fn a_profile_for_other_channels_is_dropped_and_reported() {
    let folder = Folder::new();
    let (source, out) = (folder.path("a.jpg"), folder.path("o.ssplat"));
    let profile = |space: &[u8; 4]| [&[7u8; 16][..], space, &[7; 100]].concat();
    let grey = DynamicImage::from(small().to_luma8());
    for (picture, space, kept) in
        [(small(), b"RGB ", true), (small(), b"CMYK", false), (grey.clone(), b"RGB ", false), (grey, b"GRAY", true)]
    {
        jpeg(&source, Some(&profile(space)), &picture);
        let said = told(quick(&source, &out, &[]));
        assert_eq!(said.contains("ICC profile is for"), !kept, "{said}");
        let info: serde_json::Value = serde_json::from_str(&succeeds(ssplat(&[&"info", &out, &"--json"]))).unwrap();
        assert_eq!(info["icc_bytes"].as_u64(), kept.then_some(120));
        assert!(told(quick(&source, &out, &["--quiet"])).is_empty());
    }
}

#[test]
fn an_output_with_the_extension_of_another_format_needs_force() {
    let folder = Folder::new();
    let (a, b) = (folder.picture("a.png"), folder.picture("b.png"));
    let before = fs::read(&b).unwrap();
    for name in ["b.png", "c.jpg", "c.JPEG", "c.avif", "c.heic", "c.jxl", "c.webp"] {
        fails(quick(&a, &folder.path(name), &[]), 2, "--force");
    }
    assert_eq!(fs::read(&b).unwrap(), before);
    assert_eq!(folder.names(), ["a.png", "b.png"]);
    told(quick(&a, &b, &["--force"]));
    assert!(fs::read(&b).unwrap() != before);
}

#[test]
fn losses_are_reported() {
    let folder = Folder::new();
    let (source, file) = (folder.path("a.png"), folder.path("a.ssplat"));
    tagged(&source, &rgb_profile(), &exif_of(6));
    let said = told(quick(&source, &file, &[]));
    assert!(!said.contains("left out;"), "{said}");
    for (extension, words) in [
        ("png", &[][..]),
        ("jpg", &[]),
        ("webp", &[]),
        ("tiff", &["EXIF", "orientation"][..]),
        ("bmp", &["ICC", "EXIF", "orientation"]),
        ("qoi", &["ICC", "EXIF", "orientation"]),
        ("tga", &["ICC", "EXIF", "orientation"]),
        ("ppm", &["ICC", "EXIF", "orientation"]),
    ] {
        let said = told(ssplat(&[&"decode", &file, &folder.path(&format!("o.{extension}"))]));
        assert_eq!(said.is_empty(), words.is_empty(), "{said}");
        words.iter().for_each(|word| assert!(said.contains(word), "{said} lacks {word}"));
    }
    // More than one frame.
    let frames = folder.path("frames.gif");
    let mut gif = image::codecs::gif::GifEncoder::new(fs::File::create(&frames).unwrap());
    gif.encode_frames((0..2).map(|_| image::Frame::new(small().to_rgba8()))).unwrap();
    drop(gif);
    assert!(told(quick(&frames, &file, &[])).contains("only the first"));
}

#[test]
fn a_thumbnail_is_stored_and_rendered_on_request() {
    let folder = Folder::new();
    let (source, with, out) = (folder.part("a.png", 384, 256), folder.path("with.ssplat"), folder.path("small.png"));
    succeeds(ssplat(&[&"encode", &source, &with, &"--bytes", &"2000", &"--thumbnail", &"600", &"--effort", &"1"]));
    assert!(fs::metadata(&with).unwrap().len() <= 2000);
    let bytes = number(&succeeds(ssplat(&[&"info", &with, &"--json"])), "thumbnail_bytes");
    assert!((500.0..=600.0).contains(&bytes), "{bytes}");
    let drawn = |option: &str| {
        succeeds(ssplat(&[&"decode", &with, &out, &option, &"100"]));
        let picture = image::open(&out).unwrap();
        fs::remove_file(&out).unwrap();
        picture
    };
    let (small, exact) = (drawn("--thumbnail"), drawn("--width"));
    assert_eq!((small.width(), small.height()), (100, 67));
    assert_ne!(small, exact);
    fails(ssplat(&[&"decode", &with, &out, &"--thumbnail", &"100", &"--region", &"0,0,9,9"]), 2, "--region");
    fails(ssplat(&[&"encode", &source, &out, &"--thumbnail", &"large"]), 2, "large");
    fails(ssplat(&[&"encode", &source, &with, &"--bytes", &"2000", &"--thumbnail", &"9"]), 2, "9 bytes");
    assert_eq!(folder.names(), ["a.png", "with.ssplat"]);
}

#[test]
fn auto_orient_rotates_the_pixels_and_updates_the_exif_block() {
    let folder = Folder::new();
    let (source, file, out) = (folder.path("a.png"), folder.path("a.ssplat"), folder.path("o.png"));
    tagged(&source, &rgb_profile(), &exif_of(6));
    let kept = |path: &Path| ImageReader::open(path).unwrap().into_decoder().unwrap().exif_metadata().unwrap();
    told(quick(&source, &file, &["--auto-orient"]));
    told(ssplat(&[&"decode", &file, &out]));
    // A block without rotation is not needed.
    assert_eq!((image::image_dimensions(&out).unwrap(), kept(&out)), ((40, 60), None));
    told(quick(&source, &file, &["--auto-orient", "--metadata", "all"]));
    told(ssplat(&[&"decode", &file, &out]));
    assert_eq!((image::image_dimensions(&out).unwrap(), kept(&out)), ((40, 60), Some(exif_of(1))));
    // The same for decode.
    told(quick(&source, &file, &[]));
    told(ssplat(&[&"decode", &file, &out, &"--auto-orient"]));
    assert_eq!((image::image_dimensions(&out).unwrap(), kept(&out)), ((40, 60), Some(exif_of(1))));
    let plain = folder.path("plain.png");
    told(ssplat(&[&"decode", &file, &plain]));
    assert!(image::open(&plain).unwrap().rotate90() == image::open(&out).unwrap());
}

#[test]
fn a_transparent_picture_is_composited_over_the_background() {
    let folder = Folder::new();
    let (source, file) = (folder.path("a.png"), folder.path("a.ssplat"));
    // Fully transparent red.
    image::RgbaImage::from_pixel(16, 16, image::Rgba([255, 0, 0, 0])).save(&source).unwrap();
    told(quick(&source, &file, &[]));
    let jpeg = folder.path("o.jpg");
    assert!(told(ssplat(&[&"decode", &file, &jpeg])).contains("--background"));
    assert!(image::open(&jpeg).unwrap().to_rgb8().pixels().all(|p| p.0.iter().all(|&v| v > 250)));
    let png = folder.path("o.png");
    assert!(told(ssplat(&[&"decode", &file, &png, &"--background", &"102030"])).is_empty());
    let covered = image::open(&png).unwrap();
    assert_eq!(covered.color(), image::ColorType::Rgb8);
    assert!(covered.to_rgb8().pixels().all(|p| p.0 == [0x10, 0x20, 0x30]));
}

#[test]
#[cfg(unix)]
fn a_dangling_link_is_followed() {
    let folder = Folder::new();
    let source = folder.picture("a.png");
    std::os::unix::fs::symlink("target.ssplat", folder.path("link.ssplat")).unwrap();
    told(quick(&source, &folder.path("link.ssplat"), &[]));
    assert_eq!(folder.names(), ["a.png", "link.ssplat", "target.ssplat"]);
    assert!(fs::symlink_metadata(folder.path("link.ssplat")).unwrap().is_symlink());
    assert!(fs::symlink_metadata(folder.path("target.ssplat")).unwrap().is_file());
}

#[test]
fn useless_threads_and_primitives_are_not_used() {
    let folder = Folder::new();
    let (source, out) = (folder.path("a.png"), folder.path("o.ssplat"));
    image::GrayImage::from_fn(9, 7, |x, y| image::Luma([(x * 28 + y * 3) as u8])).save(&source).unwrap();
    assert!(told(quick(&source, &out, &["--threads", "100000"])).contains("--threads 100000"));
    let many = ssplat(&[&"encode", &source, &out, &"--gaussians", &"16777216", &"--effort", &"1"]);
    assert!(told(many).contains("63 are enough"));
}

#[test]
fn messages_name_the_options_that_were_given() {
    let folder = Folder::new();
    let (picture, out) = (folder.picture("a.png"), folder.path("no/such/o.ssplat"));
    let said = quick(&picture, &out, &[]);
    assert!(!String::from_utf8_lossy(&said.stderr).contains(".ssplat-"), "{said:?}");
    fails(said, 3, "no/such/o.ssplat");
    let out = folder.path("o.ssplat");
    fails(ssplat(&[&"encode", &picture, &out, &"--ratio", &"1e9"]), 2, "a ratio of 1000000000 leaves 0 bytes");
    fails(fed(&[&"encode", &"-", &out], b""), 4, "standard input: empty (0 bytes), not a picture");
    let heic = folder.path("a.heic");
    fs::write(&heic, b"\0\0\0\x1cftypheic\0\0\0\0heicmif1miaf").unwrap();
    fails(ssplat(&[&"encode", &heic, &out]), 5, "heif-convert");
    let avif = folder.path("a.avif");
    fs::write(&avif, b"\0\0\0\x1cftypavif\0\0\0\0avifmif1miaf").unwrap();
    fails(ssplat(&[&"encode", &avif, &out]), if cfg!(feature = "avif") { 4 } else { 5 }, "a.avif: ");
    let file = folder.encoded("b.ssplat");
    fails(ssplat(&[&"decode", &file, &folder.path("o.png"), &"--scale", &"1e30"]), 2, "1048576 at most");
}

#[test]
fn invalid_values_are_reported_in_plain_words() {
    let folder = Folder::new();
    let (picture, out) = (folder.picture("a.png"), folder.path("o.ssplat"));
    for (option, value, message) in [
        ("--bytes", "twenty", "not a number of bytes such as 20000, 20k or 1.5M"),
        ("--bytes", "-5k", "not a number of bytes"),
        ("--quality", "101", "not a number from 0 to 100"),
        ("--threads", "0", "not a whole number of at least 1"),
        ("--time", "0", "not a positive number"),
    ] {
        fails(ssplat(&[&"encode", &picture, &out, &format!("{option}={value}")]), 2, message);
    }
    fails(ssplat(&[&"encode", &folder.path("."), &out]), 3, "is a folder; --out-dir");
    fails(ssplat(&[&"decode", &folder.path("."), &folder.path("o.png")]), 3, "is a folder; --out-dir");
    // Thousands of bytes, and short options.
    let short: [&dyn AsRef<OsStr>; 8] = [&"encode", &picture, &"-o", &out, &"-b", &".3k", &"-e", &"1"];
    succeeds(ssplat(&short));
    let bytes = fs::metadata(&out).unwrap().len();
    assert!((250..=300).contains(&bytes), "{bytes}");
    fails(ssplat(&[&"encode", &picture, &out, &"-o", &out]), 2, "several inputs need --out-dir");
    fails(ssplat(&[&"encode", &picture, &out, &"--tiles", &"512"]), 2, "--tiles=512");
}

#[test]
fn a_quality_is_met_or_reported_as_missed() {
    let folder = Folder::new();
    let (file, out) = (folder.path("k.ssplat"), folder.path("o.png"));
    let (picture, noise) = (folder.part("k.png", 160, 120), folder.path("n.png"));
    let run = |input: &Path, quality: &str, detail: &str| {
        let target: [&dyn AsRef<OsStr>; 5] = [&"encode", &input, &file, &"-q", &quality];
        let more: [&dyn AsRef<OsStr>; 7] = [&"--effort", &"1", &"--detail", &detail, &"--json", &"--preview", &out];
        ssplat(&[&target[..], &more].concat())
    };
    let met = run(&picture, "60", "auto");
    assert!(told(met.clone()).is_empty(), "{met:?}");
    let json = succeeds(met);
    let measured: serde_json::Value = serde_json::from_str(&json).unwrap();
    let seen = measured["preview"]["ssimulacra2"].as_f64().unwrap();
    assert!((seen - 60.0).abs() <= 0.5 && (number(&json, "quality") - seen).abs() < 1e-6, "{json}");
    image::GrayImage::from_fn(24, 24, |x, y| image::Luma([(x * 7919 + y * 104_729) as u8])).save(&noise).unwrap();
    assert!(told(run(&noise, "100", "off")).contains("--quality 100 was not met: the file has "));
    assert!(told(run(&noise, "100", "auto")).contains("--quality 100 is met without loss"));
    // Without a target, the quality is 70.
    let json = succeeds(ssplat(&[&"encode", &picture, &file, &"--effort", &"1", &"--json"]));
    assert!((number(&json, "quality") - 70.0).abs() <= 0.5, "{json}");
    let help = succeeds(ssplat(&[&"encode", &"--help"]));
    let words: Vec<&str> = help.split_whitespace().collect();
    assert!(words.join(" ").contains("30 low, 50 medium, 70 high"), "{help}");
}

#[test]
#[cfg(unix)]
fn a_preview_that_cannot_be_written_leaves_no_file() {
    let folder = Folder::new();
    let (picture, file) = (folder.picture("a.png"), folder.path("a.ssplat"));
    let full = folder.path("full.png");
    std::os::unix::fs::symlink("/dev/full", &full).unwrap();
    fails(quick(&picture, &file, &["--preview", full.to_str().unwrap()]), 3, "full.png");
    assert_eq!(folder.names(), ["a.png", "full.png"]);
}

#[test]
#[cfg(unix)]
fn a_terminal_shows_progress_from_the_start() {
    let folder = Folder::new();
    let file = folder.path("k.ssplat");
    // The bar is drawn ten times a second. Without a detail layer, every stage takes a multiple of that; with one,
    // "finish" takes 0.03 s.
    let part = folder.part("a.png", 200, 150);
    let said = on_a_terminal(&[&"encode", &part, &file, &"--ratio", &"50", &"--detail", &"off"]);
    let place = |word: &str| said.find(word).unwrap_or_else(|| panic!("{said:?} lacks {word}"));
    assert!(place("reading") < place("fit") && place("fit") < place("finish"), "{said:?}");
    assert!(said.contains(" to go)"), "{said:?}");
}

#[test]
fn a_time_limit_applies_to_the_whole_command() {
    let folder = Folder::new();
    let file = folder.path("k.ssplat");
    let start = std::time::Instant::now();
    let json =
        succeeds(ssplat(&[&"encode", &PHOTO, &file, &"--psnr", &"20", &"--effort", &"9", &"--time", &"3", &"--json"]));
    let seconds = start.elapsed().as_secs_f64();
    assert!(number(&json, "psnr") >= 20.0, "{json}");
    // Effort 9 takes minutes for each of several tries. Twice the limit allows for a busy machine.
    assert!(seconds < 6.0, "{seconds}");
    // A limit beyond the range of the clock is no limit.
    succeeds(ssplat(&[&"encode", &folder.picture("a.png"), &file, &"--time", &"1e19", &"--effort", &"1"]));
}

#[test]
fn a_time_limit_ends_the_reading_of_a_huge_picture() {
    let folder = Folder::new();
    let (source, file) = (folder.path("huge.png"), folder.path("k.ssplat"));
    // A file of a few thousand bytes with one bit per pixel, which takes hundreds of megabytes of disk.
    let bits = |side: u32| {
        let mut encoder = png::Encoder::new(fs::File::create(&source).unwrap(), side, side);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::One);
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(&vec![0; (side as usize / 8) * side as usize]).unwrap();
    };
    bits(16_000);
    let late = ssplat(&[&"encode", &source, &file, &"--tiles=2048", &"--effort", &"1", &"--time", &"0.02"]);
    fails(late, 6, "--time ran out after");
    assert_eq!(folder.names(), ["huge.png"]);
}

#[test]
fn info_of_several_files_reports_each_and_fails_for_broken_ones() {
    let folder = Folder::new();
    let file = folder.encoded("a.ssplat");
    let copy = folder.path("b.ssplat");
    fs::copy(&file, &copy).unwrap();
    let lines = succeeds(ssplat(&[&"info", &file, &copy, &"--json"]));
    let named: Vec<String> = lines
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()["file"].as_str().unwrap().to_owned())
        .collect();
    assert_eq!(named, [file.display().to_string(), copy.display().to_string()]);
    fs::write(&file, "broken").unwrap();
    let said = ssplat(&[&"info", &file, &copy]);
    assert_eq!(said.status.code(), Some(4), "{said:?}");
    assert!(String::from_utf8_lossy(&said.stderr).contains("a.ssplat"));
    assert!(String::from_utf8_lossy(&said.stdout).contains("b.ssplat:"));
}

#[test]
fn a_loss_of_depth_is_reported() {
    let folder = Folder::new();
    let (source, file) = (folder.path("deep.png"), folder.path("deep.ssplat"));
    small().to_luma16().save(&source).unwrap();
    told(quick(&source, &file, &[]));
    for (extension, is_lost) in [("jpg", true), ("bmp", true), ("webp", true), ("png", false), ("tiff", false)] {
        let said = told(ssplat(&[&"decode", &file, &folder.path(&format!("o.{extension}"))]));
        assert_eq!(said.contains("rounded to 8"), is_lost, "{extension}: {said}");
    }
}

/// Runs `encode` for several inputs.
fn many(inputs: &[&Path], folder: &Path, more: &[&str]) -> Output {
    let mut command = command(&[&"encode"]);
    command.args(inputs).arg("--out-dir").arg(folder).args(QUICK).args(more).output().unwrap()
}

#[test]
fn a_single_output_is_replaced_with_and_without_the_option() {
    let folder = Folder::new();
    small().save(folder.path("a.png")).unwrap();
    for options in [&[][..], &["--overwrite"]] {
        let file = folder.path("a.ssplat");
        fs::write(&file, "something else").unwrap();
        succeeds(quick(&folder.path("a.png"), &file, options));
        assert!(fs::metadata(&file).unwrap().len() > 20);
        assert!(fs::read(&file).unwrap() != b"something else");
    }
}

#[test]
fn a_batch_gives_the_same_files_and_a_broken_input_stops_no_other() {
    let folder = Folder::new();
    fs::create_dir_all(folder.path("in/deep")).unwrap();
    for name in ["in/a.png", "in/b.png", "in/deep/c.png"] {
        small().save(folder.path(name)).unwrap();
    }
    fs::write(folder.path("in/bad.png"), "no picture").unwrap();
    fs::write(folder.path("in/notes.txt"), "not asked for").unwrap();
    let (input, out, manifest) = (folder.path("in"), folder.path("out"), folder.path("m.jsonl"));
    let alone = folder.path("alone.ssplat");
    told(quick(&folder.path("in/a.png"), &alone, &[]));
    let options = ["--recursive", "--jobs", "3", "--skip-existing", "--manifest", manifest.to_str().unwrap()];
    let first = many(&[&input], &out, &options);
    assert_eq!(first.status.code(), Some(4), "{first:?}");
    let said = String::from_utf8(first.stderr).unwrap();
    assert!(said.contains("bad.png") && said.contains("1 of 4 files failed"), "{said}");
    for name in ["a.ssplat", "b.ssplat", "deep/c.ssplat"] {
        assert!(fs::read(out.join(name)).unwrap() == fs::read(&alone).unwrap(), "{name}");
    }
    assert!(!out.join("bad.ssplat").exists() && !out.join("notes.ssplat").exists());
    // A second run resumes: only the failed input is tried again.
    small().save(folder.path("in/bad.png")).unwrap();
    let time = fs::metadata(out.join("a.ssplat")).unwrap().modified().unwrap();
    let second = many(&[&input], &out, &options);
    assert!(succeeds(second).contains("1 files done, 3 skipped, 0 failed"));
    assert_eq!(fs::metadata(out.join("a.ssplat")).unwrap().modified().unwrap(), time);
    let lines: Vec<serde_json::Value> =
        fs::read_to_string(&manifest).unwrap().lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(lines.len(), 5);
    assert_eq!(lines.iter().filter(|l| l["error"].is_string()).count(), 1);
    // Existing outputs are not replaced without --overwrite.
    fails(many(&[&folder.path("in/a.png")], &out, &["--quiet"]), 2, "--overwrite");
    succeeds(many(&[&folder.path("in/a.png")], &out, &["--overwrite"]));
    // The same for decode.
    let back = folder.path("back");
    succeeds(ssplat(&[&"decode", &out, &"--out-dir", &back, &"--recursive", &"--format", &"ppm"]));
    for name in ["a.ppm", "b.ppm", "bad.ppm", "deep/c.ppm"] {
        assert_eq!(image::image_dimensions(back.join(name)).unwrap(), (60, 40));
    }
}

#[test]
fn several_inputs_need_a_folder_and_distinct_outputs() {
    let folder = Folder::new();
    let (a, b) = (folder.picture("a.png"), folder.picture("b.png"));
    fails(ssplat(&[&"encode", &a, &b, &folder.path("c.ssplat")]), 2, "--out-dir");
    fails(ssplat(&[&"encode", &a]), 2, "--out-dir");
    let twin = folder.path("a.bmp");
    small().save(&twin).unwrap();
    let out = folder.path("out");
    // Two inputs with the same stem keep their extensions.
    succeeds(many(&[&a, &twin, &b], &out, &[]));
    let mut names: Vec<_> = fs::read_dir(&out).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["a.bmp.ssplat", "a.png.ssplat", "b.ssplat"]);
    fs::remove_dir_all(&out).unwrap();
    // All collisions are reported at once, before any work is done.
    fs::create_dir(folder.path("deep")).unwrap();
    let [c, d] = ["deep/a.png", "deep/b.png"].map(|name| folder.picture(name));
    let all = [&a, &b, &c, &d, &a].map(|path| path.as_path());
    let said = many(&all, &out, &[]);
    for pair in [[&a, &c], [&b, &d]] {
        fails(said.clone(), 2, &format!("{} and {} would both be written to", pair[0].display(), pair[1].display()));
    }
    fails(said, 2, &format!("{}: is named twice", a.display()));
    assert_eq!(folder.names(), ["a.bmp", "a.png", "b.png", "deep"]);
}

#[test]
fn skipped_files_of_a_folder_are_reported() {
    let folder = Folder::new();
    for deep in ["in/deep", "in/other"] {
        fs::create_dir_all(folder.path(deep)).unwrap();
    }
    small().save(folder.path("in/a.png")).unwrap();
    fs::rename(folder.path("in/a.png"), folder.path("in/without extension")).unwrap();
    for name in ["in/notes.txt", "in/old.ssplat", "in/.hidden"] {
        fs::write(folder.path(name), "no picture").unwrap();
    }
    let (input, out) = (folder.path("in"), folder.path("out"));
    let run = many(&[&input], &out, &[]);
    let said = String::from_utf8(run.stderr.clone()).unwrap();
    assert!(said.contains("2 files are passed over: ") && said.contains("in/notes.txt"), "{said}");
    assert!(
        said.contains("2 folders are passed over, which --recursive takes: ") && said.contains("in/deep"),
        "{said}"
    );
    assert!(!said.contains("hidden"), "{said}");
    assert!(succeeds(run).contains("1 files done"));
    // A picture without an extension is detected by its content.
    assert!(out.join("without extension.ssplat").exists());
    assert!(told(many(&[&input], &out, &["--quiet", "--overwrite"])).is_empty());
    // A folder that cannot be created is reported once.
    let said = many(&[&input], &folder.path("in/notes.txt/out"), &[]);
    let lines = String::from_utf8_lossy(&said.stderr).lines().filter(|l| l.contains("notes.txt/out")).count();
    assert_eq!((said.status.code(), lines), (Some(3), 1), "{said:?}");
}

#[test]
fn an_update_replaces_outputs_that_are_older_than_their_inputs() {
    use std::time::{Duration, SystemTime};
    let folder = Folder::new();
    fs::create_dir_all(folder.path("in")).unwrap();
    for name in ["in/a.png", "in/b.png", "in/c.png"] {
        small().save(folder.path(name)).unwrap();
    }
    let (input, out) = (folder.path("in"), folder.path("out"));
    let update = || succeeds(many(&[&input], &out, &["--update"]));
    let first = update();
    let file = |name: &str| out.join(name);
    let bytes: u64 =
        ["a", "b", "c"].map(|name| fs::metadata(file(&format!("{name}.ssplat"))).unwrap().len()).iter().sum();
    // What was read and written, and how long that took.
    assert!(
        first.contains("3 files done, 0 skipped, 0 failed; ") && first.contains(&format!(" became {bytes} bytes (")),
        "{first}"
    );
    assert!(update().contains("0 files done, 3 skipped, 0 failed\n"));
    let set = |path: PathBuf, time| fs::File::options().append(true).open(path).unwrap().set_modified(time).unwrap();
    let now = SystemTime::now();
    fs::write(file("a.ssplat"), "stale").unwrap();
    // Equal times, as `--keep-times` leaves them, count as up to date.
    for (name, difference) in [("a", 10), ("b", 0)] {
        set(folder.path(&format!("in/{name}.png")), now);
        set(file(&format!("{name}.ssplat")), now - Duration::from_secs(difference));
    }
    fs::remove_file(file("c.ssplat")).unwrap();
    assert!(update().contains("2 files done, 1 skipped, 0 failed"));
    assert!(fs::read(file("a.ssplat")).unwrap() != b"stale" && file("c.ssplat").exists());
    for other in ["--overwrite", "--skip-existing"] {
        assert_eq!(many(&[&input], &out, &["--update", other]).status.code(), Some(2));
    }
}

#[test]
#[cfg(unix)]
fn an_interrupt_leaves_only_complete_files() {
    let folder = Folder::new();
    fs::create_dir(folder.path("in")).unwrap();
    small().save(folder.path("in/0.png")).unwrap();
    for i in 1..3 {
        fs::copy(PHOTO, folder.path(&format!("in/{i}.png"))).unwrap();
    }
    let out = folder.path("out");
    let child = command(&[&"encode", &folder.path("in"), &"--out-dir", &out, &"--ratio", &"20", &"--effort", &"8"])
        .args(["--jobs", "2"])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let start = std::time::Instant::now();
    while !out.join("0.ssplat").exists() {
        assert!(start.elapsed().as_secs() < 60, "no file was written");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let ended = child.wait_with_output().unwrap();
    assert_eq!(ended.status.code(), Some(130));
    // The first file has its name just before it counts.
    let said = String::from_utf8(ended.stderr).unwrap();
    assert!(said.contains("interrupted: ") && said.contains(" of 3 files done"), "{said}");
    assert!(said.contains("--skip-existing goes on from here"), "{said}");
    let names: Vec<_> = fs::read_dir(&out).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names, ["0.ssplat"]);
    succeeds(ssplat(&[&"info", &out.join("0.ssplat")]));
}

#[test]
fn info_measures_the_levels_that_the_encoder_writes() {
    use ssplat::unstable::bitstream;
    let folder = Folder::new();
    let file = folder.path("a.ssplat");
    succeeds(ssplat(&[&"encode", &PHOTO, &file, &"--gaussians", &"600", &"--effort", &"1", &"--layout", &"coded"]));
    let bytes = fs::read(&file).unwrap();
    let mut splats = bitstream::read(&bytes[..], &ssplat::Limits::default()).unwrap();
    ssplat::unstable::divide(&mut splats, 3);
    let with = bitstream::to_bytes(&splats).unwrap();
    let info: serde_json::Value = serde_json::from_str(&succeeds(ssplat(&[&"info", &file, &"--json"]))).unwrap();
    let levels = info["left_out"].as_array().unwrap().iter().find(|l| l["what"].as_str().unwrap().contains("levels"));
    assert_eq!(levels.unwrap()["bytes_saved"].as_u64().unwrap(), (with.len() - bytes.len()) as u64);
}

#[test]
fn encode_and_compare_agree_on_a_picture_with_alpha() {
    let folder = Folder::new();
    let (source, file) = (folder.path("logo.png"), folder.path("logo.ssplat"));
    // A disc on fully transparent red with noise.
    let logo = image::RgbaImage::from_fn(96, 96, |x, y| {
        let inside = (f64::from(x) - 47.5).hypot(f64::from(y) - 47.5) < 30.0;
        let hidden = (x * 73 + y * 151) as u8;
        if inside { image::Rgba([30, 90, 200, 255]) } else { image::Rgba([hidden, 255 - hidden, 7, 0]) }
    });
    logo.save(&source).unwrap();
    let json = succeeds(ssplat(&[&"encode", &source, &file, &"--bytes", &"1500", &"--effort", &"1", &"--json"]));
    let measured = succeeds(ssplat(&[&"compare", &source, &file, &"--json"]));
    // Only one of them rounds to code values.
    let (said, found) = (number(&json, "psnr"), number(&measured, "psnr"));
    assert!((said - found).abs() < 0.2, "{said} {found}");
}

#[test]
fn completions_and_the_manual_contain_the_options() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        assert!(succeeds(ssplat(&[&"completions", &shell])).contains("skip-existing"), "{shell}");
    }
    let folder = Folder::new();
    let pages = folder.path("man");
    assert_eq!(succeeds(ssplat(&[&"man", &"--out-dir", &pages])), "");
    let of = |name: &str| fs::read_to_string(pages.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    let program = of("ssplat.1");
    assert!(program.contains(".TH ssplat 1") && program.contains(".SH \"EXIT STATUS\""), "{program}");
    // The program's page names a page for each command, and each names the program's.
    let named: Vec<&str> = program.lines().filter_map(|l| l.strip_prefix("ssplat\\-")?.strip_suffix("(1)")).collect();
    assert_eq!(named.len(), fs::read_dir(&pages).unwrap().count() - 1, "{program}");
    for name in named {
        let page = of(&format!("ssplat-{name}.1"));
        assert!(page.starts_with(&format!(".TH ssplat-{name} 1 \"\" \"ssplat ")), "{page}");
        assert!(page.ends_with(".SH \"SEE ALSO\"\nssplat(1)\n"), "{page}");
        assert_eq!(succeeds(ssplat(&[&"man", &name])), page);
    }
    assert_eq!(succeeds(ssplat(&[&"man"])), program);
    let encode = of("ssplat-encode.1");
    assert!(encode.contains("auto\\-orient") && encode.contains("<INPUT>... \\-\\-out\\-dir <DIR>"), "{encode}");
    // Examples are not filled.
    assert!(encode.contains(".SH EXAMPLES\n.nf\n  ssplat encode photo.jpg"), "{encode}");
    fails(ssplat(&[&"man", &"encod"]), 2, "no command \"encod\"; the commands are encode, decode, ");
    let version = succeeds(ssplat(&[&"--version"]));
    assert!(version.starts_with(concat!("ssplat ", env!("CARGO_PKG_VERSION"))), "{version}");
}
