//! What a picture file states about its colours, its alpha and its metadata that the decoders of `image` ignore, and
//! the parts that are hidden from them to bound their memory.

use std::io::{self, BufRead, ErrorKind, Read, Seek, SeekFrom};

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageResult, Rgba};

use super::colour::{of_cicp, of_gamma};
use super::overlay::Replacements;
use crate::bitstream::cicp::Cicp;
use crate::bitstream::header::MAGIC;
use crate::decode::Reader;
use crate::limits::Limits;

/// Maximum length of an ICC profile that is read from a picture of another format, bytes, decompressed. Profiles of
/// displays and cameras have up to 1 MB, those of printers up to 3 MB. Longer profiles are left out.
pub const MAX_PROFILE_BYTES: u64 = 4 << 20;

/// Maximum length of an EXIF block of a PNG, bytes. Longer blocks are left out.
const MAX_PNG_EXIF_BYTES: u32 = 16 << 20;

/// Maximum number of chunks or segments that are hidden from a decoder. Files with more are refused: their decoder
/// would keep all of them in memory.
const MAX_HIDDEN: usize = 1 << 16;

/// Whether the profile of a picture is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Profiles {
    Read,
    /// Profiles are neither read nor decompressed.
    Ignore,
}

/// A profile that is left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LeftOut {
    /// It is longer than [`MAX_PROFILE_BYTES`].
    TooLong,
    /// It is longer than [`MAX_PROFILE_BYTES`] or cannot be decompressed.
    Unreadable,
}

/// A chunk of a PNG: the offset of its first byte, and its length without length, type and checksum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chunk {
    pub start: u64,
    pub length: u32,
}

/// What a file states about its colours in addition to the profile that its decoder finds.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Stated {
    /// Code points that no profile can express.
    pub cicp: Option<Cicp>,
    /// A profile with the same meaning.
    icc: Option<Vec<u8>>,
    /// Whether it takes precedence over the profile that the decoder finds.
    is_first: bool,
    /// Whether the decoder must not be asked for its profile.
    ignores_decoder: bool,
    /// The file has a profile that is left out because it is too long.
    is_too_long: bool,
    /// The file has a compressed profile, which its decoder reads.
    has_packed: bool,
    /// A note for the user about colours that are left out.
    #[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "only the program and the encoder ask for it"))]
    pub note: Option<&'static str>,
    /// Whether decoders return all pictures of the format with alpha.
    always_has_alpha: bool,
    /// Whether the colours are multiplied by alpha.
    is_premultiplied: bool,
    /// Bytes that hide chunks and segments from the decoder, for [`Overlay`](super::overlay::Overlay).
    pub hidden: Replacements,
    /// Whether the file has an XMP block that is hidden from the decoder.
    #[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "only the program asks for it"))]
    pub has_xmp: bool,
    /// A text chunk of a PNG with an EXIF block as hexadecimal digits, as ImageMagick and ExifTool write it.
    #[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "only the program asks for it"))]
    pub exif_text: Option<Chunk>,
    /// The EXIF block of a PNG, which is hidden from the decoder.
    exif: Option<Vec<u8>>,
    /// A note about an EXIF block that is left out.
    #[cfg_attr(not(feature = "unstable"), allow(dead_code, reason = "only the program asks for it"))]
    pub exif_note: Option<&'static str>,
}

impl Stated {
    /// Returns the profile to use, given the profile that the decoder found.
    pub fn or(&self, found: Option<Vec<u8>>) -> Option<Vec<u8>> {
        if self.is_first { self.icc.clone().or(found) } else { found.or_else(|| self.icc.clone()) }
    }

    /// Returns the profile to use, and a note if the profile of the file is left out because of its length.
    ///
    /// # Errors
    /// Those of `decoder`.
    pub fn profile(&self, decoder: &mut impl ImageDecoder) -> ImageResult<(Option<Vec<u8>>, Option<String>)> {
        Ok(self.with_profile(if self.ignores_decoder { None } else { decoder.icc_profile()? }))
    }

    /// As [`profile`](Self::profile), without that of the decoder.
    #[cfg(feature = "unstable")]
    pub fn own_profile(&self) -> (Option<Vec<u8>>, Option<String>) {
        self.with_profile(None)
    }

