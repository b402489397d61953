//! Reads kinds of TIFF that `image` does not read: palettes, YCbCr and JPEG, grey with alpha, floating-point and 32-bit
//! samples, and 2 or 4 bits. For others that it does not read either, says what they are and what to do.

use std::io::{BufRead, Read, Seek, SeekFrom};
use std::path::Path;

use image::metadata::Orientation;
use image::{DynamicImage, ImageBuffer};
use ssplat::unstable::colour::Overlay;
use ssplat::unstable::input::MAX_ALLOC;
use tiff::decoder::{BufferLayoutPreference, Decoder, DecodingResult, Limits};
use tiff::tags::Tag;
use tiff::{TiffError, TiffResult};

use crate::failure::{Failure, Kind};
use crate::floats::Range;
use crate::limits;

/// A picture in memory.
pub struct Found {
    pub picture: DynamicImage,
    pub orientation: Orientation,
    pub notes: Vec<String>,
}

/// Meaning of the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Colors {
    Grey,
    GreyAlpha,
    Rgb,
    Rgba,
    YCbCr,
    Palette,
}

impl Colors {
    /// Samples of a pixel.
    fn count(self) -> usize {
        match self {
            Colors::Grey | Colors::Palette => 1,
            Colors::GreyAlpha => 2,
            Colors::Rgb | Colors::YCbCr => 3,
            Colors::Rgba => 4,
        }
    }
}

/// Samples with all pixels together, in a type of `image`. Floating-point samples are not yet clipped.
enum Samples {
    U8(Vec<u8>),
    U16(Vec<u16>),
    F32(Vec<f32>),
}

/// What the directory states about the samples.
struct Directory {
    width: u32,
    height: u32,
    photometric: u16,
    /// Samples of a pixel that are stored, the extra ones included.
    stored: u16,
    bits: u16,
    /// 1 are integers, 2 are signed integers, 3 are floating-point numbers.
    format: u16,
    /// 7 is JPEG.
    compression: u16,
    /// 2 means that the lowest bit of a byte is the first one.
    fill_order: u16,
    /// The kind of the first extra sample: 1 and 2 are alpha.
    extra: Option<u16>,
}

/// Decodes the TIFF in `input`, which came from `path`, if it is of a kind that `image` does not read; `None` for other
/// pictures. The input is rewound.
pub fn read(path: &Path, input: &mut (impl BufRead + Seek)) -> Result<Option<Found>, Failure> {
    let io = |e| Failure::io(path, &e);
    let start = input.fill_buf().map_err(io)?;
    if !matches!(start, [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..]) {
        return Ok(None);
    }
    let found = found(path, input);
    input.rewind().map_err(io)?;
    found
}

