//! A picture drawn small, from the thumbnail that its file carries where that is large enough.

use super::Decoded;
use super::reader::Reader;
use crate::bitstream::Missing;
use crate::error::Result;
use crate::limits::Limits;
use crate::options::Damage;

/// Draws the picture of the file `bytes` as large as it fits into `within`, width and height in pixels, and never larger than
/// it is.
///
/// Where the file carries a thumbnail of at least this size, that is drawn and nothing else is read: in half a millisecond
/// whatever the picture's size, and with its own error, which is larger than that of the picture. Where it carries none that
/// can be used, the picture is drawn as [`decode()`](super::decode()) does. The picture's ICC profile and EXIF block go with
/// both.
///
/// # Errors
/// As [`decode()`](super::decode()); [`Error::Parameter`](crate::Error::Parameter) when a side of `within` is 0.
pub fn thumbnail(bytes: &[u8], within: [u32; 2], limits: &Limits) -> Result<Decoded> {
    let opening = Reader::new(bytes, limits)?;
    let view = opening.view().fitted(within)?;
    if let Some(small) = from_thumbnail(&opening, [view.width(), view.height()], limits)? {
        return Ok(small);
    }
    let opened = opening.read_for(&view, Damage::Refuse)?;
    let (pixels, missing) = (opened.draw(&view)?, opened.missing());
    Ok(Decoded { pixels, metadata: opened.into_metadata(), missing })
}

/// Returns the file's thumbnail drawn in `size`, if it is one of this picture and large enough. One that is not, or cannot be
/// read, is as if it were not there.
fn from_thumbnail(opening: &Reader<'_>, [width, height]: [u32; 2], limits: &Limits) -> Result<Option<Decoded>> {
    let mut metadata = opening.metadata()?;
    // All of it is held beside what it takes to draw.
    let carried: usize = metadata.sections().map(|(_, contents)| contents.len()).sum();
    let limits = Limits { alloc: limits.alloc.saturating_sub(carried as u64), ..limits.clone() };
    let Some(file) = metadata.thumbnail.take() else { return Ok(None) };
    let draw = || {
        let small = Reader::new(&file, &limits).ok()?;
        let (of, is) = (opening.header(), small.header());
        let is_alike = (is.channels, is.depth) == (of.channels, of.depth);
        if !is_alike || is.width < width || is.height < height {
            return None;
        }
        let view = small.view().resized(width, height).ok()?;
        small.read_for(&view, Damage::Refuse).ok()?.draw(&view).ok()
    };
    Ok(draw().map(|pixels| Decoded { pixels, metadata, missing: Missing::default() }))
}
