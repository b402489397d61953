//! The decoder's functions for C.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::path::PathBuf;
use std::ptr;
use std::sync::Mutex;

use ssplat::Damage;

use crate::failure::{Failure, Outcome, ssplat_status};
use crate::format::Rows;
use crate::handle::{Handle, Held, bytes, enter, free, give, give_out, message, zeros};
use crate::session::{Session, Wanted};

/// A decoder. ssplat_decoder_new() makes one, ssplat_decoder_free() frees it.
pub struct ssplat_decoder {
    held: Mutex<Held<Decoding>>,
}

/// What a decoder holds.
#[derive(Default)]
pub struct Decoding {
    session: Session,
    callback: Option<Callback>,
}

impl Handle for ssplat_decoder {
    type Held = Decoding;
    const NAME: &str = "decoder";

    fn lock(&self) -> &Mutex<Held<Decoding>> {
        &self.held
    }

    fn abandon(held: &mut Decoding) {
        held.session.close();
    }
}

/// A function of the caller, and its pointer.
#[derive(Clone, Copy)]
struct Callback {
    call: unsafe extern "C" fn(*mut c_void, f32) -> c_int,
    user: *mut c_void,
}

/// Limits on the cost of decoding, for ssplat_decoder_set_limit().
#[repr(C)]
pub enum ssplat_limit {
    /// Largest width in pixels.
    Width = 0,
    /// Largest height in pixels.
    Height = 1,
    /// Largest number of Gaussians.
    Gaussians = 2,
    /// Largest number of (Gaussian, tile) pairs of a view.
    TilePairs = 3,
    /// Largest work of drawing a view; the documentation of the Rust crate has the unit.
    Work = 4,
    /// Largest mean number of Gaussians over a pixel.
    Overlap = 5,
    /// Most bytes that decoding may allocate, a picture of the output's size included.
    Alloc = 6,
    /// Most bytes of metadata.
    Metadata = 7,
}

/// Kinds of metadata.
#[repr(C)]
pub enum ssplat_metadata {
    /// The ICC profile; a picture without one is sRGB.
    Icc = 0,
    /// The EXIF block, without the bytes "Exif\0\0" in front.
    Exif = 1,
    /// A small picture, as a .ssplat file.
    Thumbnail = 2,
    /// Four bytes that state the colours by ITU-T H.273, for example PQ or HLG: primaries, transfer characteristics,
    /// matrix coefficients (0), and 1 for full range. They take precedence over the ICC profile.
    Cicp = 3,
}

/// Facts about a file.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct ssplat_info {
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels.
    pub height: u32,
    /// 1 grey, 2 grey and alpha, 3 RGB, 4 RGB and alpha.
    pub channels: u32,
    /// Bits a sample of the picture that was encoded: 8 or 16.
    pub bits: u32,
    /// Number of Gaussians.
    pub gaussians: u32,
    /// How to turn the decoded picture for display, 1 to 8 as in EXIF; 1 is upright. Decoding does not turn it.
    pub orientation: u32,
    /// Zeros.
    pub reserved: [u32; 10],
}

/// Parts of a file that could not be read, with ssplat_decoder_set_partial().
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct ssplat_missing {
    /// Gaussians.
    pub gaussians: u32,
    /// Groups of Gaussians, and how many the file should have; 0 of 0 if the file is not divided into groups.
    pub groups: u32,
    pub of_groups: u32,
    /// Tiles of the layers, and how many the file should have; 0 of 0 without layers.
    pub tiles: u32,
    pub of_tiles: u32,
    /// 1 if the file is cut off or its checksum is wrong.
    pub damaged: u32,
    /// Tiles of the exact layer among those above, and how many of them the file should have.
    pub exact_tiles: u32,
    pub of_exact_tiles: u32,
    /// Zeros.
    pub reserved: [u32; 8],
}

/// The part of the picture to draw, and the size to draw it in. All zeros: the whole picture in its own size.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct ssplat_view {
    /// Left edge of the part, in pixels of the picture.
    pub x: u32,
    /// Top edge of the part, in pixels of the picture.
    pub y: u32,
    /// Width of the part. The whole picture if x, y, width and height are 0.
    pub width: u32,
    /// Height of the part.
    pub height: u32,
    /// Width of the output, in pixels. The size of the part if out_width and out_height are 0.
    pub out_width: u32,
    /// Height of the output, in pixels.
    pub out_height: u32,
    /// Zeros.
    pub reserved: [u32; 6],
}