fn found(path: &Path, input: &mut (impl BufRead + Seek)) -> Result<Option<Found>, Failure> {
    // The decoder of `image` reports what is wrong with a broken directory.
    let io = |e| Failure::io(path, &e);
    let overlay = Overlay::new(&mut *input, Vec::new()).map_err(io)?;
    let Ok(directory) = Decoder::new(overlay).and_then(|mut decoder| directory(&mut decoder)) else {
        return Ok(None);
    };
    let colors = match kind(&directory) {
        Ok(Some(colors)) => colors,
        Ok(None) => return Ok(None),
        Err(what) => return Err(unsupported(path, &what)),
    };
    let failed = |e| failure(path, e);
    // Twice: as they are stored and as they are returned.
    let pixels = u64::from(directory.width) * u64::from(directory.height);
    let bytes = u64::from(directory.bits.div_ceil(8).max(2)) + 4;
    if pixels.checked_mul(u64::from(directory.stored) * bytes).is_none_or(|bytes| bytes > MAX_ALLOC) {
        return Err(Failure { kind: Kind::Limit, message: limits::beyond_memory(path) });
    }
    // The decoder takes the numbers of colours for grey.
    let hidden = if colors == Colors::Palette { photometric(&mut *input).map_err(io)? } else { Vec::new() };
    let overlay = Overlay::new(&mut *input, hidden).map_err(io)?;
    let mut limits = Limits::default();
    let most = usize::try_from(MAX_ALLOC).unwrap_or(usize::MAX);
    (limits.decoding_buffer_size, limits.intermediate_buffer_size) = (most, most);
    let mut decoder = Decoder::new(overlay).map_err(failed)?.with_limits(limits);
    let map = match colors {
        Colors::Palette => decoder.get_tag_u16_vec(Tag::ColorMap).map_err(failed)?,
        _ => Vec::new(),
    };
    let orientation = decoder.find_tag_unsigned(Tag::Orientation).map_err(failed)?;
    let orientation = orientation.and_then(Orientation::from_exif).unwrap_or(Orientation::NoTransforms);
    let luma = decoder.find_tag(Tag::Unknown(529)).map_err(failed)?.and_then(|value| value.into_f32_vec().ok());
    let mut result = DecodingResult::U8(Vec::new());
    let layout = decoder.read_image_to_buffer(&mut result).map_err(failed)?;
    let has_xmp = decoder.find_tag(Tag::Unknown(700)).is_ok_and(|tag| tag.is_some());
    drop(decoder);
    let samples = samples(path, result, &layout, &directory, colors.count())?;
    let mut notes = Vec::new();
    if has_xmp {
        notes.push("its XMP block is left out".into());
    }
    let (colors, samples) = match (colors, samples) {
        (Colors::Palette, samples) => (Colors::Rgb, looked_up(path, samples, &map)?),
        (Colors::YCbCr, Samples::U8(samples)) => (Colors::Rgb, Samples::U8(rgb(samples, luma.as_deref()))),
        (Colors::YCbCr, _) => return Err(unsupported(path, "has YCbCr of more than 8 bits")),
        (Colors::Grey | Colors::GreyAlpha, Samples::F32(samples)) => {
            notes.extend(Range::of(samples.iter().copied()).check(path, true)?);
            let words = samples.iter().map(|v| (v.clamp(0.0, 1.0) * 65535.0).round() as u16).collect();
            (colors, Samples::U16(words))
        }
        other => other,
    };
    let (width, height) = (directory.width, directory.height);
    let picture = match (samples, colors) {
        (Samples::U8(v), Colors::Grey) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageLuma8),
        (Samples::U8(v), Colors::GreyAlpha) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageLumaA8),
        (Samples::U8(v), Colors::Rgba) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageRgba8),
        (Samples::U8(v), _) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageRgb8),
        (Samples::U16(v), Colors::Grey) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageLuma16),
        (Samples::U16(v), Colors::GreyAlpha) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageLumaA16),
        (Samples::U16(v), Colors::Rgba) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageRgba16),
        (Samples::U16(v), _) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageRgb16),
        (Samples::F32(v), Colors::Rgba) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageRgba32F),
        (Samples::F32(v), _) => ImageBuffer::from_raw(width, height, v).map(DynamicImage::ImageRgb32F),
    };
    let picture = picture.ok_or_else(|| broken(path, "has too few samples"))?;
    Ok(Some(Found { picture, orientation, notes }))
}

fn directory<R: Read + Seek>(decoder: &mut Decoder<R>) -> TiffResult<Directory> {
    let (width, height) = decoder.dimensions()?;
    let number = |decoder: &mut Decoder<R>, tag, default| {
        decoder
            .find_tag_unsigned_vec(tag)
            .map(|found| found.and_then(|v: Vec<u16>| v.first().copied()).unwrap_or(default))
    };
    Ok(Directory {
        width,
        height,
        photometric: number(decoder, Tag::PhotometricInterpretation, 1)?,
        stored: number(decoder, Tag::SamplesPerPixel, 1)?,
        bits: number(decoder, Tag::BitsPerSample, 1)?,
        format: number(decoder, Tag::SampleFormat, 1)?,
        compression: number(decoder, Tag::Compression, 1)?,
        fill_order: number(decoder, Tag::FillOrder, 1)?,
        extra: decoder.find_tag_unsigned_vec(Tag::ExtraSamples)?.and_then(|v: Vec<u16>| v.first().copied()),
    })
}

