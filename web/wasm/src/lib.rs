//! Functions for JavaScript: bytes in; pixels, Gaussians, facts or an error's text out. `web/machine.js` is the other
//! side.
//!
//! A call fills what [`input`] gave, asks with [`header`], [`decode`], [`gaussians`] or [`info`], and reads the pieces
//! and the numbers of the answer if it is 0. Otherwise the answer is the kind of the error, and the first piece its
//! words in UTF-8.
//!
//! No pointer is read here: those that go out are only JavaScript's to follow. The one thing that Rust calls unsafe is
//! that functions are exported by their names, which might clash with another's; the linker of one module would say so.

use std::cell::RefCell;
use std::fmt::Write;

use image::metadata::Orientation;
use ssplat::SamplesMut;
use ssplat::unstable::bitstream::header::{Sections, VERSION};
use ssplat::unstable::bitstream::splats::{Layout, Metadata};
use ssplat::{Blend, Damage, Error, FormatError, Layers, Limit, Limits, Reader, Rect, Result};

/// State that is kept between two calls.
#[derive(Default)]
struct Desk {
    input: Vec<u8>,
    limits: Limits,
    answer: Answer,
}

/// Answer of a call. The pieces are: pixels, Gaussians, JSON, a thumbnail or a text; the ICC profile; the EXIF block;
/// the bits of each Gaussian; the cells of the exact layer; the code points. The numbers are: width, height, channels, depth in bits, Gaussians, orientation as EXIF
/// counts it, missing Gaussians, missing tiles of the detail layer, and 1 if the file is cut off or its checksum is
/// wrong.
#[derive(Default)]
struct Answer {
    pieces: [Vec<u8>; 6],
    numbers: [u32; 9],
}

thread_local! {
    static DESK: RefCell<Desk> = RefCell::default();
}

/// Makes room for a file of `length` bytes, forgets everything else, and says where the bytes go; 0 if there is no
/// room.
#[unsafe(no_mangle)]
pub extern "C" fn input(length: usize) -> *mut u8 {
    DESK.with_borrow_mut(|desk| {
        *desk = Desk::default();
        if desk.input.try_reserve_exact(length).is_err() {
            return std::ptr::null_mut();
        }
        desk.input.resize(length, 0);
        desk.input.as_mut_ptr()
    })
}

/// Sets a limit, counted in the order of [`Limits`]; 0 if there is no such limit.
#[unsafe(no_mangle)]
pub extern "C" fn limit(which: u32, value: f64) -> u32 {
    DESK.with_borrow_mut(|Desk { limits, .. }| {
        // From a double, casts end at the type's bounds.
        match which {
            0 => limits.width = value as u32,
            1 => limits.height = value as u32,
            2 => limits.gaussians = value as u64,
            3 => limits.tile_pairs = value as u64,
            4 => limits.work = value as u64,
            5 => limits.overlap = value as u64,
            6 => limits.alloc = value as u64,
            7 => limits.metadata = value as u64,
            _ => return 0,
        }
        1
    })
}

/// Where a piece of the last answer is.
#[unsafe(no_mangle)]
pub extern "C" fn piece(which: usize) -> *const u8 {
    DESK.with_borrow(|desk| desk.answer.pieces.get(which).map_or(std::ptr::null(), |p| p.as_ptr()))
}

/// Bytes of a piece of the last answer.
#[unsafe(no_mangle)]
pub extern "C" fn piece_length(which: usize) -> usize {
    DESK.with_borrow(|desk| desk.answer.pieces.get(which).map_or(0, Vec::len))
}

/// A number of the last answer.
#[unsafe(no_mangle)]
pub extern "C" fn number(which: usize) -> u32 {
    DESK.with_borrow(|desk| desk.answer.numbers.get(which).copied().unwrap_or(0))
}