    /// As [`profile`](Self::profile), with the profile that another decoder found.
    pub fn with_profile(&self, mut found: Option<Vec<u8>>) -> (Option<Vec<u8>>, Option<String>) {
        let mut left_out = self.is_too_long.then_some(LeftOut::TooLong);
        if found.as_ref().is_some_and(|icc| icc.len() as u64 > MAX_PROFILE_BYTES) {
            (found, left_out) = (None, Some(LeftOut::TooLong));
        } else if found.is_none() && self.has_packed {
            left_out = Some(LeftOut::Unreadable);
        }
        let note = left_out.map(|left_out| {
            let why = match left_out {
                LeftOut::TooLong => "",
                LeftOut::Unreadable => "is broken or ",
            };
            format!("its ICC profile {why}has more than {MAX_PROFILE_BYTES} bytes, and is left out")
        });
        (self.or(found), note)
    }

    /// Returns the EXIF block and the orientation of the picture.
    ///
    /// # Errors
    /// Those of `decoder`.
    pub fn exif(&self, decoder: &mut impl ImageDecoder) -> ImageResult<(Option<Vec<u8>>, Orientation)> {
        if let Some(exif) = &self.exif {
            let orientation = Orientation::from_exif_chunk(exif).unwrap_or(Orientation::NoTransforms);
            return Ok((Some(exif.clone()), orientation));
        }
        let exif = decoder.exif_metadata()?;
        Ok((exif, decoder.orientation().unwrap_or(Orientation::NoTransforms)))
    }

    /// Returns the EXIF block of a PNG.
    #[cfg(feature = "unstable")]
    pub fn own_exif(&self) -> Option<Vec<u8>> {
        self.exif.clone()
    }

    /// Corrects the pixels that a decoder returned: removes an alpha channel that it adds to all pictures of the
    /// format, if it is opaque, and divides premultiplied colours by alpha.
    pub fn corrected(&self, picture: DynamicImage) -> DynamicImage {
        match picture {
            DynamicImage::ImageRgba8(picture) if self.always_has_alpha && picture.pixels().all(|p| p.0[3] == 255) => {
                DynamicImage::ImageRgba8(picture).into_rgb8().into()
            }
            other if self.is_premultiplied => straight(other),
            other => other,
        }
    }
}

/// Divides premultiplied colours by alpha. Colours under alpha 0 become 0.
pub fn straight(mut picture: DynamicImage) -> DynamicImage {
    match &mut picture {
        DynamicImage::ImageLumaA8(p) => divide(p.as_flat_samples_mut().samples, 2, 255),
        DynamicImage::ImageRgba8(p) => divide(p.as_flat_samples_mut().samples, 4, 255),
        DynamicImage::ImageLumaA16(p) => divide(p.as_flat_samples_mut().samples, 2, 65535),
        DynamicImage::ImageRgba16(p) => divide(p.as_flat_samples_mut().samples, 4, 65535),
        DynamicImage::ImageRgba32F(p) => {
            for pixel in p.pixels_mut() {
                let Rgba([r, g, b, alpha]) = *pixel;
                let [r, g, b] = [r, g, b].map(|color| if alpha > 0.0 { color / alpha } else { 0.0 });
                *pixel = Rgba([r, g, b, alpha]);
            }
        }
        _ => {}
    }
    picture
}

/// Divides the colours of pixels of `count` samples by their alpha, the last sample; `max` is opaque.
fn divide<T: Copy + Into<u32> + TryFrom<u32>>(samples: &mut [T], count: usize, max: u32) {
    for pixel in samples.chunks_exact_mut(count) {
        let Some((&mut alpha, colors)) = pixel.split_last_mut() else { continue };
        let alpha: u32 = alpha.into();
        for color in colors.iter_mut().filter(|_| alpha < max) {
            let divided = ((*color).into() * max + alpha / 2).checked_div(alpha).unwrap_or(0);
            *color = T::try_from(divided.min(max)).unwrap_or(*color);
        }
    }
}

