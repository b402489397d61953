//! Decodes any bytes as the payload of the coded layout after a valid header: the result is an error, or integers that
//! encode to the same bytes.
#![no_main]

use arbitrary::Arbitrary;
use libfuzzer_sys::fuzz_target;
use ssplat::unstable::bitstream::header::Header;
use ssplat::unstable::bitstream::splats::{Layout, PackedGaussian};
use ssplat::unstable::bitstream::{read, to_bytes};
use ssplat_fuzz::{Head, tight_limits};

/// The remaining fuzzed bytes are the payload.
#[derive(Debug, Arbitrary)]
struct Input<'a> {
    head: Head,
    count: u8,
    payload: &'a [u8],
}

fuzz_target!(|input: Input| {
    let (limits, mut splats) = (tight_limits(), input.head.0);
    splats.layout = Layout::Coded;
    // The Gaussians only set the count in the header.
    let color = splats.codebook.as_ref().map_or([0; 4], |book| book[0]);
    splats.gaussians = vec![PackedGaussian { color, ..PackedGaussian::default() }; input.count.into()];
    let Ok(mut bytes) = to_bytes(&splats) else { return };
    let mut rest = &bytes[..];
    Header::read(&mut rest, &limits).expect("what was written has a sound header");
    let head = bytes.len() - rest.len();
    bytes.truncate(head);
    bytes.extend_from_slice(input.payload);
    bytes.extend_from_slice(&crc32fast::hash(&bytes).to_le_bytes());
    if let Ok(read) = read(&bytes[..], &limits) {
        let again = to_bytes(&read).expect("what was read can be written");
        assert!(again == bytes, "bytes are not canonical");
    }
});
