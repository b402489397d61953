//! Reads AVIF: the boxes by mp4parse, AV1 by re_rav1d, and colours by [`ycbcr`](crate::ycbcr).

use std::io::{self, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

use exif::Error as ExifError;
use image::metadata::Orientation;
use mp4parse::{AvifContext, ImageRotation, ParseStrictness, read_avif};
use re_rav1d::dav1d::{Decoder, Error, Picture, Settings};

use crate::failure::{Failure, Kind};
use crate::input::Input;
use crate::limits::beyond_memory;
use crate::source::{self, Decoded};
use crate::ycbcr::{self, Ycbcr};

/// Maximum number of pixels: up to 16 bytes for each of them are in memory at a time.
const MAX_PIXELS: u32 = 1 << 27;

/// What to do about files that are not supported.
const CONVERT: &str = "convert it first, with `avifdec IN.avif OUT.png`";

/// Decodes the AVIF file in `input`, which came from `path`.
///
/// # Errors
///
/// Damaged files ([`Kind::Format`]); grids of pictures, animations without a still picture, and matrices of colours that
/// [`ycbcr`] does not know ([`Kind::Unsupported`] or [`Kind::Format`]); pictures of more than 2²⁷ pixels, and failed
/// allocations ([`Kind::Limit`]).
pub fn read(path: &Path, input: &mut Input) -> Result<Decoded, Failure> {
    let name = Failure::input(path);
    let failure = |kind, what: &str| Failure { kind, message: format!("{name}: {what}") };
    let broken = |what: String| failure(Kind::Format, &format!("Format error decoding AVIF: {what}"));
    let file = read_avif(&mut *input, ParseStrictness::Normal).map_err(|e| match e {
        mp4parse::Error::Unsupported(what) => {
            failure(Kind::Unsupported, &format!("AVIF of a kind that is not supported ({what}); {CONVERT}"))
        }
        e => broken(format!("{e:?}")),
    })?;
    input.rewind().map_err(|e| Failure::io(path, &e))?;
    let meta = meta_box(input).map_err(|e| Failure::io(path, &e))?;
    let orientation = orientation(&file, &meta).map_err(&broken)?;
    let decoded = |data: &[u8]| {
        first_picture(data).map_err(|e| match e {
            // The type of this error is private to re_rav1d.
            Error::UnknownError(e) if format!("{e:?}") == "ERANGE" => {
                failure(Kind::Limit, &format!("has more than {MAX_PIXELS} pixels"))
            }
            Error::NotEnoughMemory => Failure { kind: Kind::Limit, message: beyond_memory(path) },
            Error::Again => broken("no picture in its data".into()),
            e => broken(e.to_string()),
        })
    };
    let [color_data, alpha_data] =
        [file.primary_item_coded_data(), file.alpha_item_coded_data()].map(Option::unwrap_or_default);
    // mp4parse leaves out items with essential properties that it does not know.
    if color_data.is_empty() {
        let what = if file.sequence.is_some() {
            "is an animation without a still picture"
        } else {
            "is a grid of pictures, is cropped, or selects one of several layers"
        };
        return Err(failure(Kind::Unsupported, &format!("{what}, which is not supported; {CONVERT}")));
    }
    let colors = decoded(color_data)?;
    let has_alpha = !alpha_data.is_empty();
    let alpha = if has_alpha { Some(decoded(alpha_data)?) } else { None };
    let sides = |p: &Picture| (p.width(), p.height(), p.bit_depth());
    if alpha.as_ref().is_some_and(|alpha| sides(alpha) != sides(&colors)) {
        return Err(broken("alpha and colours differ in size or depth".into()));
    }
    // The box takes precedence over AV1 (MIAF, 7.3.6.4).
    let stated = file.nclx_colour_information_ptr().and_then(|_| code_points(&meta));
    let (matrix, is_full_range) = match stated {
        Some([_, _, matrix, range]) => (matrix, range != 0),
        // The numbers of AV1 are those of ITU-T H.273.
        None => (colors.matrix_coefficients() as u8, ycbcr::is_full_range(&colors)),
    };
    let of_av1 = [colors.color_primaries() as u8, colors.transfer_characteristic() as u8];
    let planes =
        Ycbcr { colors, alpha, matrix, is_full_range, is_premultiplied: has_alpha && file.premultiplied_alpha };
    let picture = planes.to_picture().map_err(|e| match e {
        ycbcr::Error::Memory => Failure { kind: Kind::Limit, message: beyond_memory(path) },
        ycbcr::Error::Matrix(matrix) => {
            failure(Kind::Unsupported, &format!("its matrix of colours, {matrix} of ITU-T H.273, is not supported"))
        }
    })?;
    let icc = file.icc_colour_information().transpose().map_err(|e| broken(format!("{e:?}")))?.map(<[u8]>::to_vec);
    let [primaries, transfer] = stated.map_or(of_av1, |[primaries, transfer, ..]| [primaries, transfer]);
    let code_points = Some([primaries, transfer, 0, 1]);
    let mut notes = Vec::new();
    if file.sequence.is_some() {
        notes.push("only the first of its frames or pages is used".into());
    }
    let exif = exif(input).unwrap_or_else(|why| {
        notes.push(format!("its EXIF block is damaged and left out: {why}"));
        None
    });
    let states = |what: &[u8]| meta.windows(what.len()).any(|bytes| bytes == what);
    if states(b"application/rdf+xml\0") {
        notes.push("its XMP block is left out".into());
    }
    // The item that a gain map is applied by (ISO 23008-12).
    if states(b"tmap") {
        notes.push("its gain map is left out; the picture is its base".into());
    }
    Ok(Decoded { picture, orientation, code_points, icc, exif, notes })
}

/// Returns the EXIF block, without the orientation, which `irot` and `imir` state instead (MIAF, 7.3.10).
fn exif(input: &mut Input) -> Result<Option<Vec<u8>>, ExifError> {
    input.rewind()?;
    match exif::Reader::new().read_from_container(input) {
        Ok(found) => {
            let mut block = Some(found.buf().to_vec());
            source::forget_orientation(&mut block);
            Ok(block)
        }
        Err(ExifError::NotFound(_)) => Ok(None),
        Err(e) => Err(e),
    }
}

/// Returns the start of the `meta` box, in which mp4parse leaves some properties behind pointers.
fn meta_box(input: &mut Input) -> io::Result<Vec<u8>> {
    /// Bytes of the box that are searched.
    const SEARCHED: u64 = 1 << 16;
    let mut at = 0;
    loop {
        input.seek(SeekFrom::Start(at))?;
        let mut head = [0; 8];
        match input.read_exact(&mut head) {
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => return Ok(Vec::new()),
            read => read?,
        }
        let length = u64::from(u32::from_be_bytes([head[0], head[1], head[2], head[3]]));
        if &head[4..] == b"meta" {
            let mut meta = Vec::new();
            input.take(length.saturating_sub(8).min(SEARCHED)).read_to_end(&mut meta)?;
            return Ok(meta);
        }
        // Boxes of 64-bit lengths, and up to the end of the file, do not precede `meta`.
        if length < 8 {
            return Ok(Vec::new());
        }
        at += length;
    }
}

/// Returns the code points of the first `colr` box that has them: primaries, transfer characteristics, matrix, and
/// whether the range is full.
fn code_points(meta: &[u8]) -> Option<[u8; 4]> {
    let found = meta.windows(15).find(|bytes| bytes.starts_with(b"colrnclx"))?;
    // 16 bits each, of which ITU-T H.273 uses 8.
    let [.., 0, primaries, 0, transfer, 0, matrix, range] = *found else { return None };
    Some([primaries, transfer, matrix, range >> 7])
}

/// Returns the rotation (`irot`) and the reflection after it (`imir`).
fn orientation(file: &AvifContext, meta: &[u8]) -> Result<Orientation, String> {
    // Anticlockwise here, clockwise in EXIF.
    let quarters = match file.image_rotation().map_err(|e| format!("{e:?}"))? {
        ImageRotation::D0 => 0,
        ImageRotation::D90 => 3,
        ImageRotation::D180 => 2,
        ImageRotation::D270 => 1,
    };
    if file.image_mirror_ptr().map_err(|e| format!("{e:?}"))?.is_null() {
        return Ok([Orientation::NoTransforms, Orientation::Rotate90, Orientation::Rotate180, Orientation::Rotate270]
            [quarters]);
    }
    let mirror = meta.windows(9).find(|bytes| bytes.starts_with(b"\0\0\0\x09imir")).ok_or("no imir box")?;
    // Exchanging top and bottom (0) is half a turn before exchanging left and right (1).
    let turns = if mirror[8] & 1 == 0 { quarters + 2 } else { quarters };
    Ok([
        Orientation::FlipHorizontal,
        Orientation::Rotate90FlipH,
        Orientation::FlipVertical,
        Orientation::Rotate270FlipH,
    ][turns % 4])
}

/// Decodes the first picture of AV1 data. [`Error::Again`] means that there is none.
fn first_picture(data: &[u8]) -> Result<Picture, Error> {
    let mut settings = Settings::new();
    settings.set_frame_size_limit(MAX_PIXELS);
    settings.set_max_frame_delay(1);
    // With its own threads, a failure in one of them could leave the others waiting.
    settings.set_n_threads(1);
    // Of several spatial layers, the largest.
    settings.set_all_layers(false);
    let mut decoder = Decoder::with_settings(&settings)?;
    decoder.send_data(data.to_vec(), None, None, None)?;
    match decoder.get_picture() {
        // The second call says that there is no more data: a larger layer may be missing.
        Err(Error::Again) => decoder.get_picture(),
        picture => picture,
    }
}
