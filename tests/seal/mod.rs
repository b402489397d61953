//! Corrects the checksums of damaged files, to test the code behind the checksums.

#![allow(dead_code, reason = "each test crate uses its own part")]

pub mod layer;
pub mod mutations;

use ssplat::unstable::bitstream::read;
use ssplat::{Error, FormatError, Limits};

/// Sets the checksums of detail layer, file, directory and groups to the values that a reader computes.
pub fn seal(bytes: &mut [u8]) {
    layer::mend(bytes);
    for _ in 0..16 {
        let Err(Error::Format(FormatError::Checksum { stored, computed, .. })) = read(&*bytes, &Limits::default())
        else {
            return;
        };
        let Some(at) = bytes.windows(4).rposition(|w| w == stored.to_le_bytes()) else { return };
        bytes[at..at + 4].copy_from_slice(&computed.to_le_bytes());
    }
}