/// Reads what the file in `reader` states about its colours: `cICP`, `gAMA` and `cHRM` of PNG, and the profiles of TIFF
/// and WebP. Finds the parts of the file that are hidden from its decoder, because it would keep them in memory: text
/// of PNG, and profiles that are too long or that `profiles` ignores. The reader is rewound.
///
/// # Errors
/// Errors of `reader`, and [`ErrorKind::FileTooLarge`] for a file with too many parts to hide. A truncated file is not
/// an error.
pub fn look(reader: &mut (impl BufRead + Seek), profiles: Profiles) -> io::Result<Stated> {
    let mut stated = Stated::default();
    let found = match reader.fill_buf()? {
        [0x89, b'P', b'N', b'G', ..] => png(reader, profiles, &mut stated),
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => tiff(reader, &mut stated),
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => webp(reader, &mut stated),
        [0xFF, 0xD8, 0xFF, ..] => jpeg(reader, profiles, &mut stated),
        [a, b, c, d, ..] if [*a, *b, *c, *d] == MAGIC => ssplat(reader, &mut stated),
        [b'G', b'I', b'F', b'8', ..] => {
            stated.always_has_alpha = true;
            Ok(())
        }
        _ => Ok(()),
    };
    reader.rewind()?;
    up_to_the_end(found)?;
    if profiles == Profiles::Ignore {
        (stated.icc, stated.cicp) = (None, None);
        (stated.is_too_long, stated.has_packed, stated.ignores_decoder) = (false, false, true);
    }
    Ok(stated)
}

