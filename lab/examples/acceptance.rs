//! Results of this decoder on many files, for comparison with other builds of it (`web/test/acceptance.mjs`): the
//! fuzzing finds as they are and with corrected checksums, all vectors, and mutations of them.
//!
//!
//! ```sh
//! cargo run --release -p ssplat-lab --example acceptance -- FOLDER [MUTATIONS [FILES]]
//! ```
//!
//! writes `FOLDER/files.bin`, all files concatenated, and `FOLDER/list.txt`, with a line for each file: name, length,
//! result of inspecting it, width and height of the corner that is rendered, and result of rendering it. A result is
//! the kind of an error, or a checksum.

use std::error::Error;
use std::fs;
use std::path::Path;

use seal::mutations::mutations;
use seal::seal;
use ssplat::SamplesMut;
use ssplat::unstable::bitstream::inspect;
use ssplat::{Limits, Reader, Rect};

#[path = "../../tests/seal/mod.rs"]
mod seal;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Side of the corner that is rendered of a larger picture. Rendering the whole takes long and shows nothing more.
const SIDE: u32 = 64;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let (folder, count, more) = match &args[..] {
        [folder] => (Path::new(folder), 10_000, None),
        [folder, count] => (Path::new(folder), count.parse()?, None),
        [folder, count, more] => (Path::new(folder), count.parse()?, Some(Path::new(more))),
        _ => return Err("acceptance FOLDER [MUTATIONS [FILES]]".into()),
    };
    let mut all = files(count)?;
    for path in more.map(entries).transpose()?.unwrap_or_default() {
        all.push((name_of(&path), fs::read(&path)?));
    }
    let (mut bytes, mut list) = (Vec::new(), String::new());
    for (name, file) in all {
        let (outcome, [width, height], drawn) = said_of(&file);
        list += &format!("{name} {} {outcome} {width} {height} {drawn}\n", file.len());
        bytes.extend(file);
    }
    fs::create_dir_all(folder)?;
    fs::write(folder.join("files.bin"), bytes)?;
    fs::write(folder.join("list.txt"), list)?;
    Ok(())
}

fn files(count: usize) -> Result<Vec<(String, Vec<u8>)>> {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let mut files = Vec::new();
    for path in entries(&root.join("tests/finds"))? {
        let (name, bytes) = (name_of(&path), fs::read(&path)?);
        let mut sealed = bytes.clone();
        seal(&mut sealed);
        files.extend([(format!("finds/{name}"), bytes), (format!("finds/{name}/sealed"), sealed)]);
    }
    let mut sound = Vec::new();
    for kind in ["valid", "reduced", "invalid", "limits"] {
        for path in entries(&root.join("spec/vectors").join(kind))? {
            let bytes = fs::read(path.join("file.ssplat"))?;
            // The files that `tests/reading/malformed.rs` mutates.
            if kind == "valid" && bytes.len() < 8192 {
                sound.push(bytes.clone());
            }
            files.push((format!("{kind}/{}", name_of(&path)), bytes));
        }
    }
    files.extend(mutations(&sound, count).enumerate().map(|(i, bytes)| (format!("mutation/{i}"), bytes)));
    Ok(files)
}

fn entries(folder: &Path) -> Result<Vec<std::path::PathBuf>> {
    let mut paths = fs::read_dir(folder)?.map(|e| Ok(e?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    Ok(paths)
}

fn name_of(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// Returns the limits that `web/test/acceptance.mjs` uses. `alloc` is large enough to be irrelevant, since 32-bit
/// builds take less memory.
fn limits() -> Limits {
    let mut limits = Limits::default();
    (limits.width, limits.height, limits.gaussians) = (1 << 12, 1 << 12, 1 << 16);
    (limits.alloc, limits.tile_pairs) = (512 << 20, 1 << 20);
    limits
}

fn said_of(file: &[u8]) -> (&'static str, [u32; 2], String) {
    let outcome = inspect(file, &limits()).map_or_else(|e| kind(&e), |_| "file");
    let mut size = [0; 2];
    let drawn =
        corner(file, &mut size).map_or_else(|e| kind(&e).into(), |samples| crc32fast::hash(&samples).to_string());
    (outcome, size, drawn)
}

/// Returns a corner of the picture as RGBA with 8 bits, in the format of the package for browsers.
fn corner(file: &[u8], size: &mut [u32; 2]) -> ssplat::Result<Vec<u8>> {
    let opening = Reader::new(file, &limits())?;
    let (header, view) = (opening.header(), opening.view());
    *size = [header.width.min(SIDE), header.height.min(SIDE)];
    let count = header.channels.count();
    let view = view.crop(Rect::new(0, 0, size[0], size[1]))?;
    let opened = opening.read_for(&view)?;
    let mut samples = vec![0; size[0] as usize * size[1] as usize * count];
    opened.render_into(&view, SamplesMut::U8(&mut samples))?;
    let rgba = samples.chunks_exact(count).flat_map(|s| match *s {
        [grey] => [grey, grey, grey, 255],
        [grey, alpha] => [grey, grey, grey, alpha],
        [red, green, blue] => [red, green, blue, 255],
        _ => [s[0], s[1], s[2], s[3]],
    });
    Ok(rgba.collect())
}

fn kind(error: &ssplat::Error) -> &'static str {
    match error {
        ssplat::Error::Format(_) => "format",
        ssplat::Error::UnsupportedVersion { .. } => "version",
        ssplat::Error::LimitExceeded { .. } => "limit",
        ssplat::Error::Parameter { .. } => "parameter",
        _ => "internal",
    }
}
