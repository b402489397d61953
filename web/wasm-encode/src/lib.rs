//! The encoder for JavaScript: pixels in; a file, the account of the encode or an error's text out.
//! `web/encode-machine.js` is the other side.
//!
//! A caller fills what [`input`] gave, sets options, calls [`encode`], and reads the pieces and the numbers of the answer. If
//! `encode` does not return 0, that is the kind of the error, and the first piece its words in UTF-8. No pointer is followed here.

use std::cell::RefCell;
use std::fmt::Write;
use std::ops::ControlFlow;
use std::time::Duration;

use image::metadata::Orientation;
use ssplat::unstable::instant::provide_clock;
use ssplat::unstable::score::provide_score;
use ssplat::{Channels, Cicp, Detail, Encoder, Error, Parameter, Pixels, Progress, Result, Samples, Target, Tune};

#[link(wasm_import_module = "host")]
unsafe extern "C" {
    /// Seconds since any fixed moment.
    safe fn now() -> f64;
    /// Takes the stage's name and the share of it that is done; anything but 0 stops the encode.
    safe fn progress(name: *const u8, length: usize, done: f32) -> u32;
    /// Returns the SSIMULACRA2 score of `test` against `reference`, which are samples as [`encode`] takes them.
    safe fn ssimulacra2(
        width: u32,
        height: u32,
        channels: usize,
        bits: u32,
        reference: *const u8,
        test: *const u8,
    ) -> f64;
}

/// What is put on the desk before an encode, and what lies there after it.
#[derive(Default)]
struct Desk {
    /// Samples; ICC profile; EXIF block; code points.
    inputs: [Vec<u8>; 4],
    encoder: Encoder,
    /// The file or an error's words; the stages of the encode; what was left out.
    pieces: [Vec<u8>; 3],
    /// Gaussians, PSNR, quality, seconds.
    numbers: [f64; 4],
}

thread_local! {
    static DESK: RefCell<Desk> = RefCell::default();
}

/// Makes room for `length` bytes of input `which`, and says where they go; 0 if there is no room.
#[unsafe(no_mangle)]
pub extern "C" fn input(which: usize, length: usize) -> *mut u8 {
    DESK.with_borrow_mut(|desk| {
        let Some(input) = desk.inputs.get_mut(which) else { return std::ptr::null_mut() };
        *input = Vec::new();
        if input.try_reserve_exact(length).is_err() {
            return std::ptr::null_mut();
        }
        input.resize(length, 0);
        input.as_mut_ptr()
    })
}

/// Sets an option to a value; 0 if there is no such option. Casts end at the type's bounds.
#[unsafe(no_mangle)]
pub extern "C" fn set(which: u32, value: f64) -> u32 {
    DESK.with_borrow_mut(|desk| {
        let encoder = std::mem::take(&mut desk.encoder);
        let target = |target| encoder.clone().target(target);
        desk.encoder = match which {
            0 => target(Target::Ratio(value)),
            1 => target(Target::Bytes(value as u64)),
            2 => target(Target::Psnr(value)),
            3 => target(Target::Quality(value)),
            4 => target(Target::Gaussians(value as u32)),
            5 => encoder.effort(value as u8),
            6 => encoder.tune(match value as u32 {
                0 => Tune::Psnr,
                _ => Tune::Iq,
            }),
            7 => match Duration::try_from_secs_f64(value) {
                Ok(time) => encoder.time(time),
                Err(_) => encoder,
            },
            8 => encoder.seed(value as u64),
            9 => encoder.detail(if value == 0.0 { Detail::Off } else { Detail::Auto }),
            10 => encoder.levels(value as u8),
            11 => target(Target::Lossless),
            _ => {
                desk.encoder = encoder;
                return 0;
            }
        };
        1
    })
}

/// Where a piece of the answer is.
#[unsafe(no_mangle)]
pub extern "C" fn piece(which: usize) -> *const u8 {
    DESK.with_borrow(|desk| desk.pieces.get(which).map_or(std::ptr::null(), |piece| piece.as_ptr()))
}

/// Bytes of a piece of the answer.
#[unsafe(no_mangle)]
pub extern "C" fn piece_length(which: usize) -> usize {
    DESK.with_borrow(|desk| desk.pieces.get(which).map_or(0, Vec::len))
}

/// A number of the answer.
#[unsafe(no_mangle)]
pub extern "C" fn number(which: usize) -> f64 {
    DESK.with_borrow(|desk| desk.numbers.get(which).copied().unwrap_or(0.0))
}

