//! `ssplat view`: shows a file in the viewer of `web/`, in the browser or as one HTML page.

mod http;
mod package;
mod page;
mod server;

use std::path::Path;
use std::time::Duration;

use ssplat::{Damage, Error, FormatError, Limits, Reader};

use crate::args;
use crate::failure::Failure;
use crate::input;
use crate::sink::{Sink, tell};

/// A file to show: its bytes, and its name for the page.
struct Shown {
    name: String,
    bytes: Vec<u8>,
}

impl Shown {
    fn new(path: &Path, bytes: Vec<u8>) -> Self {
        let name = if path == Path::new("-") {
            "standard-input".into()
        } else {
            path.file_name().unwrap_or_default().to_string_lossy()
        };
        // Only characters that need no escaping in URLs and in HTML.
        let plain = |c: char| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '_' };
        Shown { name: name.chars().map(plain).collect(), bytes }
    }
}

/// Returns a file that the viewer reads: `bytes`, or a file of the parts that are present if `bytes` are cut off. Refuses
/// broken files here, not in the browser.
fn complete(input: &Path, bytes: Vec<u8>, limits: &Limits) -> Result<Vec<u8>, Failure> {
    let failed = |e| Failure::library(input, &e);
    let read = |damage| Reader::new(&bytes, limits).and_then(|opening| opening.damage(damage).read());
    match read(Damage::Refuse) {
        Ok(_) => Ok(bytes),
        Err(Error::Format(cut @ FormatError::CutOff { partial: true, .. })) => {
            let mut splats = read(Damage::Accept).map_err(failed)?.splats().clone();
            if splats.levels.iter().map(|&n| n as usize).sum::<usize>() != splats.gaussians.len() {
                splats.levels.clear();
            }
            let mut present = Vec::new();
            ssplat::unstable::bitstream::write(&splats, &mut present).map_err(failed)?;
            tell(&format!("{}: {cut}; the viewer shows what is there", Failure::input(input)));
            Ok(present)
        }
        Err(error) => Err(failed(error)),
    }
}

pub fn run(args: &args::View) -> Result<(), Failure> {
    let opens = if args.no_open { server::Opens::Nothing } else { server::Opens::Browser };
    let idle = args.idle.map(Duration::from_secs);
    let Some(input) = &args.input else { return server::run(None, None, opens, idle) };
    let bytes = input::read_splats(input)?;
    let limits = Limits::default();
    let bytes = complete(input, bytes, &limits)?;
    let file = Shown::new(input, bytes);
    let original = match &args.original {
        Some(path) => Some(Shown::new(path, input::read_at_most(path, limits.alloc)?)),
        None => None,
    };
    match &args.html {
        Some(out) => {
            let inputs: Vec<&Path> = [input].into_iter().chain(&args.original).map(|p| p.as_path()).collect();
            Sink::create(out, &inputs)?.finish_with(page::packed(&file, original.as_ref()).as_bytes())
        }
        None => server::run(Some(file), original, opens, idle),
    }
}
