//! The encoder's functions for C.

use std::ffi::{CString, c_char, c_int, c_void};
use std::sync::Mutex;

use crate::encoding::Encoding;
use crate::failure::{Failure, Outcome, ssplat_status};
use crate::format::{Rows, gather};
use crate::handle::{Handle, Held, bytes, enter, free, give, give_out, message, zeros};

/// An encoder: options, and the text of the last error. ssplat_encoder_new() makes one, ssplat_encoder_free() frees it.
/// It can encode any number of pictures.
pub struct ssplat_encoder {
    held: Mutex<Held<State>>,
}

/// What an encoder holds.
#[derive(Default)]
pub struct State {
    encoding: Encoding,
    callback: Option<Callback>,
}

/// A function of the caller, and its pointer.
#[derive(Clone, Copy)]
struct Callback {
    call: unsafe extern "C" fn(*mut c_void, *const c_char, f32) -> c_int,
    user: *mut c_void,
}

impl Handle for ssplat_encoder {
    type Held = State;
    const NAME: &str = "encoder";

    fn lock(&self) -> &Mutex<Held<State>> {
        &self.held
    }

    fn abandon(held: &mut State) {
        held.encoding.abandon();
    }
}

/// Pixels of the caller, for ssplat_encoder_encode().
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct ssplat_pixels {
    /// First byte of the first row.
    pub data: *const c_void,
    /// Bytes that may be read from there on.
    pub size: usize,
    /// Bytes from the start of a row to the start of the next; 0 if rows follow each other without a gap.
    pub stride: usize,
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels.
    pub height: u32,
    /// A value of ssplat_format, which says which channels the file has. Of colours that were multiplied by alpha, those
    /// of pixels with little alpha have lost precision.
    pub format: c_int,
    /// Zeros.
    pub reserved: [u32; 5],
}

/// What the last ssplat_encoder_encode() has made.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct ssplat_report {
    /// Bytes of the file.
    pub bytes: u64,
    /// PSNR in dB of the decoded picture before it is rounded to samples; infinite if it is the same.
    pub psnr: f64,
    /// SSIMULACRA2 score, if the target is a quality; NaN if it was not measured.
    pub quality: f64,
    /// Wall-clock time.
    pub seconds: f64,
    /// Number of Gaussians.
    pub gaussians: u32,
    /// The effort, which a time limit may have lowered; 0 if the picture was stored without a fit.
    pub effort: u32,
    /// Zeros.
    pub reserved: [u32; 8],
}

/// Called by the thread that called ssplat_encoder_encode(), a few hundred times during an encode, with the name of a
/// stage, such as "fit", and the share of the stage that is done, 0 to 1. The name is valid during the call. The encode
/// stops soon after the function has returned anything but 0. It must return: no longjmp and no exception of C++.
pub type ssplat_progress = Option<unsafe extern "C" fn(user: *mut c_void, stage: *const c_char, done: f32) -> c_int>;

/// Takes the next bytes of a file, in one or more calls from its start on. Anything but 0 stops with SSPLAT_STATUS_IO. It
/// must return: no longjmp and no exception of C++.
pub type ssplat_write = Option<unsafe extern "C" fn(user: *mut c_void, data: *const c_void, size: usize) -> c_int>;

/// Returns an encoder with the default options, or NULL if memory runs out.
#[unsafe(no_mangle)]
pub extern "C" fn ssplat_encoder_new() -> *mut ssplat_encoder {
    give_out(|| ssplat_encoder { held: Mutex::default() })
}

/// Frees the encoder that *encoder points to, and sets *encoder to NULL, with the rules of ssplat_decoder_free().
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_encoder_free(encoder: *mut *mut ssplat_encoder) -> ssplat_status {
    // SAFETY: the caller passes NULL or a pointer to a variable, which holds NULL or an encoder that has not been freed.
    unsafe { free(encoder) }
}

/// Copies the message of the last call that failed, as ssplat_decoder_message() does.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_encoder_message(
    encoder: *const ssplat_encoder,
    buffer: *mut c_char,
    capacity: usize,
) -> usize {
    // SAFETY: the caller passes NULL or an encoder that has not been freed, and NULL or a buffer of that capacity.
    unsafe { message(encoder, buffer, capacity) }
}

/// Sets the target, a value of ssplat_target, and its value. Values out of range are refused by
/// ssplat_encoder_encode().
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_encoder_set_target(
    encoder: *mut ssplat_encoder,
    target: c_int,
    value: f64,
) -> ssplat_status {
    // SAFETY: the caller passes NULL or an encoder that has not been freed.
    unsafe { enter(encoder, |held: &mut State| held.encoding.set_target(target, value)) }
}

/// Sets an option, a value of ssplat_option.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_encoder_set_option(
    encoder: *mut ssplat_encoder,
    option: c_int,
    value: i64,
) -> ssplat_status {
    // SAFETY: the caller passes NULL or an encoder that has not been freed.
    unsafe { enter(encoder, |held: &mut State| held.encoding.set_option(option, value)) }
}