/// Reads the header, and thumbnail, ICC profile and EXIF block if there are any; of the file nothing more need be
/// there.
#[unsafe(no_mangle)]
pub extern "C" fn header() -> u32 {
    answer(|input, limits| {
        let opening = open(input, limits)?;
        let header = opening.header();
        let (width, height, sections) = (header.width, header.height, header.sections);
        let mut answer = Answer::default();
        let [channels, depth] = [header.channels.count(), 8 * header.depth.bytes()].map(|v| v as u32);
        answer.numbers = [width, height, channels, depth, header.gaussians, 1, 0, 0, 0];
        if sections == Sections::Present {
            let mut metadata = opening.metadata()?;
            answer.pieces[0] = metadata.thumbnail.take().unwrap_or_default();
            describe(metadata, &mut answer);
        }
        Ok(answer)
    })
}

/// Decodes the part of the picture at (`left`, `top`) to RGBA with 8 bits; a part of width 0 is the whole picture, and
/// an output of width 0 has a pixel for each of the part's. An output of height 0 keeps the part's shape. `partial`
/// other than 0 draws what is there of a damaged file. Of the layers 1 draws the Gaussians alone, 2 the detail alone,
/// all else both.
#[unsafe(no_mangle)]
pub extern "C" fn decode(
    left: u32,
    top: u32,
    width: u32,
    height: u32,
    out_width: u32,
    out_height: u32,
    partial: u32,
    layers: u32,
) -> u32 {
    let layers = match layers {
        1 => Layers::Gaussians,
        2 => Layers::Detail,
        _ => Layers::Both,
    };
    answer(|input, limits| {
        let opening = open(input, limits)?;
        let header = opening.header();
        let (channels, depth) = (header.channels.count(), header.depth);
        let mut view = opening.view().layers(layers);
        if width > 0 {
            view = view.crop(Rect::new(left, top, width, height))?;
        }
        if out_width > 0 {
            let kept = (f64::from(view.height()) * f64::from(out_width) / f64::from(view.width())).round().max(1.0);
            view = view.resized(out_width, if out_height > 0 { out_height } else { kept as u32 })?;
        }
        // Samples and RGBA are there at once, beside all that decoding takes.
        let pixels = u64::from(view.width()) * u64::from(view.height());
        let needed = pixels.saturating_mul(channels as u64 + 4);
        let allowed = limits.alloc;
        let mut rest = limits.clone();
        rest.alloc = allowed.checked_sub(needed).ok_or(Error::LimitExceeded {
            limit: Limit::Alloc,
            requested: needed,
            allowed,
        })?;
        let opening = open(input, &rest)?;
        let count = opening.header().gaussians;
        let opened = opening.damage(if partial == 0 { Damage::Refuse } else { Damage::Accept }).read_for(&view)?;
        let mut samples = zeros(pixels as usize * channels)?;
        opened.render_into(&view, SamplesMut::U8(&mut samples))?;
        let missing = opened.missing();
        let lost = [missing.gaussians, missing.tiles, u32::from(missing.damaged)];
        let mut answer = Answer::default();
        describe(opened.into_metadata(), &mut answer);
        let rgba = match channels {
            1 => spread(&samples, |&[grey]: &[u8; 1]| [[grey, grey, grey, 255]]),
            2 => spread(&samples, |&[grey, alpha]: &[u8; 2]| [[grey, grey, grey, alpha]]),
            3 => spread(&samples, opaque),
            _ => Ok(std::mem::take(&mut samples)),
        };
        answer.pieces[0] = rgba?;
        let orientation = answer.numbers[ORIENTATION];
        let bits = 8 * depth.bytes() as u32;
        let [gaussians, tiles, damaged] = lost;
        let [columns, rows] = [view.width(), view.height()];
        answer.numbers = [columns, rows, channels as u32, bits, count, orientation, gaussians, tiles, damaged];
        Ok(answer)
    })
}