/// Returns the meaning of the samples; `None` if `image` reads them.
///
/// # Errors
/// What the picture is, if it is not read.
fn kind(directory: &Directory) -> Result<Option<Colors>, String> {
    let Directory { photometric, stored, bits, format, extra, .. } = *directory;
    let has_alpha = matches!(extra, Some(1 | 2));
    let is_float = format == 3;
    if matches!(format, 2 | 5 | 6) {
        return Err(format!("has signed or complex samples of {bits} bits"));
    }
    // 2 to 4 are codes for fax, which are read from either end.
    if directory.fill_order == 2 && !matches!(directory.compression, 2..=4) {
        return Err("stores the bits of its bytes in reverse order".into());
    }
    if directory.compression == 7 && stored == 2 {
        return Err("has grey with alpha in JPEG".into());
    }
    let colors = match (photometric, stored) {
        (0 | 1, 1) => Colors::Grey,
        (0 | 1, 2) if has_alpha => Colors::GreyAlpha,
        (2, 3) => Colors::Rgb,
        (2, 4..) => Colors::Rgba,
        (3, 1) => Colors::Palette,
        (5, 4) if !is_float && matches!(bits, 8 | 16) => return Ok(None),
        (6, 3) if bits == 8 && !is_float => Colors::YCbCr,
        (0 | 1, _) => return Err(format!("has {stored} samples per pixel, and no colours")),
        (5, _) => return Err(format!("has {stored} samples of CMYK and {bits} bits per pixel")),
        (6, _) => return Err(format!("has {stored} samples of YCbCr and {bits} bits per pixel")),
        (8..=10, _) => return Err("has colours in the space L*a*b*".into()),
        (32844 | 32845, _) => return Err("has colours in the space LogLuv".into()),
        (32803, _) => return Err("holds the raw data of a camera".into()),
        _ => return Err(format!("has colours of the kind {photometric} in {stored} samples per pixel")),
    };
    Ok(match (colors, bits, is_float) {
        (Colors::Grey, 1 | 8 | 16, false) => None,
        (Colors::Rgb | Colors::Rgba, 8 | 16, false) | (Colors::Rgb | Colors::Rgba, 32, true) => None,
        (Colors::YCbCr, 8, false) => Some(colors),
        (Colors::Grey | Colors::Palette, 1 | 2 | 4 | 8 | 16, false) => Some(colors),
        (Colors::GreyAlpha, 8 | 16, false) => Some(colors),
        (Colors::Grey | Colors::GreyAlpha | Colors::Rgb | Colors::Rgba, 32 | 64, false) => Some(colors),
        (Colors::Grey | Colors::GreyAlpha | Colors::Rgb | Colors::Rgba, 16 | 32 | 64, true) => Some(colors),
        _ => return Err(format!("has {} of {bits} bits", if is_float { "floating-point samples" } else { "samples" })),
    })
}

