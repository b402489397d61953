//! EXIF blocks that a PNG holds as text, as ImageMagick, ExifTool and older programs write them.

use std::io::{BufRead, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use png::{Decoder, Limits};
use ssplat::unstable::colour::Stated;

use crate::failure::Failure;

/// Maximum length of the text, in bytes, decompressed: twice that of the block.
const MAX_TEXT: usize = 4 << 20;

/// Start of a PNG of one pixel, up to the end of the header chunk.
const START: &[u8; 33] = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR\0\0\0\x01\0\0\0\x01\x08\0\0\0\0\x3a\x7e\x9b\x55";
/// Start of its samples, where reading ends.
const END: &[u8; 8] = b"\0\0\0\x0aIDAT";

/// Reads the block in the text chunk of `stated`, if it has one. A block that cannot be read is left out, with a note.
/// The input is rewound.
pub fn read(
    path: &Path,
    input: &mut (impl BufRead + Seek),
    stated: &Stated,
    notes: &mut Vec<String>,
) -> Result<Option<Vec<u8>>, Failure> {
    notes.extend(stated.exif_note.map(String::from));
    let Some(chunk) = stated.exif_text else { return Ok(None) };
    let io = |e| Failure::io(path, &e);
    let mut exif = None;
    if chunk.length as usize <= MAX_TEXT {
        // The library for PNG reads whole files only.
        let mut file = START.to_vec();
        input.seek(SeekFrom::Start(chunk.start)).map_err(io)?;
        input.by_ref().take(u64::from(chunk.length) + 12).read_to_end(&mut file).map_err(io)?;
        file.extend(END);
        exif = text(file).as_deref().and_then(block);
    }
    input.rewind().map_err(io)?;
    if exif.is_none() {
        notes.push("its EXIF block, which is stored as text, cannot be read and is left out".into());
    }
    Ok(exif)
}

/// Returns the text of the only text chunk of a PNG.
fn text(file: Vec<u8>) -> Option<String> {
    let decoder = Decoder::new_with_limits(Cursor::new(file), Limits { bytes: 4 * MAX_TEXT });
    let reader = decoder.read_info().ok()?;
    let info = reader.info();
    if let Some(chunk) = info.compressed_latin1_text.first() {
        let mut chunk = chunk.clone();
        chunk.decompress_text_with_limit(MAX_TEXT).ok()?;
        return chunk.get_text().ok();
    }
    if let Some(chunk) = info.utf8_text.first() {
        let mut chunk = chunk.clone();
        chunk.decompress_text_with_limit(MAX_TEXT).ok()?;
        return chunk.get_text().ok();
    }
    info.uncompressed_latin1_text.first().map(|chunk| chunk.text.clone())
}

/// Returns the block in a text: its name and its length in lines of their own, and then hexadecimal digits.
fn block(text: &str) -> Option<Vec<u8>> {
    let (_, rest) = text.trim_start().split_once('\n')?;
    let (length, digits) = rest.trim_start().split_once('\n')?;
    let length: usize = length.trim().parse().ok()?;
    let digits: Vec<u8> =
        digits.chars().filter(|c| !c.is_whitespace()).map(|c| Some(c.to_digit(16)? as u8)).collect::<Option<_>>()?;
    let (pairs, _) = digits.as_chunks::<2>();
    let bytes: Vec<u8> = pairs.iter().map(|[high, low]| high << 4 | low).collect();
    let bytes = bytes.get(..length)?;
    // The start of the segment of a JPEG.
    let bytes = bytes.strip_prefix(b"Exif\0\0").unwrap_or(bytes);
    (bytes.starts_with(b"II") || bytes.starts_with(b"MM")).then(|| bytes.to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_read_from_lines_of_digits() {
        assert_eq!(block("\nexif\n      8\n49492A00\n08000000\n"), Some(b"II*\0\x08\0\0\0".to_vec()));
        assert_eq!(block("\napp1\n 14\n4578696600004d4d002a\n00000008"), Some(b"MM\0*\0\0\0\x08".to_vec()));
        for broken in ["", "exif\n8\n4949", "\nexif\n4\n4949zz00", "exif\n4\n00000000", "exif\nx\n49492a00"] {
            assert_eq!(block(broken), None, "{broken:?}");
        }
    }
}
