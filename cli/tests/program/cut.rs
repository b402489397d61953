//! Files that are cut off: every command says how many bytes there are and should be, and what shows the rest.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn vector(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../spec/vectors/valid").join(name).join("file.ssplat")
}

fn ssplat(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ssplat")).args(args).output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn commands_name_the_bytes_and_what_shows_the_rest() {
    let folder = tempfile::tempdir().unwrap();
    let cut = folder.path().join("cut.ssplat");
    let [cut_name, out] = [&cut, &folder.path().join("out.png")].map(|path| path.to_str().unwrap().to_owned());
    let file = std::fs::read(vector("groups-levels")).unwrap();
    let words =
        format!("cut off after {} of {} bytes; decode --partial shows what is there", file.len() - 9, file.len());
    std::fs::write(&cut, &file[..file.len() - 9]).unwrap();
    for args in
        [&["decode", &cut_name, &out][..], &["info", &cut_name], &["decode", &cut_name, &out, "--thumbnail", "8"]]
    {
        let refused = ssplat(args);
        assert_eq!(refused.status.code(), Some(4), "{args:?}");
        assert!(said(&refused).contains(&words), "{args:?}: {}", said(&refused));
    }
    for more in [&[][..], &["--thumbnail", "8"]] {
        let shown = ssplat(&[&["decode", &cut_name, &out, "--partial"][..], more].concat());
        assert!(shown.status.success() && said(&shown).contains("missing"), "{}", said(&shown));
    }
    let page = folder.path().join("page.html");
    let shown = ssplat(&["view", &cut_name, "--html", page.to_str().unwrap()]);
    assert!(shown.status.success() && said(&shown).contains("the viewer shows what is there"), "{}", said(&shown));
    assert!(page.metadata().unwrap().len() > 1000);
    // Nothing can be shown before the Gaussians have arrived.
    std::fs::write(&cut, &file[..20]).unwrap();
    let refused = ssplat(&["decode", &cut_name, &out, "--partial"]);
    assert_eq!(refused.status.code(), Some(4));
    assert!(
        said(&refused).contains("cut off after 20 bytes") && !said(&refused).contains("--partial"),
        "{}",
        said(&refused)
    );
}
