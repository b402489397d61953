//! Reads JPEG XL: parses the boxes of the container, and decodes with `jxl-oxide` within the limits of the other
//! formats.

use std::error::Error as StdError;
use std::io::{self, BufRead, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

use brotli_decompressor::Decompressor;
use image::metadata::Orientation;
use jxl_oxide::color::{ColourEncoding, ColourSpace, Primaries, TransferFunction, WhitePoint};
use jxl_oxide::{AllocTracker, InitializeResult, JxlImage, JxlThreadPool, Render};
use ssplat::unstable::colour::{self, Stated};
use ssplat::unstable::input::MAX_ALLOC;
use ssplat::{Channels, Depth, Pixels, Samples};

use crate::failure::{Failure, Kind};
use crate::input::Input;
use crate::source::{self, Source};

/// Largest EXIF block in bytes, decompressed. A compressed block may expand without bound.
const MAX_EXIF: u64 = 16 << 20;

/// Bytes of the codestream that are read to find the size of the picture; a profile may precede the first frame.
const MAX_HEADER: u64 = 1 << 20;

/// Largest product of pixels and frames up to the first frame that is shown, because frames of a few bytes each may be
/// blended.
const MAX_WORK: u64 = 1 << 32;

/// Share by which a gamma may differ from 2.2: that for `gAMA` of PNG.
const SAME_GAMMA: f64 = 0.05;

/// Bytes per pixel and channel while a picture is decoded: two copies of the samples as floats, for filters.
const BYTES_PER_SAMPLE: u64 = 8;

/// Decodes the picture in `input`, which came from `path`. The pixels are upright, because JPEG XL has an orientation
/// of its own, which decoders apply.
pub fn read(path: &Path, input: &mut Input) -> Result<Source, Failure> {
    let length = input.length().map_err(|e| Failure::io(path, &e))?;
    // There are two copies of the codestream: this one and the decoder's.
    let room = length.checked_mul(2).and_then(|bytes| MAX_ALLOC.checked_sub(bytes)).ok_or_else(|| too_large(path))?;
    let boxes = Boxes::read(input, u64::MAX).map_err(|e| match e.kind() {
        ErrorKind::InvalidData => broken(path, "has a box with an invalid length"),
        _ => Failure::io(path, &e),
    })?;
    let Boxes { codestream, exif, has_xmp } = boxes;
    let failed = |e: Box<dyn StdError + Send + Sync>| failure(path, &*e);
    let image = start(&codestream, AllocTracker::with_limit(usize::try_from(room).unwrap_or(usize::MAX)));
    let mut image = image.map_err(failed)?.ok_or_else(|| broken(path, "ends before its picture begins"))?;
    drop(codestream);
    let (area, channels) = (u64::from(image.width()) * u64::from(image.height()), all_channels(&image));
    if area.checked_mul(channels * BYTES_PER_SAMPLE).is_none_or(|bytes| bytes > room) {
        return Err(too_large(path));
    }
    let mut notes = Vec::new();
    if image.image_header().metadata.animation.is_some() {
        notes.push("only the first of its frames or pages is used".into());
    }
    if has_xmp {
        notes.push("its XMP block is left out".into());
    }
    if image.pixel_format().has_black() {
        image.request_color_encoding(jxl_oxide::EnumColourEncoding::srgb(jxl_oxide::RenderingIntent::Relative));
    }
    let frames = image.frame_by_keyframe(0).map_or(image.num_loaded_frames(), |frame| frame.index() + 1);
    if area.saturating_mul(frames as u64) > MAX_WORK {
        let message = format!("{}: blends {frames} frames of {area} pixels", Failure::input(path));
        return Err(Failure { kind: Kind::Limit, message });
    }
    let is_cut_off = image.num_loaded_keyframes() == 0;
    let render = if is_cut_off { image.render_loading_frame() } else { image.render_frame(0) };
    let render = match render {
        Err(_) if is_cut_off => return Err(broken(path, "ends before its picture does")),
        render => render.map_err(failed)?,
    };
    let pixels = pixels(path, &image, &render)?;
    drop(render);
    let stated = colours(&image, pixels.channels());
    notes.extend(stated.note.map(String::from));
    let mut icc = match stated.note {
        Some(_) => None,
        None if has_usual_gamma(&image) => None,
        None => stated.or(Some(image.rendered_icc())),
    };
    source::keep_fitting(&mut icc, pixels.channels(), &mut notes);
    let mut exif = exif;
    source::forget_orientation(&mut exif);
    Ok(Source { pixels, icc, exif, orientation: Orientation::NoTransforms, is_cut_off, notes })
}

/// Returns width and height of the picture in `input`, or `None` if they are unknown. Moves the position of the input.
pub fn size(input: &mut Input) -> Option<[u32; 2]> {
    let boxes = Boxes::read(input, MAX_HEADER).ok()?;
    let image = start(&boxes.codestream, AllocTracker::with_limit(MAX_HEADER as usize)).ok()??;
    Some([image.width(), image.height()])
}

/// Parses the header, and passes all frames to the decoder. Returns `None` if the header is truncated.
fn start(codestream: &[u8], memory: AllocTracker) -> jxl_oxide::Result<Option<JxlImage>> {
    // Without other threads, because the panic hook would print their panics.
    let mut builder = JxlImage::builder().pool(JxlThreadPool::none()).alloc_tracker(memory).build_uninit();
    builder.feed_bytes(codestream)?;
    match builder.try_init()? {
        InitializeResult::Initialized(image) => Ok(Some(image)),
        InitializeResult::NeedMoreData(_) => Ok(None),
    }
}

/// Returns the number of channels that the decoder stores.
fn all_channels(image: &JxlImage) -> u64 {
    // Lossy grey is decoded as three channels.
    3 + image.image_header().metadata.ec_info.len() as u64
}

/// Returns the samples of a rendered frame, with straight alpha.
fn pixels(path: &Path, image: &JxlImage, render: &Render) -> Result<Pixels, Failure> {
    let format = image.pixel_format();
    let channels = match (format.is_grayscale(), format.has_alpha()) {
        (true, false) => Channels::Grey,
        (true, true) => Channels::GreyAlpha,
        (false, false) => Channels::Rgb,
        (false, true) => Channels::Rgba,
    };
    let mut stream = render.stream();
    if stream.channels() as usize != channels.count() {
        let message = format!("{}: has {} channels of colour and alpha", Failure::input(path), stream.channels());
        return Err(Failure { kind: Kind::Unsupported, message });
    }
    let (width, height) = (stream.width(), stream.height());
    let count = width as usize * height as usize * channels.count();
    let metadata = &image.image_header().metadata;
    let is_premultiplied = metadata.ec_info.iter().find_map(|info| info.alpha_associated()).unwrap_or(false);
    let samples = if metadata.bit_depth.bits_per_sample() <= 8 {
        let mut samples = zeros(path, count)?;
        stream.write_to_buffer::<u8>(&mut samples);
        if is_premultiplied {
            divide(&mut samples, channels, Depth::Eight);
        }
        Samples::U8(samples)
    } else {
        let mut samples = zeros(path, count)?;
        stream.write_to_buffer::<u16>(&mut samples);
        if is_premultiplied {
            divide(&mut samples, channels, Depth::Sixteen);
        }
        Samples::U16(samples)
    };
    Pixels::new(width, height, channels, samples).map_err(|e| Failure::library(path, &e))
}

fn zeros<T: Clone + Default>(path: &Path, count: usize) -> Result<Vec<T>, Failure> {
    let mut zeros = Vec::new();
    zeros.try_reserve_exact(count).map_err(|_| too_large(path))?;
    zeros.resize(count, T::default());
    Ok(zeros)
}

/// Converts premultiplied alpha to straight alpha.
fn divide<T: Copy + Into<u32> + TryFrom<u32>>(samples: &mut [T], channels: Channels, depth: Depth) {
    let max = u32::from(depth.max());
    for pixel in samples.chunks_exact_mut(channels.count()) {
        let Some((&mut alpha, colors)) = pixel.split_last_mut() else { continue };
        let alpha: u32 = alpha.into();
        if alpha == 0 || alpha == max {
            continue;
        }
        for color in colors {
            let divided = ((*color).into() * max + alpha / 2) / alpha;
            *color = T::try_from(divided.min(max)).unwrap_or(*color);
        }
    }
}

/// Returns the colour space of the header, if code points can express it.
fn colours(image: &JxlImage, channels: Channels) -> Stated {
    image.rendered_cicp().map_or_else(Stated::default, |cicp| colour::of_cicp(cicp, channels.count() < 3))
}

/// Whether the header states the usual gamma with the white and the primaries of sRGB, as `gAMA` of PNG files becomes
/// it. It stands for sRGB, as it does in PNG.
fn has_usual_gamma(image: &JxlImage) -> bool {
    let ColourEncoding::Enum(encoding) = &image.image_header().metadata.colour_encoding else { return false };
    let TransferFunction::Gamma { g, .. } = encoding.tf else { return false };
    let is_srgb = encoding.colour_space == ColourSpace::Grey || matches!(encoding.primaries, Primaries::Srgb);
    let exponent = f64::from(g) / 1e7;
    is_srgb
        && matches!(encoding.white_point, WhitePoint::D65)
        && [1.0 / 2.2, 2.2].iter().any(|usual| (exponent / usual - 1.0).abs() < SAME_GAMMA)
}

fn failure(path: &Path, error: &(dyn StdError + 'static)) -> Failure {
    let mut cause = Some(error);
    while let Some(e) = cause {
        // The type of the error is in a crate that is not a dependency of this one.
        if e.to_string().starts_with("failed to allocate") {
            return too_large(path);
        }
        cause = e.source();
    }
    Failure { kind: Kind::Format, message: format!("{}: {error}", Failure::input(path)) }
}

fn broken(path: &Path, problem: &str) -> Failure {
    Failure { kind: Kind::Format, message: format!("{}: {problem}", Failure::input(path)) }
}

fn too_large(path: &Path) -> Failure {
    Failure { kind: Kind::Limit, message: source::beyond_memory(path) }
}

/// The parts of a file that are used: the codestream, joined, and metadata.
struct Boxes {
    codestream: Vec<u8>,
    exif: Option<Vec<u8>>,
    has_xmp: bool,
}

impl Boxes {
    /// Reads a container or a bare codestream, with at most `most` bytes of the codestream. A truncated file gives the
    /// parts that are present.
    fn read(input: &mut Input, most: u64) -> io::Result<Boxes> {
        let mut boxes = Boxes { codestream: Vec::new(), exif: None, has_xmp: false };
        if input.fill_buf()?.starts_with(&[0xFF]) {
            input.take(most).read_to_end(&mut boxes.codestream)?;
            return Ok(boxes);
        }
        match boxes.read_container(input, most) {
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => Ok(boxes),
            outcome => outcome.map(|()| boxes),
        }
    }

    fn read_container(&mut self, input: &mut Input, most: u64) -> io::Result<()> {
        while (self.codestream.len() as u64) < most {
            let length = u64::from(u32::from_be_bytes(bytes(input)?));
            let name: [u8; 4] = bytes(input)?;
            // ISO/IEC 14496-12: 1 means that a length of eight bytes follows, 0 the rest of the file.
            let (length, header) = if length == 1 { (u64::from_be_bytes(bytes(input)?), 16) } else { (length, 8) };
            let body = match length {
                0 => u64::MAX,
                length => length.checked_sub(header).ok_or(ErrorKind::InvalidData)?,
            };
            let start = input.stream_position()?;
            self.take(input, name, body, most)?;
            let end = start.checked_add(body).filter(|&end| end <= i64::MAX as u64);
            input.seek(SeekFrom::Start(end.ok_or(ErrorKind::UnexpectedEof)?))?;
        }
        Ok(())
    }

    /// Reads the useful parts of a box.
    fn take(&mut self, input: &mut Input, name: [u8; 4], body: u64, most: u64) -> io::Result<()> {
        let room = most - self.codestream.len() as u64;
        match &name {
            b"jxlc" => {
                input.take(body.min(room)).read_to_end(&mut self.codestream)?;
            }
            b"jxlp" => {
                // The index of the part.
                let _: [u8; 4] = bytes(input)?;
                input.take(body.saturating_sub(4).min(room)).read_to_end(&mut self.codestream)?;
            }
            b"Exif" => self.exif = self.exif.take().or(exif_in(input.take(body))?),
            b"xml " => self.has_xmp = true,
            b"brob" => match &bytes(input)? {
                b"xml " => self.has_xmp = true,
                b"Exif" => {
                    let packed = Decompressor::new(input.take(body.saturating_sub(4)), 4096);
                    // A block that cannot be decompressed does not make the picture invalid.
                    self.exif = self.exif.take().or(exif_in(packed).ok().flatten());
                }
                _ => {}
            },
            _ => {}
        }
        Ok(())
    }
}

/// Returns the EXIF block in the body of a box, which starts with the offset of the block; `None` if it is too long or
/// invalid.
fn exif_in(body: impl Read) -> io::Result<Option<Vec<u8>>> {
    let mut all = Vec::new();
    body.take(MAX_EXIF + 1).read_to_end(&mut all)?;
    let Some((start, block)) = all.split_first_chunk() else { return Ok(None) };
    let block = block.get(u32::from_be_bytes(*start) as usize..).filter(|block| !block.is_empty());
    Ok(block.filter(|_| all.len() as u64 <= MAX_EXIF).map(<[u8]>::to_vec))
}

fn bytes<const N: usize>(reader: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    reader.read_exact(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn premultiplied_colours_become_straight() {
        let mut pixels = [100, 50, 0, 128, 9, 9, 9, 0, 7, 8, 9, 255, 200, 0, 0, 100u8];
        divide(&mut pixels, Channels::Rgba, Depth::Eight);
        assert_eq!(pixels, [199, 100, 0, 128, 9, 9, 9, 0, 7, 8, 9, 255, 255, 0, 0, 100]);
        let mut pixels = [1000, 2000u16];
        divide(&mut pixels, Channels::GreyAlpha, Depth::Sixteen);
        assert_eq!(pixels, [32768, 2000]);
    }
}
