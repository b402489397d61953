//! Pictures in: any format that is known by its content, with its ICC profile and EXIF block.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read, Seek};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageReader};
use ssplat::bitstream::header::MAGIC;
use ssplat::{DecodeOptions, Pixels};

use crate::failure::Failure;

/// Most bytes that a decoder of `image` may allocate: a 177-megapixel picture takes 531 MB with 8 bits, twice that
/// with 16.
const MAX_ALLOC: u64 = 8 << 30;

/// A picture and what came with it.
pub struct Source {
    pub pixels: Pixels,
    pub icc: Option<Vec<u8>>,
    pub exif: Option<Vec<u8>>,
}

trait ReadSeek: BufRead + Seek {}
impl<T: BufRead + Seek> ReadSeek for T {}

/// Reads the whole of `path`, or of standard input for `-`.
pub fn read_all(path: &Path) -> Result<Vec<u8>, Failure> {
    let mut bytes = Vec::new();
    let read = if path == Path::new("-") {
        std::io::stdin().lock().read_to_end(&mut bytes)
    } else {
        File::open(path).and_then(|mut f| f.read_to_end(&mut bytes))
    };
    read.map_err(|e| Failure::io(path, &e))?;
    Ok(bytes)
}

/// Decodes `path`, or standard input for `-`.
pub fn open(path: &Path) -> Result<Source, Failure> {
    let io = |e| Failure::io(path, &e);
    let mut reader: Box<dyn ReadSeek> = if path == Path::new("-") {
        Box::new(Cursor::new(read_all(path)?))
    } else {
        Box::new(BufReader::new(File::open(path).map_err(io)?))
    };
    if reader.fill_buf().map_err(io)?.starts_with(&MAGIC) {
        let mut bytes = Vec::new();
        reader.read_to_end(&mut bytes).map_err(io)?;
        return decode(path, &bytes);
    }
    let failed = |e| Failure::image(path, &e);
    let mut image = ImageReader::new(reader).with_guessed_format().map_err(io)?;
    if image.format().is_none() {
        // A few formats (TGA) cannot be told by their content.
        if let Ok(format) = image::ImageFormat::from_path(path) {
            image.set_format(format);
        }
    }
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(MAX_ALLOC);
    image.limits(limits);
    let mut decoder = image.into_decoder().map_err(failed)?;
    let icc = decoder.icc_profile().map_err(failed)?;
    let exif = decoder.exif_metadata().map_err(failed)?;
    let picture = DynamicImage::from_decoder(decoder).map_err(failed)?;
    let pixels = Pixels::try_from(picture).map_err(|e| Failure::library(path, &e))?;
    Ok(Source { pixels, icc, exif })
}

/// Decodes the ssplat file `bytes`, which came from `path`.
pub fn decode(path: &Path, bytes: &[u8]) -> Result<Source, Failure> {
    let decoded = ssplat::decode(bytes, &DecodeOptions::default()).map_err(|e| Failure::library(path, &e))?;
    Ok(Source { pixels: decoded.pixels, icc: decoded.metadata.icc, exif: decoded.metadata.exif })
}