/// Memory of the caller for pixels.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct ssplat_buffer {
    /// First byte of the first row.
    pub data: *mut c_void,
    /// Bytes that may be written from there on.
    pub size: usize,
    /// Bytes from the start of a row to the start of the next; 0 if rows follow each other without a gap.
    pub stride: usize,
    /// A value of ssplat_format.
    pub format: c_int,
    /// Zeros.
    pub reserved: [u32; 5],
}

/// Called by the thread that decodes, with the share that is done, 0 to 1, several times a second for pictures of any
/// size; only reading the file is one step. Decoding stops if it returns anything but 0. It must return: no longjmp and
/// no exception of C++.
pub type ssplat_callback = Option<unsafe extern "C" fn(user: *mut c_void, done: f32) -> c_int>;

/// Reads the next bytes of a file to buffer, at most capacity, and returns their number: 0 only at the end of the file,
/// and a negative number if reading fails. It must return: no longjmp and no exception of C++.
pub type ssplat_read = Option<unsafe extern "C" fn(user: *mut c_void, buffer: *mut c_void, capacity: usize) -> i64>;

/// Returns a decoder with the default limits and no file, or NULL if memory runs out.
#[unsafe(no_mangle)]
pub extern "C" fn ssplat_decoder_new() -> *mut ssplat_decoder {
    give_out(|| ssplat_decoder { held: Mutex::default() })
}

/// Frees the decoder that *decoder points to, and sets *decoder to NULL, so that freeing it again does nothing.
/// Does nothing if decoder or *decoder is NULL. A decoder that is in use, as in its own callback, is not freed and
/// *decoder is kept; the result is SSPLAT_STATUS_BUSY.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_free(decoder: *mut *mut ssplat_decoder) -> ssplat_status {
    // SAFETY: the caller passes NULL or a pointer to a variable, which holds NULL or a decoder that has not been freed.
    unsafe { free(decoder) }
}

/// Copies the message of the last call that failed into buffer, up to capacity - 1 bytes and a zero at the end, and
/// returns the length of the whole message in bytes, without the zero. The text is UTF-8 and empty if the last call
/// succeeded. buffer may be NULL if capacity is 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_message(
    decoder: *const ssplat_decoder,
    buffer: *mut c_char,
    capacity: usize,
) -> usize {
    // SAFETY: the caller passes NULL or a decoder that has not been freed, and NULL or a buffer of that capacity.
    unsafe { message(decoder, buffer, capacity) }
}

/// Returns the default of a limit, a value of ssplat_limit; 0 for other numbers.
#[unsafe(no_mangle)]
pub extern "C" fn ssplat_limit_default(limit: c_int) -> u64 {
    let limits = ssplat::Limits::default();
    match limit {
        0 => limits.width.into(),
        1 => limits.height.into(),
        2 => limits.gaussians,
        3 => limits.tile_pairs,
        4 => limits.work,
        5 => limits.overlap,
        6 => limits.alloc,
        7 => limits.metadata,
        _ => 0,
    }
}

