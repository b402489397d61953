//! Finds the folder of the viewer's files: `web` in the published package, `../web` in the repository. There, `web` is
//! a symbolic link for `cargo package`, which Git for Windows usually checks out as a text file.

use std::path::Path;

fn main() {
    // Not `env!`: a package that is unpacked into another folder may reuse this program.
    let here = std::env::var_os("CARGO_MANIFEST_DIR").expect("set by cargo");
    let here = Path::new(&here);
    let web = ["web", "../web"].map(|name| here.join(name)).into_iter().find(|folder| folder.join("viewer").is_dir());
    let web = web.expect("the viewer's files in web or ../web");
    println!("cargo::rustc-env=SSPLAT_WEB={}", web.display());
    println!("cargo::rerun-if-changed=build.rs");
    // A package that is unpacked into another folder may be built into the same target folder.
    println!("cargo::rerun-if-changed={}", web.join("viewer/index.html").display());
}