/// Encodes the samples: rows from the top, channels interleaved, 16 bits little-endian. `orientation` is that of EXIF; 1 is upright
/// and adds nothing to the file.
#[unsafe(no_mangle)]
pub extern "C" fn encode(width: u32, height: u32, channels: usize, bits: u32, orientation: u8) -> u32 {
    provide_clock(|| now());
    provide_score(score);
    answer(|desk| desk.encode([width, height], channels, bits, orientation))
}

/// Has JavaScript compute a score, with a module of its own that is loaded only for encodes that need it.
fn score(reference: &Pixels, test: &Pixels) -> f64 {
    let samples = |pixels: &Pixels| match pixels.samples() {
        Samples::U8(samples) => samples.as_ptr(),
        Samples::U16(samples) => samples.as_ptr().cast(),
    };
    let bits = 8 * reference.depth().bytes() as u32;
    let channels = reference.channels().count();
    ssimulacra2(reference.width(), reference.height(), channels, bits, samples(reference), samples(test))
}

/// Returns 0 if `work` is done, otherwise the kind of its error, whose text becomes the first piece.
fn answer(work: impl FnOnce(&mut Desk) -> Result<()>) -> u32 {
    DESK.with_borrow_mut(|desk| match work(desk) {
        Ok(()) => 0,
        Err(error) => {
            desk.pieces = [error.to_string().into_bytes(), Vec::new(), Vec::new()];
            match error {
                Error::LimitExceeded { .. } => 1,
                Error::Parameter { .. } => 2,
                Error::TooSmall { .. } => 3,
                Error::Cancelled => 4,
                _ => 5,
            }
        }
    })
}

fn parameter(name: &'static str, problem: String) -> Error {
    Error::Parameter { parameter: Parameter::Other(name), problem }
}

impl Desk {
    /// Takes the samples.
    fn pixels(&mut self, [width, height]: [u32; 2], channels: usize, bits: u32) -> Result<Pixels> {
        let channels = Channels::from_count(channels)
            .ok_or_else(|| parameter("channels", format!("{channels} is outside 1..=4")))?;
        let bytes = std::mem::take(&mut self.inputs[0]);
        let samples = match bits {
            8 => Samples::U8(bytes),
            16 => Samples::U16(bytes.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect()),
            _ => return Err(parameter("depth", format!("{bits} is neither 8 nor 16"))),
        };
        Pixels::new(width, height, channels, samples)
    }

    fn encode(&mut self, size: [u32; 2], channels: usize, bits: u32, orientation: u8) -> Result<()> {
        let pixels = self.pixels(size, channels, bits)?;
        let orientation = Orientation::from_exif(orientation)
            .ok_or_else(|| parameter("orientation", format!("{orientation} is outside 1..=8")))?;
        let mut encoder = std::mem::take(&mut self.encoder);
        let [_, icc, exif, cicp] = &mut self.inputs;
        if !cicp.is_empty() {
            let found = Cicp::from_bytes(cicp).map_err(|error| parameter("cicp", error.to_string()))?;
            encoder = encoder.cicp(found);
        }
        if !icc.is_empty() {
            encoder = encoder.icc(std::mem::take(icc));
        }
        if !exif.is_empty() {
            encoder = encoder.exif(std::mem::take(exif));
        } else if orientation != Orientation::NoTransforms {
            encoder = encoder.exif(oriented(orientation));
        }
        let encoded = encoder.encode_with_progress(&pixels, &mut |&Progress { stage, done, .. }| match progress(
            stage.as_ptr(),
            stage.len(),
            done,
        ) {
            0 => ControlFlow::Continue(()),
            _ => ControlFlow::Break(()),
        })?;
        let report = encoded.report;
        let mut lines = [String::new(), String::new()];
        for stage in &report.stages {
            let _ = writeln!(lines[0], "{}\t{}", stage.name, (stage.seconds * 1e6) as u64);
        }
        for left_out in &report.skipped {
            let _ = writeln!(lines[1], "{}\t{}", left_out.what, left_out.bytes);
        }
        let [stages, left_out] = lines.map(String::into_bytes);
        self.pieces = [encoded.bytes, stages, left_out];
        self.numbers = [report.gaussians as f64, report.psnr, report.quality.unwrap_or(f64::NAN), report.seconds];
        Ok(())
    }
}

/// An EXIF block of an orientation alone: a TIFF header and one entry.
fn oriented(orientation: Orientation) -> Vec<u8> {
    let mut block = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
    block.extend([orientation.to_exif(), 0, 0, 0, 0, 0, 0, 0]);
    block
}
