//! Pictures of floating-point samples: they are read as encoded values from 0 to 1, and others are reported.

use std::path::Path;

use image::DynamicImage;

use crate::failure::{Failure, Kind};

/// Share of the samples outside 0 to 1 above which a grey picture is refused: it holds heights, depths or other data.
const MAX_OUTSIDE: f64 = 0.5;

/// Rounding of samples that does not count as outside.
const TOLERANCE: f32 = 1e-3;

/// Statistics of floating-point samples.
#[derive(Debug, Default)]
pub struct Range {
    count: u64,
    outside: u64,
    not_numbers: u64,
    least: f32,
    most: f32,
}

impl Range {
    pub fn of(samples: impl Iterator<Item = f32>) -> Range {
        let mut range = Range { least: f32::INFINITY, most: f32::NEG_INFINITY, ..Range::default() };
        for sample in samples {
            range.count += 1;
            if sample.is_finite() {
                range.outside += u64::from(!(-TOLERANCE..=1.0 + TOLERANCE).contains(&sample));
                (range.least, range.most) = (range.least.min(sample), range.most.max(sample));
            } else {
                range.not_numbers += 1;
            }
        }
        range
    }

    /// Returns a note if samples are clipped.
    ///
    /// # Errors
    /// An unsupported picture, if samples are not finite, or if it is grey and most of them are outside 0 to 1.
    pub fn check(&self, path: &Path, is_grey: bool) -> Result<Option<String>, Failure> {
        let Range { count, outside, not_numbers, least, most } = *self;
        let refused = |what: String| {
            let message = format!(
                "{}: {what}: scale it to 0..1 or to 16 bits first, for example with \
                 `gdal_translate -scale -ot UInt16 IN.tif OUT.png` or ImageMagick's `convert IN.tif -auto-level -depth 16 OUT.png`",
                Failure::input(path)
            );
            Err(Failure { kind: Kind::Unsupported, message })
        };
        if not_numbers > 0 {
            return refused(format!("{not_numbers} of its {count} floating-point samples are not finite numbers"));
        }
        if is_grey && outside as f64 > MAX_OUTSIDE * count as f64 {
            return refused(format!("most of its floating-point samples, {least} to {most}, are outside 0 to 1"));
        }
        Ok((outside > 0).then(|| {
            format!(
                "{outside} of its {count} floating-point samples, which reach from {least} to {most}, are clipped to 0..1; scale them first to keep them"
            )
        }))
    }
}

/// Checks the samples of a picture, if they are floating-point numbers.
///
/// # Errors
/// As for [`Range::check`].
pub fn check(path: &Path, picture: &DynamicImage) -> Result<Option<String>, Failure> {
    match picture {
        DynamicImage::ImageRgb32F(picture) => Range::of(picture.iter().copied()).check(path, false),
        DynamicImage::ImageRgba32F(picture) => Range::of(picture.iter().copied()).check(path, false),
        _ => Ok(None),
    }
}
