//! Writes valid integers in every layout, reads them back, and writes the same bytes again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use ssplat::Limits;
use ssplat::unstable::bitstream::splats::{PackedGaussian, PackedSplats};
use ssplat::unstable::bitstream::{read, to_bytes};
use ssplat_fuzz::Legal;

/// Sorts the Gaussians: their order within a level is up to the layout.
fn sorted(splats: &PackedSplats) -> Vec<PackedGaussian> {
    let mut gaussians = splats.gaussians.clone();
    gaussians.sort_unstable_by_key(|g| (g.x, g.y, g.major, g.minor, g.angle, g.color));
    gaussians
}

fuzz_target!(|legal: Legal| {
    let splats = legal.0;
    let bytes = match to_bytes(&splats) {
        Ok(bytes) => bytes,
        // A layout with fields of fixed width cannot hold every range of values.
        Err(ssplat::Error::Parameter { .. }) => return,
        Err(e) => panic!("{e}"),
    };
    let again = read(&bytes[..], &Limits::default()).expect("what was written reads back");
    assert_eq!(sorted(&again), sorted(&splats));
    let head = |s: &PackedSplats| (s.width, s.height, s.channels, s.depth, s.blend, s.layout, s.steps, s.background);
    assert_eq!(head(&again), head(&splats));
    assert_eq!(again.metadata, splats.metadata);
    assert_eq!(again.detail, splats.detail);
    assert!(to_bytes(&again).expect("what was read can be written") == bytes, "bytes are not canonical");
});
