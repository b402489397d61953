//! Whether a JPEG without its end marker still has all of its samples, as pictures do to which a camera appended data
//! instead.

use std::io::{BufRead, Cursor, Read, Seek};
use std::path::Path;

use image::ImageDecoder;
use image::codecs::jpeg::JpegDecoder;
use ssplat::unstable::input::{limits, picture};

use crate::failure::Failure;

/// Bytes behind the file that would be decoded as samples if the file lacked some: two patterns of valid codes.
const FILLERS: [u8; 2] = [0x00, 0x55];

/// Number of these bytes.
const FILLER_BYTES: usize = 1 << 12;

/// Longest file that is examined, in bytes.
const MAX_BYTES: u64 = 1 << 28;

/// Returns whether the JPEG in `input` has all of its samples: it has scans for all coefficients, and its picture does
/// not depend on the bytes that follow. The input is rewound.
pub fn has_all_samples(path: &Path, input: &mut (impl BufRead + Seek)) -> Result<bool, Failure> {
    let io = |e| Failure::io(path, &e);
    let mut file = Vec::new();
    input.by_ref().take(MAX_BYTES + 1).read_to_end(&mut file).map_err(io)?;
    input.rewind().map_err(io)?;
    if file.len() as u64 > MAX_BYTES || !has_all_scans(&file).unwrap_or(false) {
        return Ok(false);
    }
    // Half an end marker.
    while file.last() == Some(&0xFF) {
        file.pop();
    }
    let pictures = FILLERS.map(|filler| {
        let mut with = file.clone();
        with.resize(file.len() + FILLER_BYTES, filler);
        with.extend([0xFF, 0xD9]);
        let mut decoder = JpegDecoder::new(Cursor::new(with)).ok()?;
        let mut bounds = limits();
        bounds.reserve(decoder.total_bytes()).ok()?;
        decoder.set_limits(bounds).ok()?;
        picture(decoder).ok()
    });
    let [Some(one), Some(other)] = pictures else { return Ok(false) };
    Ok(one == other)
}

/// Returns whether the scans of a JPEG cover all bits of all coefficients; `None` if their headers are cut off.
fn has_all_scans(file: &[u8]) -> Option<bool> {
    // For each component, its number and the lowest bit of each coefficient that a scan has.
    let mut components: Vec<(u8, [u8; 64])> = Vec::new();
    let mut at = 2;
    loop {
        at += file.get(at..)?.iter().position(|&byte| byte == 0xFF)? + 1;
        let marker = *file.get(at)?;
        if matches!(marker, 0x00 | 0x01 | 0xD0..=0xD8 | 0xFF) {
            at += usize::from(marker != 0xFF);
            continue;
        }
        let length = usize::from(u16::from_be_bytes(*file.get(at + 1..)?.first_chunk()?));
        let Some(body) = file.get(at + 3..at + 1 + length.max(2)) else { break };
        match marker {
            0xC0..=0xC2 => {
                let count = usize::from(*body.get(5)?);
                components = body.get(6..6 + 3 * count)?.chunks_exact(3).map(|c| (c[0], [u8::MAX; 64])).collect();
            }
            0xDA => {
                let count = usize::from(*body.first()?);
                let names = body.get(1..1 + 2 * count)?;
                let &[first, last, bits] = body.get(1 + 2 * count..)?.first_chunk::<3>()?;
                for name in names.chunks_exact(2).map(|name| name[0]) {
                    let component = components.iter_mut().find(|(number, _)| *number == name)?;
                    component.1.get_mut(first.into()..=last.into())?.fill(bits & 15);
                }
                if components.iter().flat_map(|(_, bits)| bits).all(|&bit| bit == 0) {
                    return Some(true);
                }
            }
            _ => {}
        }
        at += 1 + length;
    }
    Some(false)
}
