//! Guarantees of `ssplat placeholder`: text that contains a file of at most the requested size.

use std::path::Path;
use std::process::{Command, Output};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

const PHOTO: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/images/kodim15.png");

fn placeholder(input: &Path, options: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ssplat"));
    command.arg("placeholder").arg(input).args(["--effort", "1"]).args(options).output().unwrap()
}

#[track_caller]
fn text(output: &Output) -> String {
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout.clone()).unwrap()
}

#[test]
fn all_forms_contain_the_same_file_of_the_requested_size() {
    let photo = Path::new(PHOTO);
    let base64 = text(&placeholder(photo, &["--bytes", "250"]));
    let file = STANDARD.decode(base64.trim_end()).unwrap();
    assert!(file.len() <= 250 && file.len() > 240, "{} bytes", file.len());
    let drawn = ssplat::unstable::decode(&file, &ssplat::unstable::DecodeOptions::default()).unwrap().pixels;
    // The photograph has 768 × 512 pixels.
    assert_eq!([drawn.width(), drawn.height()], [512, 341]);
    let uri = text(&placeholder(photo, &["--bytes", "250", "--format", "uri"]));
    assert_eq!(uri, format!("data:image/x-ssplat;base64,{base64}"));
    let html = text(&placeholder(photo, &["--bytes", "250", "--format", "html", "--alt", "A \"girl\" & <paint>"]));
    let alt = "A &quot;girl&quot; &amp; &lt;paint>";
    // The effect of this style on a page is measured in a browser (web/test/pages/shifts.js).
    let style = "display: inline-block; width: 768px; max-width: 100%; height: auto; aspect-ratio: 768 / 512; vertical-align: bottom";
    let start = format!(
        "<ssplat-img src=\"kodim15.png\" alt=\"{alt}\" width=\"768\" height=\"512\" style=\"{style}\" placeholder=\""
    );
    assert_eq!(html, format!("{start}{}\"></ssplat-img>\n", base64.trim_end()));
}

#[test]
fn pictures_with_alpha_and_small_ones_keep_their_size() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("logo.png");
    image::RgbaImage::from_fn(600, 20, |x, y| image::Rgba([x as u8, y as u8, 90, (x % 256) as u8]))
        .save(&path)
        .unwrap();
    let file = STANDARD.decode(text(&placeholder(&path, &[])).trim_end()).unwrap();
    assert_eq!(
        ssplat::unstable::decode(&file, &ssplat::unstable::DecodeOptions::default()).unwrap().pixels.width(),
        600
    );
}

#[test]
fn errors_name_the_file_or_the_number() {
    for (input, options, status, message) in [
        ("nowhere.png", &[][..], 3, "nowhere.png"),
        ("Cargo.toml", &[], 5, "Cargo.toml"),
        (PHOTO, &["--bytes", "5"], 2, "5"),
        (PHOTO, &["--bytes", "20000"], 2, "20000"),
        (PHOTO, &["--format", "gif"], 2, "gif"),
    ] {
        let output = placeholder(Path::new(input), options);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(status), "{said}");
        assert!(said.contains(message) && output.stdout.is_empty(), "{said}");
    }
}
