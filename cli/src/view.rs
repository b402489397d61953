//! `ssplat view`: shows a file in the viewer of `web/`, in the browser or as one HTML page.

mod http;
mod package;
mod page;
mod server;

use std::path::Path;

use ssplat::{Damage, Limits, Reader};

use crate::args;
use crate::failure::Failure;
use crate::input;
use crate::sink::Sink;

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

pub fn run(args: &args::View) -> Result<(), Failure> {
    let opens = if args.no_open { server::Opens::Nothing } else { server::Opens::Browser };
    let Some(input) = &args.input else { return server::run(None, None, opens) };
    let bytes = input::read_splats(input)?;
    let limits = Limits::default();
    // Report a broken file here, not in the browser.
    Reader::new(&bytes, &limits).and_then(|o| o.read(Damage::Refuse)).map_err(|e| Failure::library(input, &e))?;
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
        None => server::run(Some(file), original, opens),
    }
}
