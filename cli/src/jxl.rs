//! Reads JPEG XL: parses the boxes of the container, and decodes with `jxl-oxide` within the limits of the other
//! formats.

use std::error::Error as StdError;
use std::io::{self, BufRead, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

use brotli_decompressor::Decompressor;
use image::metadata::Orientation;
use jxl_bitstream::Bitstream;
use jxl_color::icc::read_icc;
use jxl_oxide::color::{ColourEncoding, ColourSpace, Customxy, Primaries, TransferFunction, WhitePoint};
use jxl_oxide::{
    AllocTracker, EnumColourEncoding, ImageHeader, InitializeResult, JxlImage, JxlThreadPool, Render, RenderingIntent,
};
use jxl_oxide_common::Bundle;
use ssplat::unstable::colour::{self, CodePoints, MAX_PROFILE_BYTES, Profiles, Transfer};
use ssplat::unstable::input::MAX_ALLOC;
use ssplat::{Channels, Depth, Pixels, Samples};

use crate::failure::{Failure, Kind};
use crate::input::Input;
use crate::limits;
use crate::source::{self, Reading, Source};

/// Largest EXIF block in bytes, decompressed. A compressed block may expand without bound.
const MAX_EXIF: u64 = 16 << 20;

/// Bytes of the codestream that are read to find the size of the picture; a profile may precede the first frame.
const MAX_HEADER: u64 = 1 << 20;

/// Largest product of pixels and frames up to the first frame that is shown, because frames of a few bytes each may be
/// blended.
const MAX_WORK: u64 = 1 << 32;

/// Share by which a gamma may differ from 2.2: that for `gAMA` of PNG.
const SAME_GAMMA: f64 = 0.05;

/// Bytes per pixel and channel while a picture is decoded: two copies of the samples as floats, for filters, and one
/// more where the decoder does not convert them to code values.
const BYTES_PER_SAMPLE: u64 = 12;

/// Decodes the picture in `input`, which came from `path`. The pixels are upright, because JPEG XL has an orientation
/// of its own, which decoders apply.
pub fn read(path: &Path, input: &mut Input, reading: &Reading) -> Result<Source, Failure> {
    let length = input.length().map_err(|e| Failure::io(path, &e))?;
    // There are two copies of the codestream: this one and the decoder's.
    let room = length.checked_mul(2).and_then(|bytes| MAX_ALLOC.checked_sub(bytes)).ok_or_else(|| too_large(path))?;
    let boxes = Boxes::read(input, u64::MAX).map_err(|e| match e.kind() {
        ErrorKind::InvalidData => broken(path, "has a box with an invalid length"),
        _ => Failure::io(path, &e),
    })?;
    let Boxes { codestream, exif, has_xmp } = boxes;
    let failed = |e: Box<dyn StdError + Send + Sync>| failure(path, &*e);
    check_profile(path, &codestream)?;
    let image = start(&codestream, AllocTracker::with_limit(usize::try_from(room).unwrap_or(usize::MAX)));
    let mut image = image.map_err(failed)?.ok_or_else(|| broken(path, "ends before its picture begins"))?;
    drop(codestream);
    let (area, channels) = (u64::from(image.width()) * u64::from(image.height()), all_channels(&image));
    if image.width().max(image.height()) > limits::MAX_SIDE {
        return Err(limits::too_long(path, [image.width(), image.height()]));
    }
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
    let is_srgb = image.pixel_format().has_black();
    if is_srgb {
        image.request_color_encoding(srgb());
    }
    // The profile or the code points of the pixels.
    let colors = colors_of(&image, is_srgb);
    let from_pq = without_tone_mapping(&mut image, is_srgb);
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
    let pixels = pixels(path, &image, &render, from_pq)?;
    drop(render);
    let (mut icc, cicp) = match &colors {
        _ if reading.profiles == Profiles::Ignore => (None, None),
        Colors::Icc(icc) => (Some(icc.clone()), None),
        Colors::Enum(encoding) => {
            let CodePoints { icc, cicp, note } = stored_colors(encoding);
            notes.extend(note.map(String::from));
            (icc, cicp)
        }
    };
    source::keep_fitting(&mut icc, pixels.channels(), &mut notes);
    let mut exif = exif;
    source::forget_orientation(&mut exif);
    Ok(Source { pixels, cicp, icc, exif, orientation: Orientation::NoTransforms, is_cut_off, notes })
}

/// Returns width and height of the picture in `input`, or `None` if they are unknown. Moves the position of the input.
pub fn size(input: &mut Input) -> Option<[u32; 2]> {
    let boxes = Boxes::read(input, MAX_HEADER).ok()?;
    check_profile(Path::new(""), &boxes.codestream).ok()?;
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
fn pixels(path: &Path, image: &JxlImage, render: &Render, from_pq: Option<FromPq>) -> Result<Pixels, Failure> {
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
    let is_deep = metadata.bit_depth.bits_per_sample() > 8;
    let mut floats: Vec<f32> = Vec::new();
    if let Some(from_pq) = from_pq {
        floats = zeros(path, count)?;
        stream.write_to_buffer::<f32>(&mut floats);
        let colors = channels.count() - usize::from(channels.alpha().is_some());
        for pixel in floats.chunks_exact_mut(channels.count()) {
            pixel[..colors].iter_mut().for_each(|sample| *sample = from_pq.convert(*sample));
        }
    }
    let code = |sample: f32, max: f32| sample.clamp(0.0, 1.0) * max + 0.5;
    let samples = if !is_deep {
        let mut samples = zeros(path, count)?;
        match from_pq {
            Some(_) => samples.iter_mut().zip(&floats).for_each(|(out, v)| *out = code(*v, 255.0) as u8),
            None => drop(stream.write_to_buffer::<u8>(&mut samples)),
        }
        if is_premultiplied {
            divide(&mut samples, channels, Depth::Eight);
        }
        Samples::U8(samples)
    } else {
        let mut samples = zeros(path, count)?;
        match from_pq {
            Some(_) => samples.iter_mut().zip(&floats).for_each(|(out, v)| *out = code(*v, 65535.0) as u16),
            None => drop(stream.write_to_buffer::<u16>(&mut samples)),
        }
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

/// Refuses a codestream whose profile is longer than [`MAX_PROFILE_BYTES`], before it is decompressed. A codestream
/// that cannot be parsed is left to the decoder.
fn check_profile(path: &Path, codestream: &[u8]) -> Result<(), Failure> {
    let mut bits = Bitstream::new(codestream);
    let Ok(header) = ImageHeader::parse(&mut bits, ()) else { return Ok(()) };
    if !header.metadata.colour_encoding.want_icc() {
        return Ok(());
    }
    let refused = |bytes: u64| {
        let message = format!(
            "{}: its ICC profile has {bytes} bytes, more than the {MAX_PROFILE_BYTES} that are read",
            Failure::input(path)
        );
        Err(Failure { kind: Kind::Limit, message })
    };
    // The length of the coded profile; its first number is the length of the profile itself.
    match bits.clone().read_u64() {
        Ok(bytes) if bytes > MAX_PROFILE_BYTES => return refused(bytes),
        Ok(_) => {}
        Err(_) => return Ok(()),
    }
    let Ok(coded) = read_icc(&mut bits) else { return Ok(()) };
    let number = coded.iter().take(9).enumerate().try_fold(0u64, |sum, (k, &byte)| {
        let sum = sum | u64::from(byte & 0x7F) << (7 * k);
        if byte & 0x80 == 0 { Err(sum) } else { Ok(sum) }
    });
    let bytes = number.unwrap_or_else(|sum| sum);
    if bytes > MAX_PROFILE_BYTES { refused(bytes) } else { Ok(()) }
}

/// The colours of the pixels.
enum Colors {
    Icc(Vec<u8>),
    Enum(EnumColourEncoding),
}

/// Returns the colours of the pixels as they are rendered.
fn colors_of(image: &JxlImage, is_srgb: bool) -> Colors {
    match &image.image_header().metadata.colour_encoding {
        _ if is_srgb => Colors::Enum(srgb()),
        ColourEncoding::Enum(encoding) => Colors::Enum(encoding.clone()),
        ColourEncoding::IccProfile(_) => Colors::Icc(image.rendered_icc()),
    }
}

fn srgb() -> EnumColourEncoding {
    EnumColourEncoding::srgb(RenderingIntent::Relative)
}

/// Returns the profile of a colour space, or code points if no profile can express it. A space with PQ or HLG that has no
/// code points is kept as sRGB, with a note.
fn stored_colors(encoding: &EnumColourEncoding) -> CodePoints {
    let is_grey = encoding.colour_space == ColourSpace::Grey;
    // ITU-T H.273: PQ and HLG.
    let code_points = |transfer| {
        let primaries = match (&encoding.white_point, &encoding.primaries) {
            _ if is_grey => Some(1),
            (WhitePoint::D65, Primaries::Srgb) => Some(1),
            (WhitePoint::D65, Primaries::Bt2100) => Some(9),
            (WhitePoint::D65, Primaries::P3) => Some(12),
            (WhitePoint::Dci, Primaries::P3) => Some(11),
            _ => None,
        };
        let note = "its colours use PQ or HLG with primaries that have no code points; they are kept unchanged and will look pale";
        match primaries {
            Some(primaries) => colour::of_cicp([primaries, transfer, 0, 1], is_grey),
            None => CodePoints { note: Some(note), ..CodePoints::default() },
        }
    };
    let transfer = match encoding.tf {
        TransferFunction::Pq => return code_points(16),
        TransferFunction::Hlg => return code_points(18),
        TransferFunction::Bt709 => Transfer::Bt709,
        TransferFunction::Linear => Transfer::Gamma(1.0),
        TransferFunction::Dci => Transfer::Gamma(2.6),
        TransferFunction::Gamma { .. } if has_usual_gamma(encoding) => return CodePoints::default(),
        TransferFunction::Gamma { .. } => Transfer::Gamma(exponent(encoding.tf)),
        TransferFunction::Srgb | TransferFunction::Unknown => Transfer::Srgb,
    };
    let xy = |point: &Customxy| point.as_float().map(f64::from);
    let white = match &encoding.white_point {
        WhitePoint::D65 => [0.3127, 0.329],
        WhitePoint::E => [1.0 / 3.0; 2],
        WhitePoint::Dci => [0.314, 0.351],
        WhitePoint::Custom(white) => xy(white),
    };
    let primaries = match &encoding.primaries {
        Primaries::Srgb => [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06]],
        Primaries::Bt2100 => [[0.708, 0.292], [0.17, 0.797], [0.131, 0.046]],
        Primaries::P3 => [[0.68, 0.32], [0.265, 0.69], [0.15, 0.06]],
        Primaries::Custom { red, green, blue } => [red, green, blue].map(xy),
    };
    let [[rx, ry], [gx, gy], [bx, by]] = primaries;
    let chromaticities = [white[0], white[1], rx, ry, gx, gy, bx, by];
    CodePoints { icc: colour::of_chromaticities(chromaticities, transfer, is_grey), ..CodePoints::default() }
}

/// Returns the exponent of a gamma that converts encoded values to light; 1 for other functions.
fn exponent(transfer: TransferFunction) -> f64 {
    match transfer {
        TransferFunction::Gamma { g, inverted: false } => f64::from(g) / 1e7,
        TransferFunction::Gamma { g, inverted: true } => 1e7 / f64::from(g.max(1)),
        _ => 1.0,
    }
}

/// Whether the encoding is the usual gamma with the white and the primaries of sRGB, as `gAMA` of PNG files becomes it.
/// It stands for sRGB, as it does in PNG.
fn has_usual_gamma(encoding: &EnumColourEncoding) -> bool {
    let is_srgb = encoding.colour_space == ColourSpace::Grey || matches!(encoding.primaries, Primaries::Srgb);
    is_srgb && matches!(encoding.white_point, WhitePoint::D65) && (exponent(encoding.tf) / 2.2 - 1.0).abs() < SAME_GAMMA
}

/// Converts samples in PQ to those of the encoding in the header.
#[derive(Debug, Clone, Copy)]
struct FromPq {
    /// Light of code value 1 in the header's encoding, in the unit of PQ, which is 10 000 nits.
    white: f32,
    to: TransferFunction,
}

impl FromPq {
    fn convert(self, sample: f32) -> f32 {
        // SMPTE ST 2084.
        const M1: f32 = 2610.0 / 16384.0;
        const M2: f32 = 2523.0 / 4096.0 * 128.0;
        const C1: f32 = 3424.0 / 4096.0;
        const C2: f32 = 2413.0 / 4096.0 * 32.0;
        const C3: f32 = 2392.0 / 4096.0 * 32.0;
        let power = sample.clamp(0.0, 1.0).powf(1.0 / M2);
        let light = ((power - C1).max(0.0) / (C2 - C3 * power)).powf(1.0 / M1);
        let light = (light / self.white).clamp(0.0, 1.0);
        match self.to {
            TransferFunction::Srgb if light <= 0.003_130_8 => 12.92 * light,
            TransferFunction::Srgb => 1.055 * light.powf(1.0 / 2.4) - 0.055,
            TransferFunction::Bt709 if light < 0.018 => 4.5 * light,
            TransferFunction::Bt709 => 1.099 * light.powf(0.45) - 0.099,
            TransferFunction::Dci => light.powf(1.0 / 2.6),
            to => light.powf(1.0 / exponent(to) as f32),
        }
    }
}

/// Intensity of white in nits above which the decoder maps tones.
const SDR: f32 = 255.0;

/// Keeps the decoder from mapping tones: it would darken pictures whose white is above [`SDR`] for displays that cannot
/// show it. libjxl does so only for displays that it knows. Returns how to convert the samples that it then renders.
fn without_tone_mapping(image: &mut JxlImage, is_srgb: bool) -> Option<FromPq> {
    let metadata = &image.image_header().metadata;
    let intensity = metadata.tone_mapping.intensity_target;
    let encoding = match &metadata.colour_encoding {
        _ if is_srgb => return None,
        ColourEncoding::Enum(encoding) => encoding.clone(),
        ColourEncoding::IccProfile(_) => return None,
    };
    let is_hdr = matches!(encoding.tf, TransferFunction::Pq | TransferFunction::Hlg);
    if !metadata.xyb_encoded || intensity.is_nan() || intensity <= SDR || is_hdr {
        return None;
    }
    let from = FromPq { white: intensity / 10_000.0, to: encoding.tf };
    image.request_color_encoding(EnumColourEncoding { tf: TransferFunction::Pq, ..encoding });
    Some(from)
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
    Failure { kind: Kind::Limit, message: limits::beyond_memory(path) }
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

    /// Returns a codestream that ends where a coded profile of `length` bytes begins.
    fn with_profile(length: u64) -> Vec<u8> {
        let mut bits: Vec<bool> = Vec::new();
        let mut put = |value: u64, count: u32| (0..count).for_each(|k| bits.push(value >> k & 1 == 1));
        put(0x0AFF, 16);
        // A square of 8 pixels.
        let size = [(1, 1), (0, 5), (1, 3)];
        // Not all default, no extra fields, integers, 8 bits, short buffers, no extra channels, not XYB.
        let samples = [(0, 1), (0, 1), (0, 1), (0, 2), (1, 1), (0, 2), (0, 1)];
        // A colour encoding that is a profile for RGB; no extensions, and all else default.
        let colors = [(0, 1), (1, 1), (0, 2), (0, 2), (1, 1)];
        for &(value, count) in [&size[..], &samples, &colors].into_iter().flatten() {
            put(value, count);
        }
        put(3, 2);
        put(length & 0xFFF, 12);
        for byte in (0..6).map(|k| length >> (12 + 8 * k)).take_while(|&rest| rest > 0) {
            put(1, 1);
            put(byte & 0xFF, 8);
        }
        put(0, 1);
        bits.chunks(8).map(|byte| byte.iter().rev().fold(0, |sum, &bit| sum << 1 | u8::from(bit))).collect()
    }

    #[test]
    fn a_long_profile_is_refused_before_it_is_decompressed() {
        for length in [5 << 20, 200 << 20, 1 << 40] {
            let refused = check_profile(Path::new("a.jxl"), &with_profile(length)).unwrap_err();
            assert_eq!(refused.kind, Kind::Limit);
            assert!(refused.message.contains(&format!("has {length} bytes")), "{}", refused.message);
        }
        assert!(check_profile(Path::new("a.jxl"), &with_profile(4000)).is_ok());
    }

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
