//! Reads pictures of the `image` crate within limits: opens a decoder for a reader, and reads the pixels of a decoder.
//!
//! [`DynamicImage::from_decoder`] and [`ImageReader::into_decoder`] do not check the size of the output against the
//! limits, and abort the process if memory runs out.

use std::hint::black_box;
use std::io::{self, BufRead, Read, Seek, SeekFrom};
use std::path::Path;

use image::error::{ImageFormatHint, ParameterError, ParameterErrorKind};
use image::error::{LimitError, LimitErrorKind, UnsupportedError, UnsupportedErrorKind};
use image::{
    ColorType, DynamicImage, ImageBuffer, ImageDecoder, ImageError, ImageFormat, ImageReader, ImageResult, Pixel,
};

use super::overlay::Overlay;
use super::stated::{MAX_PROFILE_BYTES, Stated};

/// Maximum number of bytes that a decoder may allocate, including the samples of the picture. A picture of 177
/// megapixels takes 531 MB with 8 bits per sample, and twice that with 16.
pub const MAX_ALLOC: u64 = if usize::BITS < 64 { 1 << 30 } else { 8 << 30 };

/// Returns the limits for pictures in other formats: [`MAX_ALLOC`] bytes.
pub fn limits() -> image::Limits {
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(MAX_ALLOC);
    limits
}

/// Bytes that the decoder of PNG may allocate besides its rows. It doubles the buffer of a compressed profile, and
/// decompresses the profile within the rest; one that does not fit is lost.
const MAX_PNG_ALLOC: u64 = 3 * MAX_PROFILE_BYTES;

/// Returns a decoder for the picture in `reader`, without the parts that `stated` hides. The format is recognized by
/// its content, or else by the extension of `path`. The bytes of its samples are checked against `limits`, and the
/// decoder may use the rest.
///
/// # Errors
/// [`ImageError::Limits`] if the picture takes more than `limits`; errors of the decoder and of `reader`.
pub fn open<'a, R: BufRead + Seek + 'a>(
    reader: R,
    path: &Path,
    stated: &Stated,
    limits: &image::Limits,
) -> ImageResult<impl ImageDecoder + use<'a, R>> {
    let mut limits = limits.clone();
    let mut reader = ImageReader::new(Overlay::new(reader, stated.hidden.clone())?).with_guessed_format()?;
    if reader.format().is_none()
        && let Ok(format) = ImageFormat::from_path(path)
    {
        // A few formats, such as TGA, cannot be recognized by their content.
        reader.set_format(format);
    }
    let format = reader.format();
    if format == Some(ImageFormat::Jpeg) {
        // Its decoder starts by reading the whole file.
        let mut file = reader.into_inner();
        limits.reserve(file.seek(SeekFrom::End(0))?)?;
        file.rewind()?;
        reader = ImageReader::with_format(file, ImageFormat::Jpeg);
    }
    let mut first = limits.clone();
    if format == Some(ImageFormat::Png) {
        let mut file = reader.into_inner();
        let row = 8 * u64::from(png_width(&mut file)?);
        first.max_alloc = first.max_alloc.map(|most| most.min(MAX_PNG_ALLOC + row));
        reader = ImageReader::with_format(file, ImageFormat::Png);
    }
    reader.limits(first);
    let mut decoder = reader.into_decoder()?;
    let all = limits.clone();
    limits.reserve(decoder.total_bytes())?;
    // The TIFF decoder subtracts the samples itself.
    decoder.set_limits(if format == Some(ImageFormat::Tiff) { all } else { limits })?;
    Ok(decoder)
}

/// Returns the width in the header of a PNG, or 0 if it has none. The reader is rewound.
fn png_width(reader: &mut (impl Read + Seek)) -> io::Result<u32> {
    // The signature, the length and the name of the header chunk, and the width.
    let mut start = Vec::new();
    reader.by_ref().take(20).read_to_end(&mut start)?;
    reader.rewind()?;
    Ok(start.last_chunk().filter(|_| start.len() == 20).map_or(0, |width| u32::from_be_bytes(*width)))
}

