//! Writes integers as the bytes of a file: header, sections, payload, checksum (spec §2).

#[cfg(any(test, feature = "unstable"))]
use std::io::Write;

use super::checksum::{Hasher, hash};
use super::coder::coded;
use super::detail::head::{self, Spans};
use super::detail::index;
use super::exact::head::{self as exact_head, ExactHead};
use super::exact::index as exact_index;
use super::groups;
use super::header::{Grouping, Sections, put_header};
use super::rules::{self, most_gaussians};
use super::sections::{DETAIL, EXACT, put_sections};
use super::splats::{Layout, PackedSplats};
use super::uncoded::{packed, planes};
use crate::error::{Error, Result};
use crate::parameter::Parameter;

/// Writes `splats` in their layout. The Gaussians of a level are sorted into the order of the layout.
///
/// # Errors
/// [`Error::Parameter`] if the integers break spec §4, [`Error::Io`] from the writer.
#[cfg(any(test, feature = "unstable"))]
pub fn write<W: Write>(splats: &PackedSplats, writer: &mut W) -> Result<()> {
    writer.write_all(&to_bytes(splats)?)?;
    Ok(())
}

/// Returns the file of `splats`; see [`write()`].
///
/// # Errors
/// [`Error::Parameter`] if the integers break spec §4.
pub fn to_bytes(splats: &PackedSplats) -> Result<Vec<u8>> {
    rules::check(splats)?;
    let has_layers = splats.detail.is_some() || splats.exact.is_some();
    let has_sections = splats.metadata.sections().next().is_some() || has_layers;
    let sections = if has_sections { Sections::Present } else { Sections::Absent };
    let (mut out, mut checksum) = (Vec::new(), Hasher::new());
    let grouping = groups::grouping(splats);
    put_header(splats, grouping, sections, &mut out);
    checksum.update(&out);
    let header = hash(&out);
    let mut payload = Vec::new();
    match (splats.layout, grouping) {
        (Layout::Packed, _) => packed::put(splats, &mut payload)?,
        (Layout::Planes, _) => planes::put(splats, &mut payload)?,
        (Layout::Coded, Grouping::Single) => coded::put(splats, &mut payload)?,
        (Layout::Coded, Grouping::Groups) => groups::put(splats, header, &mut payload)?,
    }
    let size = [splats.width, splats.height];
    let mut detail = Vec::new();
    if let Some(layer) = &splats.detail {
        index::put(layer, size, splats.channels, &mut detail);
    }
    if has_sections {
        let spans = Spans { payload: payload.len() as u64, checksum: base_checksum(&out, &payload) };
        let exact = splats.exact.as_ref().map(|layer| {
            let head = ExactHead { spans, detail: detail.len() as u64, side: layer.side };
            (EXACT, exact_head::contents(&head))
        });
        let detail = splats.detail.as_ref().map(|layer| (DETAIL, head::contents(&layer.head, spans)));
        let layers: Vec<_> = detail.into_iter().chain(exact).collect();
        put_sections(&splats.metadata, &layers, header, &mut out, &mut checksum);
    }
    let behind = out.len();
    out.extend_from_slice(&payload);
    out.extend_from_slice(&detail);
    if let Some(layer) = &splats.exact {
        exact_index::put(layer, size, splats.channels, splats.depth, &mut out);
    }
    checksum.update(&out[behind..]);
    if splats.gaussians.len() as u64 > most_gaussians(payload.len() as u64) {
        let problem = format!("{} are more than 1024 and 8 a byte", splats.gaussians.len());
        return Err(Error::Parameter { parameter: Parameter::Other("number of Gaussians"), problem });
    }
    out.extend_from_slice(&checksum.finalize().to_le_bytes());
    Ok(out)
}

/// Returns the checksum of the bytes that describe the Gaussians: header and payload.
pub(super) fn base_checksum(header: &[u8], payload: &[u8]) -> u32 {
    let mut hasher = Hasher::new();
    hasher.update(header);
    hasher.update(payload);
    hasher.finalize()
}
