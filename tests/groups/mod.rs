//! Round trips of files in groups: the writer chooses the groups, so that primitives are kept, but not bytes.

use ssplat::Limits;
use ssplat::unstable::bitstream::splats::PackedSplats;
use ssplat::unstable::bitstream::{read, to_bytes};

/// Position of the byte with the layout in its lowest bits, and the bit for groups.
const FLAGS: usize = 5;
const IN_GROUPS: u8 = 3;

/// Tells whether a file of the coded layout is in groups.
pub fn is_grouped(bytes: &[u8]) -> bool {
    bytes[FLAGS] & 3 == IN_GROUPS
}

/// Asserts that writing and reading keeps each level's primitives and everything else, and that writing again gives
/// the same bytes.
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