/// Returns the bytes that make the kind of colours, in the first directory of the file in `input`, grey.
fn photometric(input: &mut (impl BufRead + Seek)) -> std::io::Result<Vec<(u64, u8)>> {
    input.rewind()?;
    let mut head = [0; 16];
    input.read_exact(&mut head[..8])?;
    let is_little = head[0] == b'I';
    let number = |bytes: &[u8]| {
        let add = |sum: u64, &byte: &u8| sum << 8 | u64::from(byte);
        if is_little { bytes.iter().rev().fold(0, add) } else { bytes.iter().fold(0, add) }
    };
    let is_big = number(&head[2..4]) == 43;
    if is_big {
        input.read_exact(&mut head[8..])?;
    }
    let first = if is_big { number(&head[8..]) } else { number(&head[4..8]) };
    input.seek(SeekFrom::Start(first))?;
    // Bytes of the number of entries, of an entry, and of an entry before its value.
    let [count, length, before] = if is_big { [8, 20, 12] } else { [2, 12, 8] };
    let mut bytes = [0; 20];
    input.read_exact(&mut bytes[..count])?;
    for k in 0..number(&bytes[..count]).min(u16::MAX.into()) {
        input.read_exact(&mut bytes[..length])?;
        if number(&bytes[..2]) == 262 {
            let value = first + (count as u64) + k * length as u64 + before as u64;
            return Ok(vec![(if is_little { value } else { value + 1 }, 1)]);
        }
    }
    Ok(Vec::new())
}

/// Returns the samples with the first `count` of each pixel together.
fn samples(
    path: &Path,
    result: DecodingResult,
    layout: &BufferLayoutPreference,
    directory: &Directory,
    count: usize,
) -> Result<Samples, Failure> {
    let pixels = directory.width as usize * directory.height as usize;
    let stride = if layout.planes > 1 { layout.plane_stride.map_or(0, |stride| stride.get()) } else { 0 };
    Ok(match result {
        DecodingResult::U8(v) if directory.bits < 8 => Samples::U8(unpacked(&v, directory)),
        DecodingResult::U8(v) => Samples::U8(together(path, v, stride, pixels, count)?),
        DecodingResult::U16(v) => Samples::U16(together(path, v, stride / 2, pixels, count)?),
        DecodingResult::U32(v) => {
            let words: Vec<u16> =
                together(path, v, stride / 4, pixels, count)?.iter().map(|v| (v >> 16) as u16).collect();
            Samples::U16(of_range(path, words)?)
        }
        DecodingResult::U64(v) => {
            let words: Vec<u16> =
                together(path, v, stride / 8, pixels, count)?.iter().map(|v| (v >> 48) as u16).collect();
            Samples::U16(of_range(path, words)?)
        }
        DecodingResult::F16(v) => {
            Samples::F32(together(path, v.iter().map(|v| v.to_f32()).collect(), stride / 2, pixels, count)?)
        }
        DecodingResult::F32(v) => Samples::F32(together(path, v, stride / 4, pixels, count)?),
        DecodingResult::F64(v) => {
            Samples::F32(together(path, v.iter().map(|&v| v as f32).collect(), stride / 8, pixels, count)?)
        }
        _ => return Err(unsupported(path, "has signed samples")),
    })
}

/// Refuses the high words of large integers if they use a small part of the range.
fn of_range(path: &Path, words: Vec<u16>) -> Result<Vec<u16>, Failure> {
    if words.iter().all(|&word| word < 256) {
        return Err(unsupported(path, "has integers of 32 or 64 bits that use a small part of their range"));
    }
    Ok(words)
}

/// Puts the first `count` samples of each pixel together. Planes start every `stride` samples; 0 if there are none.
fn together<T: Copy>(path: &Path, all: Vec<T>, stride: usize, pixels: usize, count: usize) -> Result<Vec<T>, Failure> {
    let too_few = || broken(path, "has too few samples");
    if stride == 0 {
        let stored = all.len() / pixels.max(1);
        if stored == count {
            return Ok(all);
        }
        let kept = all.chunks_exact(stored.max(1)).flat_map(|pixel| pixel.iter().take(count)).copied();
        let kept: Vec<T> = kept.collect();
        return if stored > count { Ok(kept) } else { Err(too_few()) };
    }
    let planes: Vec<&[T]> = (0..count).map_while(|k| all.get(k * stride..k * stride + pixels)).collect();
    if planes.len() < count {
        return Err(too_few());
    }
    Ok((0..pixels).flat_map(|i| planes.iter().map(move |plane| plane[i])).collect())
}

