//! Renders a picture at a small size, from the thumbnail in its file if that is large enough.

use super::Decoded;
use super::reader::Reader;
use crate::bitstream::MissingParts;
use crate::error::Result;
use crate::limits::Limits;
use crate::options::Damage;

/// Renders the picture at the largest size that fits into `within`. See [`Reader::thumbnail`].
pub(super) fn thumbnail(opening: &Reader<'_>, within: [u32; 2], damage: Damage) -> Result<Decoded> {
    let view = opening.view().fitted(within)?;
    if let Some(small) = from_thumbnail(opening, [view.width(), view.height()])? {
        return Ok(small);
    }
    let opened = opening.read_for(&view, damage)?;
    let (pixels, missing) = (opened.render(&view)?, opened.missing());
    Ok(Decoded { pixels, metadata: opened.into_metadata(), missing })
}

/// Returns the file's thumbnail, rendered at `size`, if it belongs to this picture and is large enough. A thumbnail
/// that does not belong to the picture or cannot be read is ignored.
fn from_thumbnail(opening: &Reader<'_>, [width, height]: [u32; 2]) -> Result<Option<Decoded>> {
    let mut metadata = opening.metadata()?;
    // All metadata stay in memory while the thumbnail is rendered.
    let carried: usize = metadata.sections().map(|(_, contents)| contents.len()).sum();
    let limits = opening.limits();
    let limits = Limits { alloc: limits.alloc.saturating_sub(carried as u64), ..limits.clone() };
    let Some(file) = metadata.thumbnail.take() else { return Ok(None) };
    let draw = || {
        let small = Reader::new(&file, &limits).ok()?;
        let (of, is) = (&opening.header, &small.header);
        let is_alike = (is.channels, is.depth) == (of.channels, of.depth);
        if !is_alike || is.width < width || is.height < height {
            return None;
        }
        let view = small.view().resized(width, height).ok()?;
        small.read_for(&view, Damage::Refuse).ok()?.render(&view).ok()
    };
    Ok(draw().map(|pixels| Decoded { pixels, metadata, missing: MissingParts::default() }))
}
