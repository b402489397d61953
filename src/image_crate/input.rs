//! Pictures of the `image` crate in, within limits: a decoder for a reader, and the pixels of a decoder.
//!
//! [`DynamicImage::from_decoder`] and [`ImageReader::into_decoder`] leave it to their caller to hold the size of the output against the
//! limits, and abort where memory ends.

use std::hint::black_box;
use std::io::{BufRead, Seek, SeekFrom};
use std::path::Path;

use image::error::{ImageFormatHint, ParameterError, ParameterErrorKind};
use image::error::{LimitError, LimitErrorKind, UnsupportedError, UnsupportedErrorKind};
use image::{
    ColorType, DynamicImage, ImageBuffer, ImageDecoder, ImageError, ImageFormat, ImageReader, ImageResult, Pixel,
};

/// Most bytes that a decoder may allocate, the samples of the picture included: a 177-megapixel picture takes 531 MB
/// with 8 bits, twice that with 16.
pub const MAX_ALLOC: u64 = if usize::BITS < 64 { 1 << 30 } else { 8 << 30 };

/// The limits for pictures of other formats: [`MAX_ALLOC`] bytes.
pub fn limits() -> image::Limits {
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(MAX_ALLOC);
    limits
}

/// Returns a decoder for the picture in `reader`, whose format is told by its content or else by the extension of
/// `path`. The bytes of its samples are held against `limits`, and the rest of them is the decoder's.
///
/// # Errors
/// [`ImageError::Limits`] when the picture takes more than `limits`; those of the decoder, and of `reader`.
pub fn open<'a, R: BufRead + Seek + 'a>(
    reader: R,
    path: &Path,
    limits: &image::Limits,
) -> ImageResult<impl ImageDecoder + use<'a, R>> {
    let mut limits = limits.clone();
    let mut reader = ImageReader::new(reader).with_guessed_format()?;
    if reader.format().is_none()
        && let Ok(format) = ImageFormat::from_path(path)
    {
        // A few formats (TGA) cannot be told by their content.
        reader.set_format(format);
    }
    let format = reader.format();
    if format == Some(ImageFormat::Jpeg) {
        // Its decoder begins with reading all of the file.
        let mut file = reader.into_inner();
        limits.reserve(file.seek(SeekFrom::End(0))?)?;
        file.rewind()?;
        reader = ImageReader::with_format(file, ImageFormat::Jpeg);
    }
    reader.limits(limits.clone());
    let mut decoder = reader.into_decoder()?;
    let all = limits.clone();
    limits.reserve(decoder.total_bytes())?;
    // The decoder of TIFF takes the samples off by itself.
    decoder.set_limits(if format == Some(ImageFormat::Tiff) { all } else { limits })?;
    Ok(decoder)
}

/// Decodes a picture whose size has been held against limits, as [`open`] does.
///
/// # Errors
/// [`ImageError::Limits`] when there is too little memory for the samples; those of the decoder.
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

/// The samples of a picture whose colour type is that of `P`.
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

/// Zeros, in memory that takes no room until it is written; an error where there is too little.
fn zeros<T: bytemuck::Pod>(count: usize) -> ImageResult<Vec<T>> {
    // Only `vec!` asks for memory that is zero already, and it aborts where there is none. So ask for as much before.
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

    /// Says that it has such a size, and no pixels.
    struct Said(u32, ColorType);

    impl ImageDecoder for Said {
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
    fn pictures_beyond_the_memory_that_is_there_are_refused() {
        // More than any machine has.
        assert!(matches!(picture(Said(1 << 30, ColorType::L8)), Err(ImageError::Limits(_))));
    }

    #[test]
    fn all_colour_types_become_pictures() {
        use ColorType as C;
        for color in [C::L8, C::La8, C::Rgb8, C::Rgba8, C::L16, C::La16, C::Rgb16, C::Rgba16, C::Rgb32F, C::Rgba32F] {
            let picture = picture(Said(3, color)).unwrap();
            assert_eq!((picture.color(), picture.width(), picture.as_bytes()[5]), (color, 3, 7));
        }
    }
}
