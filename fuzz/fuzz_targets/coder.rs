//! Any bytes as the payload of the coded layout behind a sound header: an error, or integers that code to the same bytes.
#![no_main]

use arbitrary::Arbitrary;
use libfuzzer_sys::fuzz_target;
use ssplat::bitstream::splats::Layout;
use ssplat::bitstream::{read, to_bytes};
use ssplat_fuzz::{Legal, tight_limits};

#[derive(Debug, Arbitrary)]
struct Input<'a> {
    head: Legal,
    payload: &'a [u8],
}

fuzz_target!(|input: Input| {
    let mut splats = input.head.0;
    splats.layout = Layout::Coded;
    splats.metadata = Default::default();
    // The header is what comes before a stream of the same header with another background.
    let Ok(mut bytes) = to_bytes(&splats) else { return };
    splats.background[0] ^= 0x55;
    let Ok(other) = to_bytes(&splats) else { return };
    let head = bytes.iter().zip(&other).take_while(|(a, b)| a == b).count().min(23);
    bytes.truncate(head);
    bytes.extend_from_slice(input.payload);
    bytes.extend_from_slice(&[0; 4]);
    if let Ok(read) = read(&bytes[..], &tight_limits()) {
        let again = to_bytes(&read).expect("what was read can be written");
        let body = bytes.len() - 4;
        assert!(again.len() == bytes.len() && again[..body] == bytes[..body], "bytes are not canonical");
    }
});