/// Returns samples of fewer than 8 bits, one of each pixel: numbers of colours as they are, and grey stretched to 8
/// bits.
fn unpacked(packed: &[u8], directory: &Directory) -> Vec<u8> {
    let bits = usize::from(directory.bits);
    let width = directory.width as usize;
    let max = (1u16 << bits) as u8 - 1;
    let factor = if directory.photometric == 3 { 1 } else { 255 / max };
    let rows = packed.chunks_exact((width * bits).div_ceil(8));
    // The first pixel of a byte is in its high bits.
    let sample = |row: &[u8], x: usize| row[x * bits / 8] >> (8 - bits - x * bits % 8) & max;
    rows.flat_map(|row| (0..width).map(move |x| sample(row, x) * factor)).collect()
}

/// Returns the colours of a palette: all values for red, then those for green and blue.
fn looked_up(path: &Path, samples: Samples, map: &[u16]) -> Result<Samples, Failure> {
    let all = map.len() / 3;
    let indices: Vec<usize> = match samples {
        Samples::U8(v) => v.into_iter().map(usize::from).collect(),
        Samples::U16(v) => v.into_iter().map(usize::from).collect(),
        Samples::F32(_) => return Err(unsupported(path, "has a palette of floating-point numbers")),
    };
    if indices.iter().any(|&index| index >= all) {
        return Err(broken(path, "uses colours that its palette lacks"));
    }
    let colors = indices.iter().flat_map(|&index| [index, all + index, 2 * all + index]).map(|at| map[at]);
    // Many writers store values of 8 bits, as they are or multiplied by 256 or 257.
    Ok(if map.iter().all(|&value| value < 256) {
        Samples::U8(colors.map(|value| value as u8).collect())
    } else if map.iter().all(|value| value % 257 == 0) || map.iter().all(|value| value % 256 == 0) {
        Samples::U8(colors.map(|value| (value >> 8) as u8).collect())
    } else {
        Samples::U16(colors.collect())
    })
}

/// Converts YCbCr of the full range to RGB. `luma` are the shares of red, green and blue; those of ITU-R BT.601 by
/// default.
fn rgb(mut samples: Vec<u8>, luma: Option<&[f32]>) -> Vec<u8> {
    let &[red, green, blue] = luma.and_then(|luma| luma.first_chunk()).unwrap_or(&[0.299, 0.587, 0.114]);
    for pixel in samples.chunks_exact_mut(3) {
        let [y, cb, cr] = [f32::from(pixel[0]), f32::from(pixel[1]) - 128.0, f32::from(pixel[2]) - 128.0];
        let (r, b) = (y + cr * (2.0 - 2.0 * red), y + cb * (2.0 - 2.0 * blue));
        let g = (y - red * r - blue * b) / green;
        for (sample, value) in pixel.iter_mut().zip([r, g, b]) {
            *sample = value.round().clamp(0.0, 255.0) as u8;
        }
    }
    samples
}

fn failure(path: &Path, error: TiffError) -> Failure {
    let kind = match &error {
        TiffError::UnsupportedError(what) => return unsupported(path, &format!("is not supported ({what})")),
        TiffError::IoError(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => Kind::Io,
        TiffError::LimitsExceeded => {
            return Failure { kind: Kind::Limit, message: limits::beyond_memory(path) };
        }
        _ => Kind::Format,
    };
    Failure { kind, message: format!("{}: {error}", Failure::input(path)) }
}

fn broken(path: &Path, problem: &str) -> Failure {
    Failure { kind: Kind::Format, message: format!("{}: {problem}", Failure::input(path)) }
}

fn unsupported(path: &Path, what: &str) -> Failure {
    let path = Failure::input(path);
    let message = format!(
        "{path}: this TIFF {what}: convert it first, for example with ImageMagick's `convert IN.tif -depth 16 OUT.png` or \
         `gdal_translate -scale -ot UInt16 IN.tif OUT.png`"
    );
    Failure { kind: Kind::Unsupported, message }
}
