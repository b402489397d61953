//! Background and codebook as plain bytes, and the index of a colour in the codebook (spec §6.1).

use super::broken::Broken;
use super::bytes::{Bytes, put_varint, unzigzag, zigzag};
use super::rules::MAX_CODEBOOK;
use super::splats::PackedSplats;
use crate::error::{Error, Result};
use crate::parameter::Parameter;

/// Returns the distinct colours of `splats`' codebook in the order of the file.
pub(crate) fn sorted_codebook(splats: &PackedSplats) -> Option<Vec<[i16; 4]>> {
    let mut book = splats.codebook.clone()?;
    book.sort_unstable();
    book.dedup();
    Some(book)
}

/// Returns the index of `color` in a sorted codebook.
///
/// # Errors
/// [`Error::Parameter`] if it is not in the codebook.
pub(crate) fn index_of(book: &[[i16; 4]], color: [i16; 4]) -> Result<u32> {
    book.binary_search(&color).map(|i| i as u32).map_err(|_| Error::Parameter {
        parameter: Parameter::Other("codebook"),
        problem: format!("does not hold the colour {color:?}"),
    })
}

pub(crate) fn put_color(color: &[i16], out: &mut Vec<u8>) {
    for &c in color {
        put_varint(zigzag(c.into()), out);
    }
}

pub(crate) fn read_color(bytes: &mut Bytes<'_>, channels: usize, field: &'static str) -> Result<[i16; 4]> {
    let mut color = [0i16; 4];
    for c in &mut color[..channels] {
        *c = to_i16(field, unzigzag(bytes.varint(field)?))?;
    }
    Ok(color)
}

/// Appends the number of colours and the colours. The first channel is stored as the difference to the previous
/// colour.
pub(crate) fn put_codebook(book: &[[i16; 4]], channels: usize, out: &mut Vec<u8>) {
    put_varint(book.len() as u64, out);
    let mut last = i16::MIN;
    for color in book {
        put_varint((i32::from(color[0]) - i32::from(last)) as u64, out);
        put_color(&color[1..channels], out);
        last = color[0];
    }
}

pub(crate) fn read_codebook(bytes: &mut Bytes<'_>, channels: usize) -> Result<Vec<[i16; 4]>> {
    let count = bytes.varint("codebook size")?;
    if !(1..=MAX_CODEBOOK as u64).contains(&count) {
        return Err(Broken { field: "codebook size", value: count }.into());
    }
    let mut book: Vec<[i16; 4]> = Vec::new();
    let mut first = i64::from(i16::MIN);
    for _ in 0..count {
        first = first.saturating_add(bytes.varint("codebook")? as i64);
        let rest = read_color(bytes, channels - 1, "codebook")?;
        push_ascending(&mut book, [to_i16("codebook", first)?, rest[0], rest[1], rest[2]])?;
    }
    Ok(book)
}

/// Adds a colour, which must come after the last one in order.
pub(crate) fn push_ascending(book: &mut Vec<[i16; 4]>, color: [i16; 4]) -> Result<()> {
    if book.last().is_some_and(|last| *last >= color) {
        return Err(Broken { field: "codebook order", value: book.len() as u64 }.into());
    }
    book.push(color);
    Ok(())
}

pub(crate) fn to_i16(field: &'static str, value: i64) -> Result<i16> {
    i16::try_from(value).map_err(|_| Broken { field, value: value as u64 }.into())
}
