//! Detects formats that the `image` crate does not detect by their first bytes: JPEG XL, and formats in the HEIF
//! container.

use crate::failure::Kind;

/// A format that `image` does not detect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sniffed {
    JpegXl,
    Avif,
    Heic,
}

/// Brands of HEVC pictures, and the general brands, which other formats have as well.
const HEIC_BRANDS: [&[u8; 4]; 10] =
    [b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs", b"mif1", b"msf1"];

/// The start of a JPEG XL file without a container, and that of one with it (ISO/IEC 18181-2).
const JXL_CODESTREAM: &[u8] = &[0xFF, 0x0A];
const JXL_CONTAINER: &[u8] = b"\0\0\0\x0CJXL \r\n\x87\n";

/// Returns the format of the file that begins with `start`, if it is one of these.
pub fn sniff(start: &[u8]) -> Option<Sniffed> {
    if start.starts_with(JXL_CODESTREAM) || start.starts_with(JXL_CONTAINER) {
        return Some(Sniffed::JpegXl);
    }
    if start.get(4..8)? != b"ftyp" {
        return None;
    }
    // The box of brands; the second entry is the version of the first brand.
    let length = u32::from_be_bytes(*start.first_chunk()?) as usize;
    let (entries, _) = start[8..].get(..length.saturating_sub(8)).unwrap_or(&start[8..]).as_chunks::<4>();
    let brands = || entries.iter().enumerate().filter(|&(i, _)| i != 1).map(|(_, brand)| brand);
    if brands().any(|brand| matches!(brand, b"avif" | b"avis")) {
        return Some(Sniffed::Avif);
    }
    brands().any(|brand| HEIC_BRANDS.contains(&brand)).then_some(Sniffed::Heic)
}

impl Sniffed {
    /// Whether this build of the program reads the format.
    pub fn is_read(self) -> bool {
        match self {
            Sniffed::JpegXl => cfg!(feature = "jxl"),
            Sniffed::Avif => cfg!(feature = "avif"),
            Sniffed::Heic => false,
        }
    }

    /// The reason why a file of a format that is not read is refused, and what to do instead.
    pub fn refusal(self) -> &'static str {
        match self {
            Sniffed::JpegXl => {
                "is a JPEG XL file, which this build does not support (feature `jxl`): convert it first, with `djxl IN.jxl OUT.png`"
            }
            Sniffed::Avif => {
                "is an AVIF file, which this build does not support (feature `avif`): convert it first, with `avifdec IN.avif OUT.png`"
            }
            Sniffed::Heic => {
                "is a HEIC file, which ssplat does not support: convert it first, with `heif-convert IN.heic OUT.png` or \
                 ImageMagick's `convert IN.heic OUT.png`"
            }
        }
    }
}

/// The first bytes of the side files in which macOS keeps attributes on other file systems (RFC 1740).
pub const APPLE_DOUBLE: &[u8; 4] = b"\x00\x05\x16\x07";

/// Returns what a file that begins with `start` is, if it is no picture that any build reads, and what to do. Only the
/// messages depend on it.
pub fn refusal_of_others(start: &[u8]) -> Option<(Kind, &'static str)> {
    let text = start.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(start).trim_ascii_start();
    let lower = text[..text.len().min(1024)].to_ascii_lowercase();
    let has = |word: &[u8]| lower.windows(word.len()).any(|window| window == word);
    let is_markup = lower.starts_with(b"<!") || lower.starts_with(b"<?xml") || lower.starts_with(b"<html");
    Some(match start {
        _ if lower.starts_with(b"<svg") || is_markup && has(b"<svg") && !has(b"<html") => {
            (Kind::Unsupported, "is an SVG drawing: convert it first, with `rsvg-convert IN.svg -o OUT.png`")
        }
        _ if is_markup || lower.starts_with(b"<head") || lower.starts_with(b"<body") => {
            (Kind::Format, "is HTML or XML, and not a picture: is the path or the address right?")
        }
        _ if lower.starts_with(b"version https://git-lfs.") => {
            (Kind::Format, "is a pointer of Git LFS, and not the picture itself: `git lfs pull` fetches it")
        }
        _ if start.starts_with(APPLE_DOUBLE) => {
            (Kind::Format, "holds attributes that macOS keeps beside a file (AppleDouble), and no picture")
        }
        [b'%', b'P', b'D', b'F', ..] => {
            (Kind::Unsupported, "is a PDF file: convert it first, with `pdftoppm -png IN.pdf OUT`")
        }
        [b'8', b'B', b'P', b'S', ..] => (Kind::Unsupported, "is a Photoshop file: export it as PNG first"),
        [0, 0, 0, 12, b'j', b'P', b' ', b' ', ..] | [0xFF, 0x4F, 0xFF, 0x51, ..] => {
            (Kind::Unsupported, "is a JPEG 2000 file: convert it first, with `opj_decompress -i IN.jp2 -o OUT.png`")
        }
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn start(brands: &[[u8; 4]]) -> Vec<u8> {
        let length = 8 + 4 * brands.len() as u32;
        [&length.to_be_bytes()[..], b"ftyp", brands.as_flattened(), b"\0\0\0\x20avif"].concat()
    }

    #[test]
    fn brands_tell_avif_from_heic() {
        assert_eq!(sniff(&start(&[*b"avif", *b"\0\0\0\0", *b"avif", *b"mif1"])), Some(Sniffed::Avif));
        assert_eq!(sniff(&start(&[*b"mif1", *b"\0\0\0\0", *b"mif1", *b"avif"])), Some(Sniffed::Avif));
        assert_eq!(sniff(&start(&[*b"heic", *b"\0\0\0\0", *b"mif1", *b"heic"])), Some(Sniffed::Heic));
        assert_eq!(sniff(&start(&[*b"mif1", *b"\0\0\0\0", *b"heic"])), Some(Sniffed::Heic));
        // Neither the version nor the bytes after the box are brands.
        assert_eq!(sniff(&start(&[*b"isom", *b"heic", *b"mp42"])), None);
    }

    #[test]
    fn short_and_foreign_starts_are_none_of_these() {
        for other in [&b""[..], b"\xFF", b"\0\0\0\x18ftyp", b"\0\0\0\x18ftypav", b"\0\0\0\0ftypmp42", b"\0\0\0\x0CJXL "]
        {
            assert_eq!(sniff(other), None);
        }
        assert_eq!(sniff(b"\xFF\x0A\0"), Some(Sniffed::JpegXl));
        assert_eq!(sniff(b"\0\0\0\x0CJXL \r\n\x87\n\0\0\0\x14ftypjxl "), Some(Sniffed::JpegXl));
    }
}
