//! `ssplat formats`: the picture formats that this build reads and writes.

use image::ImageFormat;

use crate::failure::Failure;
use crate::rows::Format;
use crate::sink::say;
use crate::sniff::Sniffed;

/// Formats that a build may lack, with their extensions and Cargo features; HEIC has none.
const OPTIONAL: [(Sniffed, &str, &str, Option<&str>); 3] = [
    (Sniffed::JpegXl, "JPEG XL", ".jxl", Some("jxl")),
    (Sniffed::Avif, "AVIF", ".avif", Some("avif")),
    (Sniffed::Heic, "HEIC", ".heic .heif", None),
];

/// Prints a line for each format: name, use, and extensions.
pub fn run() -> Result<(), Failure> {
    let mut text = String::from("ssplat    read, written     .ssplat\n");
    for format in ImageFormat::all().filter(|&format| format.reading_enabled() && format != ImageFormat::Avif) {
        let extensions = format.extensions_str();
        let is_written = extensions.iter().any(|extension| Format::from_extension(extension).is_ok());
        let uses = if is_written { "read, written" } else { "read" };
        let extensions: Vec<String> = extensions.iter().map(|extension| format!(".{extension}")).collect();
        text += &format!("{:<10}{uses:<18}{}\n", name(format), extensions.join(" "));
    }
    for (format, name, extensions, feature) in OPTIONAL {
        let uses = match feature {
            _ if format.is_read() => "read",
            Some(_) => "not in this build",
            None => "not read",
        };
        let feature = feature.filter(|_| !format.is_read()).map_or(String::new(), |f| format!(" (feature `{f}`)"));
        text += &format!("{name:<10}{uses:<18}{extensions}{feature}\n");
    }
    text += "\nFormats are detected by content, except for Targa, which has no signature and is detected by extension. Only the\n\
             first picture of animations and files with several pages is used. `decode` writes the formats marked as written;\n\
             `encode` writes .ssplat. Convert HEIC first, for example with `heif-convert IN.heic OUT.png`.\n";
    say(&text)
}

/// Returns the common name of a format.
fn name(format: ImageFormat) -> String {
    match format {
        ImageFormat::Pnm => "Netpbm".into(),
        ImageFormat::Tga => "Targa".into(),
        ImageFormat::Farbfeld | ImageFormat::WebP => format!("{format:?}"),
        other => format!("{other:?}").to_uppercase(),
    }
}
