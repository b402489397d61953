//! The viewer's files, as `web/build` writes them: where they are, and what is in them.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};

use crate::failure::{Failure, Kind};

/// The page; the program asks for nothing else where it looks for a viewer.
pub const PAGE: &str = "viewer/index.html";
/// The modules of the page. Their names without folders differ.
pub const MODULES: [&str; 10] = [
    "error.js",
    "icc.js",
    "machine.js",
    "ssplat.js",
    "worker.js",
    "viewer/gaussians.js",
    "viewer/scene.js",
    "viewer/splatting.js",
    "viewer/viewer.js",
    "viewer/webgpu.js",
];
/// The WebAssembly that every browser can run.
pub const SCALAR: &str = "ssplat-scalar.wasm";
/// The WebAssembly for browsers with vector instructions.
const SIMD: &str = "ssplat-simd.wasm";

/// The variable that names the viewer's folder.
const VARIABLE: &str = "SSPLAT_VIEWER";

/// The viewer.
pub struct Package {
    folder: PathBuf,
    files: Vec<(&'static str, Vec<u8>)>,
}

impl Package {
    /// Reads the viewer in `folder`, or where a viewer may be without one.
    pub fn find(folder: Option<&Path>) -> Result<Package, Failure> {
        let named = folder.map(Path::to_path_buf).or_else(|| env::var_os(VARIABLE).map(PathBuf::from));
        match named.or_else(installed) {
            Some(folder) => Package::read(folder),
            None => Err(Failure {
                kind: Kind::Io,
                message: format!(
                    "no viewer is installed: web/build in the source of ssplat writes one to web/dist; \
                     name that folder by --viewer or {VARIABLE}, or copy it to ../share/ssplat/web beside the program's"
                ),
            }),
        }
    }

    fn read(folder: PathBuf) -> Result<Package, Failure> {
        let mut files = Vec::new();
        for name in [PAGE, SCALAR, SIMD].into_iter().chain(MODULES) {
            let path = folder.join(name);
            files.push((name, fs::read(&path).map_err(|e| Failure::io(&path, &e))?));
        }
        Ok(Package { folder, files })
    }

    /// A file of the viewer, by its name below the viewer's folder; `None` for every other name.
    pub fn file(&self, name: &str) -> Option<&[u8]> {
        self.files.iter().find(|(known, _)| *known == name).map(|(_, bytes)| bytes.as_slice())
    }

    /// The text of a file that is known to be there.
    pub fn text(&self, name: &str) -> Result<&str, Failure> {
        let broken = || self.broken(name, "no text in UTF-8");
        self.file(name).and_then(|bytes| std::str::from_utf8(bytes).ok()).ok_or_else(broken)
    }

    /// A file of the viewer is not what it should be.
    pub fn broken(&self, name: &str, what: &str) -> Failure {
        Failure { kind: Kind::Format, message: format!("{}: {what}", self.folder.join(name).display()) }
    }
}

/// The viewer that belongs to this program.
fn installed() -> Option<PathBuf> {
    let program = fs::canonicalize(env::current_exe().ok()?).ok()?;
    let folder = program.parent()?.parent()?;
    let mut places = vec![folder.join("share/ssplat/web")];
    // A program that was built in the source: target/release/ssplat, or below a target of its own name.
    places.extend(folder.ancestors().take(2).filter(|f| f.ends_with("target")).map(|f| f.join("../web/dist")));
    places.into_iter().find(|place| place.join(PAGE).is_file())
}