fn bytes<const N: usize>(reader: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    reader.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// Takes the end of the file as the end of what it states.
fn up_to_the_end(found: io::Result<()>) -> io::Result<()> {
    match found {
        Err(e) if e.kind() == ErrorKind::UnexpectedEof => Ok(()),
        found => found,
    }
}

impl Stated {
    /// Hides the byte at `offset` behind `value`.
    fn hide(&mut self, offset: u64, value: u8) -> io::Result<()> {
        if self.hidden.len() == MAX_HIDDEN {
            let problem = format!("has more than {MAX_HIDDEN} chunks of metadata");
            return Err(io::Error::new(ErrorKind::FileTooLarge, problem));
        }
        self.hidden.push((offset, value));
        Ok(())
    }

    /// Reads a profile of `length` bytes that is stored as it is, instead of the decoder.
    fn read_profile(&mut self, reader: &mut impl Read, length: u64) -> io::Result<()> {
        self.ignores_decoder = true;
        if length > MAX_PROFILE_BYTES {
            self.is_too_long = true;
            return Ok(());
        }
        let mut icc = Vec::new();
        reader.by_ref().take(length).read_to_end(&mut icc)?;
        // Shorter values contain no header.
        if icc.len() as u64 == length && icc.len() >= 128 {
            (self.icc, self.is_first) = (Some(icc), true);
        }
        Ok(())
    }
}

/// Reads the code points of an ssplat file, which `image` has no way to return. Other errors are left to the decoder.
fn ssplat(reader: &mut impl Read, stated: &mut Stated) -> io::Result<()> {
    /// More than the header and the heads of the sections.
    const HEADS: u64 = 1 << 12;
    let mut bytes = Vec::new();
    reader.by_ref().take(Limits::default().metadata + HEADS).read_to_end(&mut bytes)?;
    let metadata = Reader::new(&bytes, &Limits::default()).and_then(|reader| reader.metadata());
    stated.cicp = metadata.ok().and_then(|metadata| metadata.cicp);
    Ok(())
}

/// The first byte of the names of hidden PNG chunks. It makes a name that no decoder knows, and of a chunk that may be
/// ignored.
const HIDDEN_CHUNK: u8 = b'x';

/// The longest keyword of a text chunk, and the byte behind it.
const KEYWORD: u64 = 80;

/// Reads all chunks. `cICP` takes precedence over a profile, and a profile or `sRGB` over `gAMA` and `cHRM`.
fn png(reader: &mut (impl Read + Seek), profiles: Profiles, stated: &mut Stated) -> io::Result<()> {
    let (mut is_grey, mut gamma, mut chromaticities) = (false, None, None);
    let (mut cicp, mut has_srgb, mut packed) = (None, false, Vec::new());
    let (mut has_late_exif, mut is_after_pixels) = (false, false);
    let mut chunks = || -> io::Result<()> {
        let mut start = 8;
        reader.seek(SeekFrom::Start(start))?;
        loop {
            let length = u32::from_be_bytes(bytes(reader)?);
            let name: [u8; 4] = bytes(reader)?;
            let mut read = 0;
            match (&name, length) {
                (b"IHDR", 13) => {
                    let header: [u8; 13] = bytes(reader)?;
                    (is_grey, read) = ([0, 4].contains(&header[9]), 13);
                }
                (b"cICP", 4) if !is_after_pixels => {
                    let found: [u8; 4] = bytes(reader)?;
                    (cicp, read) = (Some(found), 4);
                    // The decoder would refuse the picture.
                    if Cicp::from_bytes(&found).is_err() {
                        stated.hide(start + 4, HIDDEN_CHUNK)?;
                    }
                }
                (b"gAMA", 4) if !is_after_pixels => {
                    (gamma, read) = (Some(f64::from(u32::from_be_bytes(bytes(reader)?)) / 1e5), 4);
                }
                (b"cHRM", 32) if !is_after_pixels => {
                    let said: [u8; 32] = bytes(reader)?;
                    let (values, _) = said.as_chunks::<4>();
                    let values: Vec<f64> = values.iter().map(|v| f64::from(u32::from_be_bytes(*v)) / 1e5).collect();
                    (chromaticities, read) = (values.try_into().ok(), 32);
                }
                (b"sRGB", _) if !is_after_pixels => has_srgb = true,
                (b"iCCP", _) if !is_after_pixels => {
                    // A profile that is compressed to more bytes is longer still.
                    if u64::from(length) > MAX_PROFILE_BYTES {
                        stated.is_too_long = true;
                        stated.hide(start + 4, HIDDEN_CHUNK)?;
                    } else {
                        packed.push(start + 4);
                    }
                }
                (b"eXIf", _) if is_after_pixels => has_late_exif = true,
                (b"eXIf", _) => {
                    stated.hide(start + 4, HIDDEN_CHUNK)?;
                    if length > MAX_PNG_EXIF_BYTES {
                        stated.exif_note = Some("its EXIF block has more than 16 MiB, and is left out");
                    } else if stated.exif.is_none() {
                        let mut exif = Vec::new();
                        reader.by_ref().take(length.into()).read_to_end(&mut exif)?;
                        read = exif.len() as i64;
                        stated.exif = Some(exif);
                    }
                }
                (b"tEXt" | b"zTXt" | b"iTXt", _) => {
                    let mut keyword = Vec::new();
                    reader.by_ref().take(KEYWORD.min(length.into())).read_to_end(&mut keyword)?;
                    read = keyword.len() as i64;
                    match keyword.split(|&byte| byte == 0).next() {
                        Some(b"XML:com.adobe.xmp") => stated.has_xmp = true,
                        Some(b"Raw profile type exif" | b"Raw profile type APP1") if stated.exif_text.is_none() => {
                            stated.exif_text = Some(Chunk { start, length });
                        }
                        _ => {}
                    }
                    if !is_after_pixels {
                        stated.hide(start + 4, HIDDEN_CHUNK)?;
                    }
                }
                (b"IDAT", _) => is_after_pixels = true,
                (b"IEND", _) => return Ok(()),
                _ => {}
            }
            reader.seek_relative(i64::from(length) - read + 4)?;
            start += u64::from(length) + 12;
        }
    };
    up_to_the_end(chunks())?;
    if has_late_exif && stated.exif.is_none() {
        stated.exif_note = Some("its EXIF block follows the pixels, where decoders of PNG ignore it, and is left out");
    }
    if stated.exif.is_some() {
        stated.exif_text = None;
    }
    let found = cicp.map(|cicp| of_cicp(cicp, is_grey)).unwrap_or_default();
    stated.note = found.note;
    // Invalid code points count as none.
    let cicp = cicp.filter(|_| found.note.is_none());
    let is_hidden = profiles == Profiles::Ignore || cicp.is_some();
    stated.has_packed = !packed.is_empty() && !is_hidden;
    if is_hidden {
        // In the order of their offsets.
        for at in packed {
            stated.hide(at, HIDDEN_CHUNK)?;
        }
        stated.hidden.sort_unstable();
    }
    if cicp.is_some() {
        (stated.cicp, stated.is_first, stated.icc) = (found.cicp, found.icc.is_some(), found.icc);
        stated.is_too_long = false;
    } else if !has_srgb && !stated.has_packed {
        stated.icc = of_gamma(gamma, chromaticities, is_grey);
    }
    Ok(())
}

/// The kind of the first extra sample of a TIFF, or its offset.
enum Extra {
    Kind(u64),
    At(u64),
}

/// Reads the first directory of a TIFF or a BigTIFF. `image` limits the values of a tag to 1/32 of the samples, and
/// loses the profiles of small pictures.
fn tiff(reader: &mut (impl Read + Seek), stated: &mut Stated) -> io::Result<()> {
    stated.ignores_decoder = true;
    let head: [u8; 8] = bytes(reader)?;
    let is_little = head[0] == b'I';
    let number = |bytes: &[u8]| {
        let add = |sum: u64, &byte: &u8| sum << 8 | u64::from(byte);
        if is_little { bytes.iter().rev().fold(0, add) } else { bytes.iter().fold(0, add) }
    };
    let is_big = number(&head[2..4]) == 43;
    let entries = if is_big {
        let first = number(&bytes::<8>(reader)?);
        reader.seek(SeekFrom::Start(first))?;
        number(&bytes::<8>(reader)?)
    } else {
        reader.seek(SeekFrom::Start(number(&head[4..8])))?;
        number(&bytes::<2>(reader)?)
    };
    let mut profile = None;
    let mut extra = None;
    for _ in 0..entries.min(u16::MAX.into()) {
        let (tag, kind) = (number(&bytes::<2>(reader)?), number(&bytes::<2>(reader)?));
        let (count, value) = if is_big {
            (number(&bytes::<8>(reader)?), bytes::<8>(reader)?)
        } else {
            let count = number(&bytes::<4>(reader)?);
            let mut value = [0; 8];
            value[..4].copy_from_slice(&bytes::<4>(reader)?);
            (count, value)
        };
        let offset = number(&value[..if is_big { 8 } else { 4 }]);
        match (tag, kind) {
            // ICC profile; XMP; kinds and numbers of extra samples.
            (34675, _) => profile = Some((offset, count)),
            (700, _) => stated.has_xmp = true,
            // Up to two kinds are in the entry itself (four in a BigTIFF).
            (338, 3) if count > if is_big { 4 } else { 2 } => extra = Some(Extra::At(offset)),
            (338, 3) if count > 0 => extra = Some(Extra::Kind(number(&value[..2]))),
            _ => {}
        }
    }
    let kind = match extra {
        Some(Extra::Kind(kind)) => kind,
        Some(Extra::At(offset)) => {
            reader.seek(SeekFrom::Start(offset))?;
            number(&bytes::<2>(reader)?)
        }
        None => 0,
    };
    // Associated alpha.
    stated.is_premultiplied = kind == 1;
    if let Some((offset, count)) = profile {
        reader.seek(SeekFrom::Start(offset))?;
        stated.read_profile(reader, count)?;
    }
    Ok(())
}

/// Reads the profile of a WebP.
fn webp(reader: &mut (impl Read + Seek), stated: &mut Stated) -> io::Result<()> {
    stated.ignores_decoder = true;
    reader.seek(SeekFrom::Start(12))?;
    loop {
        let name: [u8; 4] = bytes(reader)?;
        let length = u32::from_le_bytes(bytes(reader)?);
        if &name == b"ICCP" {
            return stated.read_profile(reader, length.into());
        }
        // Chunks have even lengths.
        reader.seek_relative(i64::from(length) + i64::from(length & 1))?;
    }
}

/// Adds up the segments of the profile of a JPEG, up to the samples.
fn jpeg(reader: &mut (impl BufRead + Seek), profiles: Profiles, stated: &mut Stated) -> io::Result<()> {
    const PROFILE: &[u8; 12] = b"ICC_PROFILE\0";
    /// An application segment that no decoder knows.
    const HIDDEN_SEGMENT: u8 = 0xEF;
    reader.seek(SeekFrom::Start(2))?;
    let (mut segments, mut sum) = (Vec::new(), 0);
    let mut find = || -> io::Result<()> {
        loop {
            reader.skip_until(0xFF)?;
            let mut marker = bytes::<1>(reader)?[0];
            while marker == 0xFF {
                marker = bytes::<1>(reader)?[0];
            }
            if matches!(marker, 0x00 | 0x01 | 0xD0..=0xD8) {
                continue;
            }
            // The start of the samples, and the end of the file.
            if matches!(marker, 0xDA | 0xD9) {
                return Ok(());
            }
            let length = i64::from(u16::from_be_bytes(bytes(reader)?));
            let mut read = 2;
            if marker == 0xE2 && length >= 14 {
                let at = reader.stream_position()? - 3;
                let start: [u8; 12] = bytes(reader)?;
                read += 12;
                if &start == PROFILE {
                    sum += length as u64 - 14;
                    segments.push(at);
                    if segments.len() > MAX_HIDDEN {
                        return Ok(());
                    }
                }
            }
            reader.seek_relative((length - read).max(0))?;
        }
    };
    up_to_the_end(find())?;
    stated.is_too_long = sum > MAX_PROFILE_BYTES;
    if stated.is_too_long || profiles == Profiles::Ignore {
        stated.ignores_decoder = true;
        for at in segments {
            stated.hide(at, HIDDEN_SEGMENT)?;
        }
    }
    Ok(())
}
