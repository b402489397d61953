//! The program fits a picture in tiles and reads it part by part.

use ssplat::unstable::EncodeOptions;
use ssplat::{Backend, Channels, Samples, Target};

/// The program reads a PNG and a PNM part by part, and writes the file that the library makes of the pixels.
#[test]
fn files_that_are_read_in_parts_give_the_bytes_of_the_picture_in_memory() {
    let folder = tempfile::tempdir().unwrap();
    let pixels = crate::waves::picture(180, 140, Channels::Rgb);
    let mut options = EncodeOptions::default();
    (options.target, options.tiles, options.effort, options.backend) =
        (Target::Bytes(1300), Some(128), 2, Backend::Cpu);
    let Samples::U8(samples) = pixels.samples() else { panic!("8 bits") };
    let expected = ssplat::unstable::encode(&pixels, &options).unwrap().bytes;
    let [ppm, png, out] = ["a.ppm", "a.png", "a.ssplat"].map(|name| folder.path().join(name));
    std::fs::write(&ppm, [b"P6 # a picture\n180 140\n255\n", &samples[..]].concat()).unwrap();
    image::RgbImage::from_raw(180, 140, samples.clone()).unwrap().save(&png).unwrap();
    for input in [&ppm, &png] {
        let encode = |extra: &[&str]| {
            let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_ssplat"));
            let arguments = ["--tiles=128", "--bytes", "1300", "--effort", "2", "--backend", "cpu", "--quiet"];
            command.arg("encode").arg(input).arg(&out).args(arguments).args(extra).output().unwrap()
        };
        let run = encode(&[]);
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        assert!(std::fs::read(&out).unwrap() == expected, "{}", input.display());
        // With a preview, the picture is in memory.
        let preview = folder.path().join("preview.png");
        assert!(encode(&["--preview", preview.to_str().unwrap()]).status.success());
        assert!(std::fs::read(&out).unwrap() == expected, "{}", input.display());
    }
    for (broken, status) in [(&b"P6\n300 200\n255\n12"[..], 4), (b"P6\n", 4), (b"P5 99999999999 1 255\n", 4)] {
        std::fs::write(&ppm, broken).unwrap();
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_ssplat"));
        let run = command.arg("encode").arg(&ppm).arg(&out).args(["--tiles=128"]).output().unwrap();
        assert_eq!(run.status.code(), Some(status), "{}", String::from_utf8_lossy(&run.stderr));
    }
}
