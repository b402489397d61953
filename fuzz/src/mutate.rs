//! Mutations that pass checksums: bytes are changed as the fuzzer likes and the checksums corrected, or the integers
//! of a valid file are changed and written again.

use std::sync::Arc;

use libfuzzer_sys::fuzzer_mutate;
use ssplat::unstable::bitstream::header::{Header, Sections};
use ssplat::unstable::bitstream::splats::{Layout, PackedSplats};
use ssplat::unstable::bitstream::{ExactLayer, read, to_bytes};
use ssplat::{Cicp, Depth, Error, FormatError, Pixels, Samples};

use crate::{Levels, layer, tight_limits};

/// Maximum number of checksums that are corrected in a file: one for each group, and each time those of the directory
/// and the file.
const MAX_SEALS: usize = 64;

/// Changes the first `size` bytes of `data`, which has room for `max`, and returns the new size.
pub fn mutate(data: &mut [u8], size: usize, max: usize, seed: u32) -> usize {
    let mut random = Random(seed.into());
    if random.below(4) == 0
        && let Ok(mut splats) = read(&data[..size], &tight_limits())
    {
        change(&mut splats, &mut random);
        if let Ok(bytes) = to_bytes(&splats)
            && bytes.len() <= max
        {
            data[..bytes.len()].copy_from_slice(&bytes);
            return bytes.len();
        }
    }
    let size = fuzzer_mutate(data, size, max);
    // A few stay wrong, to test how a reader handles wrong checksums.
    if random.below(16) > 0 {
        seal(&mut data[..size]);
    }
    size
}

/// Sets the checksums of sections, detail layer, file, directory and groups to the values that a reader computes.
pub fn seal(bytes: &mut [u8]) {
    layer::mend(bytes);
    seal_sections(bytes);
    for _ in 0..MAX_SEALS {
        let Err(Error::Format(FormatError::Checksum { stored, computed, .. })) = read(&*bytes, &tight_limits()) else {
            return;
        };
        let Some(at) = bytes.windows(4).rposition(|w| w == stored.to_le_bytes()) else { return };
        bytes[at..at + 4].copy_from_slice(&computed.to_le_bytes());
    }
}

/// A reader skips sections with a wrong checksum without an error, so this function finds their positions itself.
fn seal_sections(bytes: &mut [u8]) {
    let mut rest = &*bytes;
    match Header::read(&mut rest, &tight_limits()) {
        Ok(header) if header.sections == Sections::Present => {}
        _ => return,
    }
    let mut at = bytes.len() - rest.len();
    let header = crc32fast::hash(&bytes[..at]).to_le_bytes();
    let Some(count) = varint(bytes, &mut at) else { return };
    for _ in 0..count {
        let name = at;
        at += 4;
        let Some(length) = varint(bytes, &mut at) else { return };
        let Some(contents) = bytes.get(at + 4..).and_then(|b| b.get(..usize::try_from(length).ok()?)) else { return };
        let checksum = crc32fast::hash(&[&header, &bytes[name..name + 4], contents].concat());
        let end = at + 4 + contents.len();
        bytes[at..at + 4].copy_from_slice(&checksum.to_le_bytes());
        at = end;
    }
}

fn varint(bytes: &[u8], at: &mut usize) -> Option<u64> {
    let mut value = 0;
    for shift in (0..63).step_by(7) {
        let byte = *bytes.get(*at)?;
        *at += 1;
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}

/// Returns an exact layer with random glyphs on flat ground and a random mask.
fn exact(splats: &PackedSplats, random: &mut Random) -> Option<Arc<ExactLayer>> {
    let (size, count) = ([splats.width, splats.height], splats.channels.count());
    let pixels = u64::from(size[0]) * u64::from(size[1]);
    if pixels > 1 << 14 {
        return None;
    }
    let colors: Vec<u16> = (0..8).map(|_| random.next() as u16).collect();
    let noise = 1 + random.below(40);
    let samples: Vec<u16> = (0..pixels as usize * count)
        .map(|_| if random.below(noise) == 0 { random.next() as u16 } else { colors[random.below(8) / 7] })
        .collect();
    let samples = match splats.depth {
        Depth::Eight => Samples::U8(samples.iter().map(|&v| v as u8).collect()),
        Depth::Sixteen => Samples::U16(samples),
    };
    let pixels = Pixels::new(size[0], size[1], splats.channels, samples).ok()?;
    let (side, holes) = (5 + random.below(7) as u8, random.next() | 1);
    let whole = random.below(2) == 0;
    let is_covered = |x: usize, y: usize| whole || holes >> ((x / 8 * 7 + y / 8) % 64) & 1 == 1;
    Some(Arc::new(ExactLayer::of(&pixels, side, is_covered)))
}

/// Changes some of the integers. The writer refuses those that violate a rule.
fn change(splats: &mut PackedSplats, random: &mut Random) {
    for _ in 0..1 + random.below(3) {
        let count = splats.gaussians.len();
        match random.below(10) {
            0 => splats.layout = [Layout::Packed, Layout::Planes, Layout::Coded][random.below(3)],
            1 => {
                let profile = vec![random.next() as u8; random.below(40)];
                // No more random numbers, so that seeds keep their meaning.
                splats.metadata.cicp = (profile.len() % 2 == 0).then_some(Cicp::BT2100_PQ);
                splats.metadata.icc = Some(profile);
            }
            2 if count > 0 => {
                splats.gaussians.truncate(random.below(count));
                splats.levels.clear();
            }
            3 if count > 0 && count < 2000 => {
                splats.gaussians.extend_from_within(random.below(count)..);
                splats.levels.clear();
            }
            // Two levels require groups.
            4 if count > 1 => {
                let first = 1 + random.below(count - 1);
                splats.levels = vec![first as u32, (count - first) as u32];
            }
            5 => splats.background[random.below(splats.channels.count())] = random.next() as i16,
            6 => splats.codebook = None,
            7 => splats.detail = Levels::layer(random.next(), [splats.width, splats.height], splats.channels),
            8 => splats.exact = exact(splats, random),
            _ if count > 0 => {
                let at = random.below(count);
                let p = &mut splats.gaussians[at];
                match random.below(4) {
                    0 => (p.x, p.y) = (p.x >> random.below(8), p.y >> random.below(8)),
                    1 => p.major = p.major.saturating_add(random.below(40) as u8),
                    2 => p.angle = 0,
                    _ => p.color[random.below(splats.channels.count())] = random.next() as i16,
                }
            }
            _ => {}
        }
    }
}

/// Splitmix64.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Random(seed)
    }

    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// Returns a number below `n`, which must not be 0.
    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }
}