/// Sets the ICC profile (SSPLAT_METADATA_ICC), the EXIF block (SSPLAT_METADATA_EXIF, from its TIFF header on) or the code
/// points of colours (SSPLAT_METADATA_CICP, four bytes) of the files that follow. The bytes are copied; size 0 takes them
/// away. They count as bytes of the file. Files hold no XMP.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_encoder_set_metadata(
    encoder: *mut ssplat_encoder,
    which: c_int,
    data: *const c_void,
    size: usize,
) -> ssplat_status {
    let work = |held: &mut State| {
        // SAFETY: the caller says that `size` bytes at `data` can be read, and nothing writes them during this call.
        let found = unsafe { bytes("data", data, size) }?;
        held.encoding.set_metadata(which, found)
    };
    // SAFETY: the caller passes NULL or an encoder that has not been freed.
    unsafe { enter(encoder, work) }
}

/// Sets the function that ssplat_encoder_encode() calls with user; NULL for none.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_encoder_set_callback(
    encoder: *mut ssplat_encoder,
    callback: ssplat_progress,
    user: *mut c_void,
) -> ssplat_status {
    let work = |held: &mut State| {
        held.callback = callback.map(|call| Callback { call, user });
        Ok(())
    };
    // SAFETY: the caller passes NULL or an encoder that has not been freed.
    unsafe { enter(encoder, work) }
}

/// Encodes pixels, which are copied, and passes the file to write with user. Nothing is written if the encode fails.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_encoder_encode(
    encoder: *mut ssplat_encoder,
    pixels: *const ssplat_pixels,
    write: ssplat_write,
    user: *mut c_void,
) -> ssplat_status {
    let work = |held: &mut State| {
        let Some(write) = write else { return Err(Failure::parameter("write is NULL")) };
        // SAFETY: the caller passes NULL or a pointer to pixels.
        let Some(given) = (unsafe { pixels.as_ref() }) else { return Err(Failure::parameter("pixels is NULL")) };
        // SAFETY: the caller says that these bytes can be read, and nothing writes them during this call.
        let pixels = unsafe { copied(given) }?;
        let callback = held.callback;
        let mut watch = |stage: &str, done| match callback {
            Some(Callback { call, user }) => {
                // Names of stages have no zeros.
                let stage = CString::new(stage).unwrap_or_default();
                // SAFETY: the caller set this function and says that it may be called with this pointer.
                unsafe { call(user, stage.as_ptr(), done) == 0 }
            }
            None => true,
        };
        let file = held.encoding.encode(&pixels, &mut watch)?;
        // SAFETY: the caller says that this function may be called with this pointer.
        match unsafe { write(user, file.as_ptr().cast(), file.len()) } {
            0 => Ok(()),
            code => Err(Failure::new(ssplat_status::Io, format_args!("the write callback returned {code}"))),
        }
    };
    // SAFETY: the caller passes NULL or an encoder that has not been freed.
    unsafe { enter(encoder, work) }
}

/// Writes to *report what the last successful ssplat_encoder_encode() has made; SSPLAT_STATUS_CLOSED before.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_encoder_report(
    encoder: *mut ssplat_encoder,
    report: *mut ssplat_report,
) -> ssplat_status {
    let work = |held: &mut State| {
        let (bytes, found) = held.encoding.last()?;
        let found = ssplat_report {
            bytes: *bytes,
            psnr: found.psnr,
            quality: found.quality.unwrap_or(f64::NAN),
            seconds: found.seconds,
            gaussians: found.gaussians.try_into().unwrap_or(u32::MAX),
            effort: found.effort.into(),
            reserved: [0; 8],
        };
        // SAFETY: the caller passes NULL or a pointer to a variable.
        unsafe { give("report", report, found) }
    };
    // SAFETY: the caller passes NULL or an encoder that has not been freed.
    unsafe { enter(encoder, work) }
}

/// A copy of a caller's pixels.
///
/// # Safety
/// The memory that `given` describes can be read.
unsafe fn copied(given: &ssplat_pixels) -> Outcome<ssplat::Pixels> {
    zeros("the pixels", &given.reserved)?;
    if given.data.is_null() {
        return Err(Failure::parameter("data of the pixels is NULL"));
    }
    let size = [given.width, given.height];
    if size.contains(&0) {
        return Err(Failure::parameter(format_args!(
            "a picture of {} × {} pixels is empty",
            given.width, given.height
        )));
    }
    let rows = Rows::new(given.format, size, given.size, given.stride)?;
    let mut at = 0;
    gather(&rows, size, |out| {
        // SAFETY: `Rows::new` has checked that as many rows as there are lie within `size` bytes from `data` on.
        let start = unsafe { given.data.cast::<u8>().add(at) };
        // SAFETY: as above.
        out.extend_from_slice(unsafe { std::slice::from_raw_parts(start, rows.len) });
        at += rows.stride;
    })
}
