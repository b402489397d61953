//! Choice of the metadata of a picture that goes into its file, and the notes about it.

use image::metadata::Orientation;
use ssplat::unstable::EncodeOptions;
use ssplat::{Cicp, Error, MetadataPolicy};

/// Puts the code points, the profile and the EXIF block that `--metadata` selects into `options`, and adds notes about what is left out.
pub fn carry(
    options: &mut EncodeOptions,
    colors: (Option<Cicp>, Option<Vec<u8>>),
    exif: Option<Vec<u8>>,
    orientation: Orientation,
    notes: &mut Vec<String>,
) {
    let carried = options.metadata.of(colors, exif, orientation);
    // No note about losses that the user requested.
    if options.metadata == MetadataPolicy::Needed && carried.exif_left_out > 0 {
        let but = if carried.exif.is_some() { " except for the orientation" } else { "" };
        let bytes = carried.exif_left_out;
        notes.push(format!("{EXIF} of {bytes} bytes is left out{but}; --metadata all keeps it"));
    }
    if carried.is_orientation_left_out {
        notes.push("its orientation is left out; --auto-orient turns the picture".into());
    }
    (options.cicp, options.icc, options.exif) = (carried.cicp, carried.icc, carried.exif);
}

/// The start of a note about an EXIF block that is left out.
const EXIF: &str = "its EXIF block";

/// Whether a note is about an EXIF block that is left out.
pub fn is_of_exif(note: &str) -> bool {
    note.starts_with(EXIF) && note.contains("is left out")
}

/// Returns one note for a batch in which the EXIF blocks of `files` files are left out.
pub fn exif_of_files(files: usize) -> String {
    let (blocks, whose) = if files == 1 { ("block of 1 file is", "it") } else { ("blocks of", "them") };
    let count = if files == 1 { String::new() } else { format!(" {files} files are") };
    format!("the EXIF {blocks}{count} left out except for the orientation; --metadata all keeps {whose}")
}

/// Returns a note about a file of `bytes` bytes if more than half of it is metadata.
pub fn dominating(options: &EncodeOptions, bytes: usize) -> Option<String> {
    let length = |block: &Option<Vec<u8>>| block.as_ref().map_or(0, Vec::len);
    let (icc, exif) = (length(&options.icc), length(&options.exif));
    let what = match (icc, exif) {
        (_, 0) => "its ICC profile takes",
        (0, _) => "its EXIF block takes",
        _ => "its ICC profile and EXIF block take",
    };
    let both = icc + exif;
    (2 * both > bytes).then(|| format!("{what} {both} of {bytes} bytes; --metadata none leaves metadata out"))
}

/// Returns advice for errors of the library that keeping less metadata would avoid; empty for other errors.
pub fn advice(error: &Error) -> &'static str {
    match error {
        Error::TooSmall { icc: 0, exif: 0, .. } => "",
        Error::TooSmall { icc: 0, .. } => "; --metadata icc leaves it out",
        Error::TooSmall { .. } => "; --metadata none leaves metadata out",
        _ => "",
    }
}
