//! Files in groups, where the writer chooses what stays undivided: the same primitives, but not the same bytes.

use ssplat::Limits;
use ssplat::unstable::bitstream::splats::PackedSplats;
use ssplat::unstable::bitstream::{read, to_bytes};

/// The byte with the layout in its lowest bits, and the value of groups.
const FLAGS: usize = 5;
const IN_GROUPS: u8 = 3;

/// Whether a file of the coded layout is in groups.
pub fn is_grouped(bytes: &[u8]) -> bool {
    bytes[FLAGS] & 3 == IN_GROUPS
}

/// Written and read again, each level has the same primitives and all else is the same; written again, so are the bytes.
pub fn assert_kept(splats: &PackedSplats, limits: &Limits, name: &str) {
    let again = to_bytes(splats).unwrap();
    let reread = read(&again[..], limits).unwrap();
    assert_eq!(sorted(&reread), sorted(splats), "{name}");
    assert!(to_bytes(&reread).unwrap() == again, "{name} is written in two ways");
}

fn sorted(splats: &PackedSplats) -> PackedSplats {
    let mut sorted = splats.clone();
    let mut rest = &mut sorted.gaussians[..];
    let levels = if splats.levels.is_empty() { vec![rest.len() as u32] } else { splats.levels.clone() };
    for n in levels {
        let (level, tail) = rest.split_at_mut(n as usize);
        level.sort_unstable_by_key(|p| (p.x, p.y, p.major, p.minor, p.angle, p.color));
        rest = tail;
    }
    sorted
}
