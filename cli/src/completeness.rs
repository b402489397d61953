//! Structure of a picture file beyond its first picture: whether the file is complete, and whether more pictures
//! follow. Decoders fill the missing part of a truncated JPEG with grey, and ignore further frames.

use std::io::{self, BufRead, ErrorKind, Read, Seek, SeekFrom};

use image::ImageFormat;

/// Properties of a file's structure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Structure {
    /// The file has its end marker.
    pub is_whole: bool,
    /// The file has more than one frame or page.
    pub has_more: bool,
    /// The file has a gain map, with which displays of high dynamic range show its picture.
    pub has_gain_map: bool,
    /// The first picture is a reduced version of another one, as in raw files of cameras.
    pub is_reduced: bool,
    /// The file uses a kind of coding that its decoder does not support: what it is, and what to do.
    pub unsupported: Option<&'static str>,
}

/// Scans a file of `format` from its start. Formats whose decoders detect truncation count as complete.
pub fn look<R: BufRead + Seek>(reader: &mut R, format: ImageFormat) -> io::Result<Structure> {
    let mut found =
        Structure { is_whole: true, has_more: false, has_gain_map: false, is_reduced: false, unsupported: None };
    let outcome = match format {
        ImageFormat::Jpeg => jpeg(reader, &mut found),
        ImageFormat::Gif => gif(reader, &mut found),
        ImageFormat::Png => png(reader, &mut found),
        ImageFormat::WebP => webp(reader, &mut found),
        ImageFormat::Tiff => tiff(reader, &mut found),
        _ => Ok(()),
    };
    match outcome {
        Err(e) if e.kind() == ErrorKind::UnexpectedEof => found.is_whole = false,
        outcome => outcome?,
    }
    Ok(found)
}

fn bytes<const N: usize>(reader: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    reader.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn byte(reader: &mut impl Read) -> io::Result<u8> {
    Ok(bytes::<1>(reader)?[0])
}

const TWELVE_BITS: &str = "is a JPEG with 12 bits per sample, which is not supported: convert it first, with \
                           `djpeg IN.jpg > OUT.ppm` of libjpeg-turbo 3";

/// Returns what is not supported about the frame that starts with `marker` (ISO/IEC 10918-1, table B.1), and what to
/// do.
fn unsupported_frame(marker: u8) -> Option<&'static str> {
    Some(match marker {
        0xC9 | 0xCA | 0xCC => {
            "is a JPEG with arithmetic coding, which is not supported: convert it first, without loss, with \
             `jpegtran -copy all -optimize IN.jpg > OUT.jpg`"
        }
        0xC3 | 0xCB => {
            "is a lossless JPEG, which is not supported: convert it first, with `djpeg IN.jpg > OUT.ppm` of libjpeg-turbo 3"
        }
        0xC5..=0xC7 | 0xCD..=0xCF => "is a hierarchical JPEG, which is not supported: convert it to PNG first",
        0xF7 => "is a JPEG-LS file, which is not supported: convert it first, with `ffmpeg -i IN.jls OUT.png`",
        _ => return None,
    })
}

/// Returns whether a segment belongs to a picture with a gain map: by ISO 21496-1, or by XMP as Ultra HDR (Android 14) and
/// cameras of Apple write it.
fn states_gain_map(body: &[u8]) -> bool {
    const XMP: &[u8] = b"http://ns.adobe.com/xap/1.0/\0";
    let has = |name: &[u8]| body.windows(name.len()).any(|bytes| bytes == name);
    body.starts_with(b"urn:iso:std:iso:ts:21496:-1\0")
        || body.starts_with(XMP) && (has(b"http://ns.adobe.com/hdr-gain-map/1.0/") || has(b"HDRGainMap"))
}

