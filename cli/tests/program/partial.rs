//! Guarantees of `ssplat decode --partial`: intact parts are rendered, and missing parts are reported.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use tempfile::TempDir;

/// Returns the bytes of a conformance vector.
fn vector(name: &str) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../spec/vectors/valid");
    fs::read(folder.join(name).join("file.ssplat")).unwrap()
}

/// Decodes `bytes` in `folder`. Returns the path of the picture if there is one.
fn decode(folder: &TempDir, bytes: &[u8], options: &[&str]) -> (Output, Option<PathBuf>) {
    let (input, output) = (folder.path().join("in.ssplat"), folder.path().join("out.pam"));
    fs::write(&input, bytes).unwrap();
    let _ = fs::remove_file(&output);
    let run = Command::new(env!("CARGO_BIN_EXE_ssplat")).arg("decode").args([&input, &output]).args(options).output();
    let drawn = output.exists().then_some(output);
    (run.unwrap(), drawn)
}

#[test]
fn a_truncated_file_is_rendered_on_request_and_the_loss_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = vector("groups-levels");
    let cut = &bytes[..bytes.len() - 20];
    let (refused, none) = decode(&folder, cut, &[]);
    assert_eq!((refused.status.code(), none), (Some(4), None));
    let (drawn, picture) = decode(&folder, cut, &["--partial", "--json"]);
    assert!(drawn.status.success() && picture.is_some());
    let said = String::from_utf8(drawn.stderr).unwrap();
    assert!(said.contains("30 of 60 Gaussians in 1 of 3 groups are missing"), "{said}");
    let json = String::from_utf8(drawn.stdout).unwrap();
    assert!(json.contains("\"missing\":{\"gaussians\":30,\"of\":60}"), "{json}");
}

#[test]
fn a_file_without_groups_is_complete_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = vector("coded-rgb");
    let (whole, _) = decode(&folder, &bytes, &["--partial"]);
    assert!(whole.status.success() && whole.stderr.is_empty());
    let (cut, none) = decode(&folder, &bytes[..bytes.len() - 1], &["--partial"]);
    assert_eq!((cut.status.code(), none), (Some(4), None));
}

#[test]
fn a_damaged_section_is_reported_and_the_picture_is_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let (drawn, picture) = decode(&folder, &vector("sections-damaged"), &[]);
    assert!(drawn.status.success() && picture.is_some());
    let said = String::from_utf8(drawn.stderr).unwrap();
    assert!(said.contains("section iccp is damaged and left out"), "{said}");
}

#[test]
fn missing_tiles_of_a_detail_layer_are_counted_and_the_rest_is_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = vector("detail-tiles-row");
    let (whole, _) = decode(&folder, &bytes, &["--partial", "--json"]);
    assert!(whole.status.success() && whole.stderr.is_empty());
    let json = String::from_utf8(whole.stdout).unwrap();
    assert!(!json.contains("of_tiles"), "{json}");
    let mut hurt = bytes.clone();
    let at = hurt.len() - 9;
    hurt[at] ^= 1;
    let (refused, none) = decode(&folder, &hurt, &[]);
    assert_eq!((refused.status.code(), none), (Some(4), None));
    let (drawn, picture) = decode(&folder, &hurt, &["--partial", "--json"]);
    assert!(drawn.status.success() && picture.is_some());
    let said = String::from_utf8(drawn.stderr).unwrap();
    assert!(said.contains("1 of 4 tiles of the detail layer are missing") && !said.contains("Gaussians"), "{said}");
    let json = String::from_utf8(drawn.stdout).unwrap();
    assert!(json.contains("\"of_tiles\":4") && json.contains("\"tiles\":1"), "{json}");
    // A cut within the checksum loses nothing of the picture.
    let (drawn, _) = decode(&folder, &bytes[..bytes.len() - 1], &["--partial"]);
    let said = String::from_utf8(drawn.stderr).unwrap();
    assert!(drawn.status.success() && said.contains("the requested part of the picture is complete"), "{said}");
}

#[test]
fn missing_tiles_are_told_by_layer() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = vector("exact-both-layers");
    let (exact, checksum) = (376, 4);
    let [in_exact, in_detail] = [checksum + 9, checksum + exact + 9].map(|back| bytes.len() - back);
    for (hurt, layers) in [
        (vec![in_exact], &["exact"][..]),
        (vec![in_detail], &["detail"]),
        (vec![in_exact, in_detail], &["detail", "exact"]),
    ] {
        let mut file = bytes.clone();
        hurt.iter().for_each(|&at| file[at] ^= 1);
        let (drawn, picture) = decode(&folder, &file, &["--partial", "--json"]);
        assert!(drawn.status.success() && picture.is_some());
        let said = String::from_utf8(drawn.stderr).unwrap();
        for layer in ["detail", "exact"] {
            let is_told = said.contains(&format!("1 of 1 tiles of the {layer} layer are missing"));
            assert_eq!(is_told, layers.contains(&layer), "{hurt:?}: {said}");
        }
        let json = String::from_utf8(drawn.stdout).unwrap();
        let exact = u32::from(layers.contains(&"exact"));
        let counts = format!(
            "\"exact_tiles\":{exact},\"gaussians\":0,\"of\":20,\"of_exact_tiles\":1,\"of_tiles\":2,\"tiles\":{}",
            layers.len()
        );
        assert!(json.contains(&counts), "{json}");
    }
}
