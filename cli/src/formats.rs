//! `ssplat formats`: the picture formats that are read and written.

use image::ImageFormat;

use crate::failure::Failure;
use crate::rows::Format;
use crate::sink::say;

/// Prints a line for each format: its name, its extensions, and what is done with it.
pub fn run() -> Result<(), Failure> {
    let mut text = String::from("ssplat  read, written     .ssplat\n");
    for format in ImageFormat::all().filter(|format| format.reading_enabled()) {
        let extensions = format.extensions_str();
        let is_written = extensions.iter().any(|extension| Format::from_extension(extension).is_ok());
        let uses = if is_written { "read, written" } else { "read" };
        let extensions: Vec<String> = extensions.iter().map(|extension| format!(".{extension}")).collect();
        text += &format!("{:<8}{uses:<18}{}\n", name(format), extensions.join(" "));
    }
    text += "\nFormats are told by their content; Targa, which has no mark, by its extension. Of animations and files of several\n\
             pages the first picture is taken. Written are pictures that `decode` draws; `encode` writes .ssplat alone.\n";
    say(&text)
}

/// The name by which people know a format.
fn name(format: ImageFormat) -> String {
    match format {
        ImageFormat::Pnm => "Netpbm".into(),
        ImageFormat::Tga => "Targa".into(),
        ImageFormat::Farbfeld | ImageFormat::WebP => format!("{format:?}"),
        other => format!("{other:?}").to_uppercase(),
    }
}