/// Reads up to the end marker. Skips everything but markers between segments and within a scan.
fn jpeg(reader: &mut impl BufRead, found: &mut Structure) -> io::Result<()> {
    loop {
        let skipped = reader.skip_until(0xFF)?;
        if skipped == 0 {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        let mut marker = byte(reader)?;
        while marker == 0xFF {
            marker = byte(reader)?;
        }
        match marker {
            0xD9 => return Ok(()),
            // A stuffed byte of a scan, a restart marker, the start marker, and a marker without a length.
            0x00 | 0x01 | 0xD0..=0xD8 => {}
            marker => {
                if let Some(kind) = unsupported_frame(marker) {
                    found.unsupported = Some(kind);
                    return Ok(());
                }
                let mut length = u64::from(u16::from_be_bytes(bytes(reader)?)).saturating_sub(2);
                if matches!(marker, 0xE1 | 0xE2) {
                    let mut body = Vec::new();
                    reader.take(length).read_to_end(&mut body)?;
                    length -= body.len() as u64;
                    // An index of pictures that follow the first one (CIPA DC-007).
                    found.has_more |= marker == 0xE2 && body.starts_with(b"MPF\0");
                    found.has_gain_map |= states_gain_map(&body);
                }
                // A frame header starts with the number of bits per sample.
                if matches!(marker, 0xC0..=0xC2) && length >= 1 {
                    if byte(reader)? == 12 {
                        found.unsupported = Some(TWELVE_BITS);
                        return Ok(());
                    }
                    length -= 1;
                }
                skip(reader, length)?;
            }
        }
    }
}

fn skip(reader: &mut impl Read, length: u64) -> io::Result<()> {
    let passed = io::copy(&mut reader.take(length), &mut io::sink())?;
    if passed < length { Err(ErrorKind::UnexpectedEof.into()) } else { Ok(()) }
}

/// Reads the blocks up to the trailer.
fn gif(reader: &mut impl Read, found: &mut Structure) -> io::Result<()> {
    let screen: [u8; 13] = bytes(reader)?;
    let colors = |flags: u8| if flags & 0x80 != 0 { 3u64 << ((flags & 7) + 1) } else { 0 };
    skip(reader, colors(screen[10]))?;
    let mut frames = 0;
    loop {
        match byte(reader)? {
            0x2C => {
                let frame: [u8; 9] = bytes(reader)?;
                // The colour table, and one byte before the blocks of samples.
                skip(reader, colors(frame[8]) + 1)?;
                frames += 1;
                found.has_more = frames > 1;
            }
            0x21 => skip(reader, 1)?,
            0x3B => return Ok(()),
            // Not a block; the decoder reports it.
            _ => return Ok(()),
        }
        loop {
            match byte(reader)? {
                0 => break,
                length => skip(reader, u64::from(length))?,
            }
        }
    }
}

/// Looks for the animation control chunk.
fn png(reader: &mut (impl Read + Seek), found: &mut Structure) -> io::Result<()> {
    skip(reader, 8)?;
    loop {
        let length = u32::from_be_bytes(bytes(reader)?);
        match &bytes::<4>(reader)? {
            b"acTL" => {
                found.has_more = u32::from_be_bytes(bytes(reader)?) > 1;
                return Ok(());
            }
            b"IDAT" => return Ok(()),
            _ => reader.seek(SeekFrom::Current(i64::from(length) + 4))?,
        };
    }
}

/// Reads the animation flag of the extended header.
fn webp(reader: &mut impl Read, found: &mut Structure) -> io::Result<()> {
    let head: [u8; 16] = bytes(reader)?;
    if &head[12..] == b"VP8X" {
        let flags: [u8; 5] = bytes(reader)?;
        found.has_more = flags[4] & 2 != 0;
    }
    Ok(())
}

/// Checks whether another directory follows the first one.
fn tiff(reader: &mut (impl Read + Seek), found: &mut Structure) -> io::Result<()> {
    let head: [u8; 8] = bytes(reader)?;
    let short = |b: [u8; 2]| if head[0] == b'I' { u16::from_le_bytes(b) } else { u16::from_be_bytes(b) };
    let long = |b: [u8; 4]| if head[0] == b'I' { u32::from_le_bytes(b) } else { u32::from_be_bytes(b) };
    // BigTIFF is not checked.
    if short([head[2], head[3]]) != 42 {
        return Ok(());
    }
    reader.seek(SeekFrom::Start(u64::from(long([head[4], head[5], head[6], head[7]]))))?;
    for _ in 0..short(bytes(reader)?) {
        let entry: [u8; 12] = bytes(reader)?;
        // NewSubfileType; its lowest bit marks a reduced version of another picture.
        if short([entry[0], entry[1]]) == 254 {
            found.is_reduced = long([entry[8], entry[9], entry[10], entry[11]]) & 1 != 0;
        }
    }
    found.has_more = long(bytes(reader)?) != 0;
    Ok(())
}
