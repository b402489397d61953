//! What the AVIF decoder of `image` lacks: a limit on the size, an end where the data hold no picture, the rotation of the
//! file, and pictures without the alpha channel and the colours that it adds.

use std::io::{self, ErrorKind, Read, Seek, SeekFrom};
use std::path::Path;

use dav1d::{Decoder, Error, Picture, PixelLayout, Settings};
use image::DynamicImage;
use image::metadata::Orientation;
use mp4parse::{ImageRotation, ParseStrictness, read_avif};

use crate::failure::{Failure, Kind};
use crate::input::Input;
use crate::limits::beyond_memory;

/// Maximum number of pixels: up to 32 bytes for each of them are in memory at a time.
const MAX_PIXELS: u32 = 1 << 27;

/// What dav1d returns for a frame beyond the limit: ERANGE.
const TOO_LARGE: Error = Error::UnknownError(-34);

/// What a file states about its picture.
pub struct Stated {
    pub orientation: Orientation,
    /// Primaries, transfer characteristics, matrix coefficients (0, because the pixels are RGB) and full range (1), by
    /// ITU-T H.273.
    pub code_points: Option<[u8; 4]>,
    has_alpha: bool,
    pub is_grey: bool,
}

/// Decodes the picture once and drops it, so that a file on which the decoder of `image` would take too much memory, or never
/// return, is an error. Rewinds the input.
pub fn look(path: &Path, input: &mut Input) -> Result<Stated, Failure> {
    let name = Failure::input(path);
    let broken =
        |what: String| Failure { kind: Kind::Format, message: format!("{name}: Format error decoding Avif: {what}") };
    let file = read_avif(&mut *input, ParseStrictness::Normal).map_err(|e| broken(format!("{e:?}")))?;
    input.rewind().map_err(|e| Failure::io(path, &e))?;
    let code_points = code_points(input).map_err(|e| Failure::io(path, &e))?;
    input.rewind().map_err(|e| Failure::io(path, &e))?;
    if !file.image_mirror_ptr().is_ok_and(|mirror| mirror.is_null()) {
        let message = format!(
            "{name}: is a mirrored AVIF file, which is not read: convert it first, with `avifdec IN.avif OUT.png`"
        );
        return Err(Failure { kind: Kind::Unsupported, message });
    }
    let orientation = match file.image_rotation() {
        Ok(ImageRotation::D0) => Orientation::NoTransforms,
        // Anticlockwise here, clockwise in EXIF.
        Ok(ImageRotation::D90) => Orientation::Rotate270,
        Ok(ImageRotation::D180) => Orientation::Rotate180,
        Ok(ImageRotation::D270) => Orientation::Rotate90,
        Err(e) => return Err(broken(format!("{e:?}"))),
    };
    let failed = |e| match e {
        TOO_LARGE => Failure { kind: Kind::Limit, message: format!("{name}: has more than {MAX_PIXELS} pixels") },
        Error::NotEnoughMemory => Failure { kind: Kind::Limit, message: beyond_memory(path) },
        Error::Again => broken("no picture in its data".into()),
        e => broken(e.to_string()),
    };
    let picture = |data: Option<&[u8]>| first_picture(data.unwrap_or_default()).map_err(failed);
    let colours = picture(file.primary_item_coded_data())?;
    let has_alpha = !file.alpha_item_coded_data().unwrap_or_default().is_empty();
    if has_alpha {
        let alpha = picture(file.alpha_item_coded_data())?;
        let sides = |p: &Picture| (p.width(), p.height(), p.bit_depth());
        if sides(&alpha) != sides(&colours) {
            return Err(broken("alpha and colours differ in size or depth".into()));
        }
    }
    let is_grey = colours.pixel_layout() == PixelLayout::I400;
    Ok(Stated { orientation, code_points, has_alpha, is_grey })
}

/// Finds the first `colr` box with code points (`nclx`) in the `meta` box, which mp4parse returns only as a pointer. The
/// pixels are converted to RGB of full range, so matrix and range are not those of the file.
fn code_points(input: &mut Input) -> io::Result<Option<[u8; 4]>> {
    /// Bytes of the `meta` box that are searched.
    const SEARCHED: u64 = 1 << 16;
    let mut at = 0;
    loop {
        input.seek(SeekFrom::Start(at))?;
        let mut head = [0; 8];
        match input.read_exact(&mut head) {
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => return Ok(None),
            read => read?,
        }
        let length = u64::from(u32::from_be_bytes([head[0], head[1], head[2], head[3]]));
        if &head[4..] == b"meta" {
            let mut meta = Vec::new();
            input.take(length.saturating_sub(8).min(SEARCHED)).read_to_end(&mut meta)?;
            let found = meta.windows(12).find(|bytes| bytes.starts_with(b"colrnclx"));
            // 16 bits each, of which ITU-T H.273 uses 8.
            return Ok(found.filter(|f| f[8] == 0 && f[10] == 0).map(|found| [found[9], found[11], 0, 1]));
        }
        // Boxes of 64-bit lengths, and up to the end of the file, do not precede `meta`.
        if length < 8 {
            return Ok(None);
        }
        at += length;
    }
}

/// Decodes the first picture of AV1 data. [`Error::Again`] means that there is none, for which the decoder of `image` would wait.
fn first_picture(data: &[u8]) -> Result<Picture, Error> {
    let mut settings = Settings::new();
    settings.set_frame_size_limit(MAX_PIXELS);
    settings.set_max_frame_delay(1);
    let mut decoder = Decoder::with_settings(&settings)?;
    decoder.send_data(data.to_vec(), None, None, None)?;
    decoder.get_picture()
}

impl Stated {
    /// Removes the channels of `picture` that the file does not have.
    pub fn own_channels(&self, picture: DynamicImage) -> DynamicImage {
        let is_deep = matches!(picture, DynamicImage::ImageRgba16(_));
        match (self.is_grey, self.has_alpha, is_deep) {
            (true, true, true) => picture.into_luma_alpha16().into(),
            (true, true, false) => picture.into_luma_alpha8().into(),
            (true, false, true) => picture.into_luma16().into(),
            (true, false, false) => picture.into_luma8().into(),
            (false, false, true) => picture.into_rgb16().into(),
            (false, false, false) => picture.into_rgb8().into(),
            (false, true, _) => picture,
        }
    }
}