/// Decodes a picture whose size has been checked against limits, as [`open`] does.
///
/// # Errors
/// [`ImageError::Limits`] if there is not enough memory for the samples; errors of the decoder.
pub fn picture(decoder: impl ImageDecoder) -> ImageResult<DynamicImage> {
    match decoder.color_type() {
        ColorType::L8 => samples(decoder).map(DynamicImage::ImageLuma8),
        ColorType::La8 => samples(decoder).map(DynamicImage::ImageLumaA8),
        ColorType::Rgb8 => samples(decoder).map(DynamicImage::ImageRgb8),
        ColorType::Rgba8 => samples(decoder).map(DynamicImage::ImageRgba8),
        ColorType::L16 => samples(decoder).map(DynamicImage::ImageLuma16),
        ColorType::La16 => samples(decoder).map(DynamicImage::ImageLumaA16),
        ColorType::Rgb16 => samples(decoder).map(DynamicImage::ImageRgb16),
        ColorType::Rgba16 => samples(decoder).map(DynamicImage::ImageRgba16),
        ColorType::Rgb32F => samples(decoder).map(DynamicImage::ImageRgb32F),
        ColorType::Rgba32F => samples(decoder).map(DynamicImage::ImageRgba32F),
        other => Err(ImageError::Unsupported(UnsupportedError::from_format_and_kind(
            ImageFormatHint::Unknown,
            UnsupportedErrorKind::Color(other.into()),
        ))),
    }
}

/// Returns the samples of a picture with the colour type of `P`.
fn samples<P>(decoder: impl ImageDecoder) -> ImageResult<ImageBuffer<P, Vec<P::Subpixel>>>
where
    P: Pixel,
    P::Subpixel: bytemuck::Pod,
{
    let (width, height) = decoder.dimensions();
    let bytes = usize::try_from(decoder.total_bytes()).map_err(|_| out_of_memory())?;
    let mut samples: Vec<P::Subpixel> = zeros(bytes / size_of::<P::Subpixel>())?;
    decoder.read_image(bytemuck::cast_slice_mut(&mut samples))?;
    ImageBuffer::from_raw(width, height, samples)
        .ok_or_else(|| ImageError::Parameter(ParameterError::from_kind(ParameterErrorKind::DimensionMismatch)))
}

/// Returns zeros in memory that the system provides only when it is written, or an error if there is not enough of it.
fn zeros<T: bytemuck::Pod>(count: usize) -> ImageResult<Vec<T>> {
    // Only `vec!` requests zeroed memory, but it aborts if there is not enough. Reserve the same amount first to find
    // out.
    let mut probe = Vec::<T>::new();
    probe.try_reserve_exact(count).map_err(|_| out_of_memory())?;
    drop(black_box(probe));
    Ok(vec![T::zeroed(); count])
}

fn out_of_memory() -> ImageError {
    ImageError::Limits(LimitError::from_kind(LimitErrorKind::InsufficientMemory))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A decoder that states a size and has no pixels.
    struct StatedSize(u32, ColorType);

    impl ImageDecoder for StatedSize {
        fn dimensions(&self) -> (u32, u32) {
            (self.0, self.0)
        }

        fn color_type(&self) -> ColorType {
            self.1
        }

        fn read_image(self, buf: &mut [u8]) -> ImageResult<()> {
            buf.fill(7);
            Ok(())
        }

        fn read_image_boxed(self: Box<Self>, buf: &mut [u8]) -> ImageResult<()> {
            (*self).read_image(buf)
        }
    }

    #[test]
    fn pictures_that_exceed_the_available_memory_are_refused() {
        // More memory than any machine has.
        assert!(matches!(picture(StatedSize(1 << 30, ColorType::L8)), Err(ImageError::Limits(_))));
    }

    #[test]
    fn all_colour_types_become_pictures() {
        use ColorType as C;
        for color in [C::L8, C::La8, C::Rgb8, C::Rgba8, C::L16, C::La16, C::Rgb16, C::Rgba16, C::Rgb32F, C::Rgba32F] {
            let picture = picture(StatedSize(3, color)).unwrap();
            assert_eq!((picture.color(), picture.width(), picture.as_bytes()[5]), (color, 3, 7));
        }
    }
}
