//! `ssplat placeholder`: a file of a few hundred bytes, as text that can be embedded in a web page.

use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::DynamicImage;
use ssplat::unstable::EncodeOptions;
use ssplat::{Detail, Pixels, Target};

use crate::args::{self, PlaceholderFormat};
use crate::failure::Failure;
use crate::sink::{say, tell};
use crate::source::{self, Turn};

/// Longest side in pixels that is fitted; a few hundred Gaussians cannot show more detail.
const MAX_SIDE: u32 = 512;

pub fn run(args: &args::Placeholder) -> Result<(), Failure> {
    if args.format == PlaceholderFormat::Html && args.src.is_none() && args.input == Path::new("-") {
        return Err(Failure::usage("standard input has no name; give the address of the picture with --src URL"));
    }
    // A placeholder has no room for an EXIF block, and browsers rotate the picture that replaces it.
    let source = source::open(&args.input, Turn::Upright)?.whole(&args.input)?;
    source.notes.iter().for_each(|note| tell(&format!("{}: {note}", Failure::input(&args.input))));
    let size = [source.pixels.width(), source.pixels.height()];
    let mut options = EncodeOptions::default();
    (options.target, options.effort) = (Target::Bytes(args.bytes), args.effort);
    // The decoder of placeholders without WebAssembly supports Gaussians only.
    options.detail = Detail::Off;
    let encoded =
        ssplat::unstable::encode(&shrunk(source.pixels), &options).map_err(|e| Failure::library(&args.input, &e))?;
    let text = STANDARD.encode(encoded.bytes);
    say(&match args.format {
        PlaceholderFormat::Base64 => format!("{text}\n"),
        PlaceholderFormat::Uri => format!("data:image/x-ssplat;base64,{text}\n"),
        PlaceholderFormat::Html => html(args, size, &text),
    })
}

/// Downscales a large picture. Pictures with alpha are not changed, because averages would include hidden colours.
fn shrunk(pixels: Pixels) -> Pixels {
    if pixels.width().max(pixels.height()) <= MAX_SIDE || pixels.channels().alpha().is_some() {
        return pixels;
    }
    let picture = DynamicImage::from(pixels).thumbnail(MAX_SIDE, MAX_SIDE);
    Pixels::try_from(picture).expect("a picture of samples that were pixels before")
}

/// Returns an element for `web/ssplat-img.js`, which shows the placeholder until the source is loaded. Its style
/// reserves the space of the picture before that module is loaded, so that the layout does not shift.
fn html(args: &args::Placeholder, [width, height]: [u32; 2], text: &str) -> String {
    let src = args.src.clone().unwrap_or_else(|| name(&args.input));
    format!(
        "<ssplat-img src=\"{}\" alt=\"{}\" width=\"{width}\" height=\"{height}\" style=\"display: inline-block; width: {width}px; \
         max-width: 100%; height: auto; aspect-ratio: {width} / {height}; vertical-align: bottom\" placeholder=\"{text}\"></ssplat-img>\n",
        escaped(&src),
        escaped(args.alt.as_deref().unwrap_or_default())
    )
}

/// Returns the name of the file without its folders, which mean nothing to the page.
fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Escapes text for an attribute value in double quotes.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;")
}