/// Sets a limit, a value of ssplat_limit, for the calls that follow.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_set_limit(
    decoder: *mut ssplat_decoder,
    limit: c_int,
    value: u64,
) -> ssplat_status {
    let work = |held: &mut Decoding| {
        let limits = &mut held.session.limits;
        let side = u32::try_from(value).unwrap_or(u32::MAX);
        match limit {
            0 => limits.width = side,
            1 => limits.height = side,
            2 => limits.gaussians = value,
            3 => limits.tile_pairs = value,
            4 => limits.work = value,
            5 => limits.overlap = value,
            6 => limits.alloc = value,
            7 => limits.metadata = value,
            _ => return Err(Failure::parameter(format_args!("there is no limit {limit}"))),
        }
        Ok(())
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Sets whether what is left of truncated and damaged files is drawn; 0, the default, refuses them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_set_partial(decoder: *mut ssplat_decoder, partial: c_int) -> ssplat_status {
    let work = |held: &mut Decoding| {
        held.session.damage = if partial == 0 { Damage::Refuse } else { Damage::Accept };
        Ok(())
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Sets the function that ssplat_decoder_decode() calls with user; NULL for none.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_set_callback(
    decoder: *mut ssplat_decoder,
    callback: ssplat_callback,
    user: *mut c_void,
) -> ssplat_status {
    let work = |held: &mut Decoding| {
        held.callback = callback.map(|call| Callback { call, user });
        Ok(())
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Opens the file of size bytes at data, which is copied, and reads its header. Closes the file that was open. The first
/// part of a file is enough for ssplat_decoder_info().
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_open_memory(
    decoder: *mut ssplat_decoder,
    data: *const c_void,
    size: usize,
) -> ssplat_status {
    let work = |held: &mut Decoding| {
        held.session.close();
        // SAFETY: the caller says that `size` bytes at `data` can be read, and nothing writes them during this call.
        let file = unsafe { bytes("data", data, size) }?;
        held.session.open(file)
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Opens the file that read hands out, to its end, and keeps it in memory. Closes the file that was open.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_open_callback(
    decoder: *mut ssplat_decoder,
    read: ssplat_read,
    user: *mut c_void,
) -> ssplat_status {
    let work = |held: &mut Decoding| {
        held.session.close();
        let Some(read) = read else { return Err(Failure::parameter("read is NULL")) };
        held.session.open_source(&"the read callback", |room| {
            // SAFETY: the caller says that this function may be called with this pointer; `room` may be written.
            let count = unsafe { read(user, room.as_mut_ptr().cast(), room.len()) };
            match usize::try_from(count) {
                Ok(count) if count <= room.len() => Ok(count),
                _ => Err(std::io::Error::other(format!("it returned {count} for {} bytes", room.len()))),
            }
        })
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Begins a file whose bytes arrive by ssplat_decoder_append(). Closes the file that was open.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_begin(decoder: *mut ssplat_decoder) -> ssplat_status {
    let work = |held: &mut Decoding| {
        held.session.begin();
        Ok(())
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Adds size bytes at data to the end of the file that ssplat_decoder_begin() or another function has opened. The bytes
/// are copied. Returns SSPLAT_STATUS_FORMAT, SSPLAT_STATUS_VERSION or SSPLAT_STATUS_LIMIT as soon as the header shows
/// that no further bytes make a file of them, and closes it.
///
/// Between two calls, every other function works with the bytes that have arrived. ssplat_decoder_info() and
/// ssplat_decoder_metadata() need the start of the file. After ssplat_decoder_set_partial(), ssplat_decoder_decode()
/// draws the parts that are there; SSPLAT_STATUS_TRUNCATED means that nothing can be drawn yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_append(
    decoder: *mut ssplat_decoder,
    data: *const c_void,
    size: usize,
) -> ssplat_status {
    let work = |held: &mut Decoding| {
        // SAFETY: the caller says that `size` bytes at `data` can be read, and nothing writes them during this call.
        let more = unsafe { bytes("data", data, size) }?;
        held.session.append(more)
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Opens the file at path, which ends with a zero and is UTF-8 on Windows, and reads it to memory. Closes the file
/// that was open.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_open_file(decoder: *mut ssplat_decoder, path: *const c_char) -> ssplat_status {
    let work = |held: &mut Decoding| {
        held.session.close();
        if path.is_null() {
            return Err(Failure::parameter("path is NULL"));
        }
        // SAFETY: the caller passes a string that ends with a zero.
        let path = path_of(unsafe { CStr::from_ptr(path) })?;
        held.session.open_path(&path)
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Closes the file, if one is open, and frees its memory.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_close(decoder: *mut ssplat_decoder) -> ssplat_status {
    let work = |held: &mut Decoding| {
        held.session.close();
        Ok(())
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Writes facts about the file to *info.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_info(decoder: *mut ssplat_decoder, info: *mut ssplat_info) -> ssplat_status {
    let work = |held: &mut Decoding| {
        let facts = held.session.facts()?;
        let found = ssplat_info {
            width: facts.size[0],
            height: facts.size[1],
            channels: facts.channels.count() as u32,
            bits: 8 * facts.depth.bytes() as u32,
            gaussians: facts.gaussians,
            orientation: facts.orientation.into(),
            reserved: [0; 10],
        };
        // SAFETY: the caller passes NULL or a pointer to a variable.
        unsafe { give("info", info, found) }
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Copies metadata, a value of ssplat_metadata, to buffer, and its length in bytes to *length; 0 if the file has none.
/// If that is more than capacity, nothing is copied and the result is SSPLAT_STATUS_BUFFER. With buffer NULL and
/// capacity 0 only the length is told, with SSPLAT_STATUS_OK.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_metadata(
    decoder: *mut ssplat_decoder,
    which: c_int,
    buffer: *mut c_void,
    capacity: usize,
    length: *mut usize,
) -> ssplat_status {
    let work = |held: &mut Decoding| {
        let metadata = held.session.metadata()?;
        let found = match which {
            0 => metadata.icc,
            1 => metadata.exif,
            2 => metadata.thumbnail,
            3 => metadata.cicp.map(|cicp| cicp.to_bytes().to_vec()),
            _ => return Err(Failure::parameter(format_args!("there is no metadata {which}"))),
        };
        let found = found.unwrap_or_default();
        // SAFETY: the caller passes NULL or a pointer to a variable.
        unsafe { give("length", length, found.len()) }?;
        if buffer.is_null() {
            return if capacity == 0 { Ok(()) } else { Err(Failure::parameter("buffer is NULL")) };
        }
        if found.len() > capacity {
            return Err(Failure::short(capacity, found.len()));
        }
        // SAFETY: the caller says that `buffer` has `capacity` bytes, which are enough.
        unsafe { ptr::copy_nonoverlapping(found.as_ptr(), buffer.cast(), found.len()) };
        Ok(())
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Writes to *missing what the last ssplat_decoder_decode() or ssplat_decoder_preload() did not find in the file. All is 0
/// before, and for files that are whole.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_missing(
    decoder: *mut ssplat_decoder,
    missing: *mut ssplat_missing,
) -> ssplat_status {
    let work = |held: &mut Decoding| {
        let missing_parts = held.session.missing()?;
        let found = ssplat_missing {
            gaussians: missing_parts.gaussians,
            groups: missing_parts.groups,
            of_groups: missing_parts.of_groups,
            tiles: missing_parts.tiles,
            of_tiles: missing_parts.of_tiles,
            damaged: missing_parts.damaged.into(),
            exact_tiles: missing_parts.exact_tiles,
            of_exact_tiles: missing_parts.of_exact_tiles,
            reserved: [0; 8],
        };
        // SAFETY: the caller passes NULL or a pointer to a variable.
        unsafe { give("missing", missing, found) }
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Reads the whole file, so that decoding several views of it need not read it for each. Decoding one view does not need
/// this; for a small part of a large file it is faster without.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_preload(decoder: *mut ssplat_decoder) -> ssplat_status {
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, |held| held.session.preload()) }
}

/// Decodes view into buffer; view NULL is the whole picture in its own size. Rows come from the top, each of
/// out_width pixels; bytes between rows are not touched. A larger output samples the continuous picture, a smaller
/// one is low-passed. After an error the buffer's contents are unspecified.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_decode(
    decoder: *mut ssplat_decoder,
    view: *const ssplat_view,
    buffer: *const ssplat_buffer,
) -> ssplat_status {
    let work = |held: &mut Decoding| {
        // SAFETY: the caller passes NULL or a pointer to a view.
        let view = unsafe { view.as_ref() }.copied().unwrap_or_default();
        zeros("the view", &view.reserved)?;
        let wanted =
            Wanted { region: [view.x, view.y, view.width, view.height], size: [view.out_width, view.out_height] };
        let view = held.session.view(&wanted)?;
        // SAFETY: the caller passes NULL or a pointer to a buffer.
        let Some(buffer) = (unsafe { buffer.as_ref() }) else { return Err(Failure::parameter("buffer is NULL")) };
        let mut target = Target::new(buffer, [view.width(), view.height()])?;
        let callback = held.callback;
        let mut watch = |done| match callback {
            // SAFETY: the caller set this function and says that it may be called with this pointer.
            Some(Callback { call, user }) => unsafe { call(user, done) == 0 },
            None => true,
        };
        // SAFETY: the caller says that the buffer has the bytes that `Target::new` has counted.
        held.session.draw(&view, target.rows.format, &mut watch, &mut |row| unsafe { target.put(row) })
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Decodes the picture as large as it fits into max_width * max_height with its aspect ratio kept, and never larger than
/// it is, from the file's own thumbnail where that is large enough, which is fast. The size goes to *width and *height,
/// even if the buffer is too small. With buffer NULL only the size is told. The callback is not called.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ssplat_decoder_thumbnail(
    decoder: *mut ssplat_decoder,
    max_width: u32,
    max_height: u32,
    buffer: *const ssplat_buffer,
    width: *mut u32,
    height: *mut u32,
) -> ssplat_status {
    let work = |held: &mut Decoding| {
        let within = [max_width, max_height];
        let size = held.session.thumbnail_size(within)?;
        // SAFETY: the caller passes NULL or a pointer to a variable.
        unsafe { give("width", width, size[0]) }?;
        // SAFETY: the caller passes NULL or a pointer to a variable.
        unsafe { give("height", height, size[1]) }?;
        // SAFETY: the caller passes NULL or a pointer to a buffer.
        let Some(buffer) = (unsafe { buffer.as_ref() }) else { return Ok(()) };
        let mut target = Target::new(buffer, size)?;
        // SAFETY: the caller says that the buffer has the bytes that `Target::new` has counted.
        held.session.thumbnail(within, target.rows.format, &mut |row| unsafe { target.put(row) })
    };
    // SAFETY: the caller passes NULL or a decoder that has not been freed.
    unsafe { enter(decoder, work) }
}

/// Rows of a caller's buffer, which has been found large enough for them.
struct Target {
    rows: Rows,
    data: *mut u8,
    /// Rows that have not been written, and the offset of the first of them.
    left: u32,
    at: usize,
}

impl Target {
    /// Checks that `buffer` holds a picture of `size` pixels.
    fn new(buffer: &ssplat_buffer, size: [u32; 2]) -> Outcome<Self> {
        zeros("the buffer", &buffer.reserved)?;
        if buffer.data.is_null() {
            return Err(Failure::parameter("data of the buffer is NULL"));
        }
        let rows = Rows::new(buffer.format, size, buffer.size, buffer.stride)?;
        Ok(Target { rows, data: buffer.data.cast(), left: rows.count, at: 0 })
    }

    /// Writes the next row.
    ///
    /// # Safety
    /// The memory that the buffer describes may be written.
    unsafe fn put(&mut self, row: &[u8]) {
        assert!(row.len() == self.rows.len && self.left > 0, "a row more than the picture has, or a longer one");
        // SAFETY: `new` has checked that this row, as all `left` ones from `at` on, lies within the buffer.
        let to = unsafe { self.data.add(self.at) };
        // SAFETY: as above; `row` is memory of this library.
        unsafe { ptr::copy_nonoverlapping(row.as_ptr(), to, self.rows.len) };
        self.left -= 1;
        if self.left > 0 {
            self.at += self.rows.stride;
        }
    }
}

/// The path that a string of C names.
#[cfg(unix)]
fn path_of(path: &CStr) -> Outcome<PathBuf> {
    use std::os::unix::ffi::OsStrExt;
    Ok(std::ffi::OsStr::from_bytes(path.to_bytes()).into())
}

/// The path that a string of C names.
#[cfg(not(unix))]
fn path_of(path: &CStr) -> Outcome<PathBuf> {
    path.to_str().map(PathBuf::from).map_err(|e| Failure::parameter(format_args!("path: {e}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_a_status_and_closes_the_file() {
        let mut decoder = ssplat_decoder_new();
        // SAFETY: the decoder has not been freed.
        let status = unsafe { enter(decoder, |_| panic!("on purpose")) };
        assert_eq!(status, ssplat_status::Internal);
        let mut text = [0u8; 64];
        // SAFETY: as above, and the text has that many bytes.
        let length = unsafe { ssplat_decoder_message(decoder, text.as_mut_ptr().cast(), text.len()) };
        assert_eq!(&text[..length], b"internal error: on purpose");
        let mut info = ssplat_info::default();
        // SAFETY: the decoder has not been freed.
        assert_eq!(unsafe { ssplat_decoder_info(decoder, &mut info) }, ssplat_status::Closed);
        // SAFETY: as above.
        assert_eq!(unsafe { ssplat_decoder_free(&mut decoder) }, ssplat_status::Ok);
        assert!(decoder.is_null());
    }
}