/// All Gaussians: for each nine floats, which are the centre, the deviations along both axes, the rotation and four
/// colour channels, in the order and the units of [`ssplat::Gaussian`]; behind them four floats of the background.
#[unsafe(no_mangle)]
pub extern "C" fn gaussians() -> u32 {
    answer(|input, limits| {
        let opening = open(input, limits)?;
        let header = opening.header();
        let (width, height, gaussians) = (header.width, header.height, header.gaussians);
        let [channels, depth] = [header.channels.count(), 8 * header.depth.bytes()].map(|v| v as u32);
        let opened = opening.read()?;
        let stored = opened.gaussians()?;
        drop(opened);
        let mut bytes = zeros(36 * stored.list.len() + 16)?;
        let (rows, background) = bytes.split_at_mut(36 * stored.list.len());
        for (row, g) in rows.chunks_exact_mut(36).zip(&stored.list) {
            let ([x, y], [major, minor], [red, green, blue, alpha]) = (g.mean, g.scale, g.color);
            write(row, &[x, y, major, minor, g.rotation, red, green, blue, alpha]);
        }
        write(background, &stored.background);
        let mut answer = Answer::default();
        answer.pieces[0] = bytes;
        answer.numbers = [width, height, channels, depth, gaussians, 1, 0, 0, 0];
        Ok(answer)
    })
}

/// Answers with the contents of the file as JSON. The whole file is read.
#[unsafe(no_mangle)]
pub extern "C" fn info() -> u32 {
    answer(|input, limits| {
        let (splats, report) = ssplat::unstable::bitstream::inspect(input, limits)?;
        let header = &report.header;
        let layout = match header.layout {
            Layout::Packed => "packed",
            Layout::Planes => "planes",
            Layout::Coded => "coded",
        };
        let mut json = String::from("{");
        for (name, value) in [
            ("version", u64::from(VERSION)),
            ("width", u64::from(header.width)),
            ("height", u64::from(header.height)),
            ("channels", header.channels.count() as u64),
            ("depth", 8 * header.depth.bytes() as u64),
            ("gaussians", u64::from(header.gaussians)),
            ("groups", u64::from(report.groups)),
            ("codebook", splats.codebook.as_ref().map_or(0, Vec::len) as u64),
            ("bytes", report.bytes),
        ] {
            let _ = write!(json, r#""{name}":{value},"#);
        }
        let blend = if header.blend == Blend::Sum { "sum" } else { "normalized" };
        let _ = write!(json, r#""layout":"{layout}","blend":"{blend}","levels":["#);
        for (k, level) in report.levels.iter().enumerate() {
            let _ = write!(json, "{}{level}", if k > 0 { "," } else { "" });
        }
        json += r#"],"parts":["#;
        for (k, part) in report.parts.iter().enumerate() {
            item(&mut json, k, part.name, "bytes", part.bytes);
        }
        json += r#"],"sections":["#;
        for (k, section) in report.sections.iter().enumerate() {
            // Letters: a section of another name is refused.
            item(&mut json, k, std::str::from_utf8(&section.name).unwrap_or("?"), "bytes", section.bytes);
        }
        json += r#"],"fields":["#;
        for (k, field) in report.fields.iter().enumerate() {
            // Integers: what prints floats would be a tenth of the module.
            item(&mut json, k, field.name, "thousandths", (field.bits * 1000.0) as u64);
        }
        json += "]}";
        let mut answer = Answer::default();
        if let Some(exact) = &splats.exact {
            answer.pieces[4] = exact.cells([header.width, header.height]).iter().map(|&cell| cell.into()).collect();
        }
        describe(splats.metadata, &mut answer);
        answer.pieces[0] = json.into_bytes();
        let mut bits = zeros(4 * report.each.len())?;
        write(&mut bits, &report.each);
        answer.pieces[3] = bits;
        Ok(answer)
    })
}

/// All questions share the one reader of headers.
#[inline(never)]
fn open<'a>(input: &'a [u8], limits: &Limits) -> Result<Reader<'a>> {
    Reader::new(input, limits)
}

/// Place of the orientation among an answer's numbers.
const ORIENTATION: usize = 5;

/// Puts code points, ICC profile, EXIF block and the orientation that it names into an answer.
fn describe(Metadata { cicp, icc, exif, .. }: Metadata, answer: &mut Answer) {
    let orientation = exif.as_deref().and_then(Orientation::from_exif_chunk).unwrap_or(Orientation::NoTransforms);
    answer.numbers[ORIENTATION] = u32::from(orientation.to_exif());
    answer.pieces[1] = icc.unwrap_or_default();
    answer.pieces[2] = exif.unwrap_or_default();
    answer.pieces[5] = cicp.map(|cicp| cicp.to_bytes().to_vec()).unwrap_or_default();
}

/// Appends what stands at place `k` of a list.
#[inline(never)]
fn item(json: &mut String, k: usize, name: &str, unit: &str, value: u64) {
    let _ = write!(json, r#"{}{{"name":"{name}","{unit}":{value}}}"#, if k > 0 { "," } else { "" });
}

/// Makes RGBA of the samples of so many pixels at a time.
fn spread<const S: usize, const P: usize>(
    samples: &[u8],
    pixels: impl Fn(&[u8; S]) -> [[u8; 4]; P],
) -> Result<Vec<u8>> {
    let (whole, rest) = samples.as_chunks::<S>();
    let mut rgba = Vec::new();
    let length = (whole.len() + 1) * 4 * P;
    let full = |_| Error::LimitExceeded { limit: Limit::Alloc, requested: length as u64, allowed: 0 };
    rgba.try_reserve_exact(whole.len() + 1).map_err(full)?;
    rgba.extend(whole.iter().map(&pixels));
    let mut last = [0; S];
    last[..rest.len()].copy_from_slice(rest);
    rgba.push(pixels(&last));
    let mut rgba = rgba.into_flattened().into_flattened();
    rgba.truncate(samples.len() * P / S * 4);
    Ok(rgba)
}

/// Four pixels of three samples, in words: bytes would take several times as long.
fn opaque(samples: &[u8; 12]) -> [[u8; 4]; 4] {
    let word = |k: usize| u32::from_le_bytes([samples[k], samples[k + 1], samples[k + 2], samples[k + 3]]);
    let (a, b, c) = (word(0), word(4), word(8));
    [a, a >> 24 | b << 8, b >> 16 | c << 16, c >> 8].map(|v| (v | 255 << 24).to_le_bytes())
}

/// Writes floats in JavaScript's order of bytes.
fn write(to: &mut [u8], floats: &[f32]) {
    for (to, v) in to.chunks_exact_mut(4).zip(floats) {
        to.copy_from_slice(&v.to_le_bytes());
    }
}

fn zeros(length: usize) -> Result<Vec<u8>> {
    let mut buffer = Vec::new();
    let full = |_| Error::LimitExceeded { limit: Limit::Alloc, requested: length as u64, allowed: 0 };
    buffer.try_reserve_exact(length).map_err(full)?;
    buffer.resize(length, 0);
    Ok(buffer)
}

/// Leaves an answer on the desk: what `make` gives and 0, or the error's words and its kind.
fn answer(make: impl FnOnce(&[u8], &Limits) -> Result<Answer>) -> u32 {
    DESK.with_borrow_mut(|desk| {
        desk.answer = Answer::default();
        match make(&desk.input, &desk.limits) {
            Ok(answer) => {
                desk.answer = answer;
                0
            }
            Err(error) => {
                let text = match &error {
                    Error::Format(cut @ FormatError::CutOff { partial: true, .. }) => {
                        format!("the file is {cut}; {{ partial: true }} decodes what is there")
                    }
                    error => error.to_string(),
                };
                desk.answer.pieces[0] = text.into_bytes();
                match error {
                    Error::Format(_) => 1,
                    Error::UnsupportedVersion { .. } => 2,
                    Error::LimitExceeded { .. } => 3,
                    Error::Parameter { .. } => 4,
                    _ => 5,
                }
            }
        }
    })
}
