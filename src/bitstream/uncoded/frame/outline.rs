//! Checks of a zstd frame's structure before a library reads it (spec §7, RFC 8878). Libraries differ in the errors
//! they tolerate, and a frame states the memory that its reader allocates.

/// Signature, and a descriptor without content size, dictionary and checksum.
const START: [u8; 5] = [0x28, 0xB5, 0x2F, 0xFD, 0];

/// The smallest window that a frame can state, bytes.
const MIN_WINDOW: u64 = 1 << 10;

/// Maximum number of bytes of a block, compressed and decompressed.
const MAX_BLOCK: u64 = 1 << 17;

/// Checks that `frame` is exactly one frame, whose window holds a plane of `count` bytes and is not much larger, that
/// reserved bits are 0, and that blocks that state their size have at most `count` bytes.
pub(crate) fn outline(frame: &[u8], count: usize) -> Option<()> {
    let (&window, mut rest) = frame.strip_prefix(&START)?.split_first()?;
    let count = count as u64;
    let base = MIN_WINDOW << (window >> 3);
    let window = base + base / 8 * u64::from(window & 7);
    if window < count || window > MIN_WINDOW.max(2 * count) {
        return None;
    }
    let mut told = 0;
    loop {
        let (head, behind) = rest.split_first_chunk::<3>()?;
        let head = u32::from_le_bytes([head[0], head[1], head[2], 0]);
        let size = u64::from(head >> 3);
        if size > window.min(MAX_BLOCK) {
            return None;
        }
        let (bytes, plain) = match head >> 1 & 3 {
            0 => (size, size),
            1 => (1, size),
            2 => (size, 0),
            _ => return None,
        };
        told += plain;
        let (block, behind) = behind.split_at_checked(bytes as usize)?;
        if told > count {
            return None;
        }
        if head >> 1 & 3 == 2 {
            block_outline(block)?;
        }
        rest = behind;
        if head & 1 == 1 {
            return rest.is_empty().then_some(());
        }
    }
}

/// Checks the headers of the two sections of a compressed block.
fn block_outline(block: &[u8]) -> Option<()> {
    let number = |bytes: usize| {
        let mut wide = [0; 8];
        wide[..bytes].copy_from_slice(block.get(..bytes)?);
        Some(u64::from_le_bytes(wide))
    };
    let (kind, format) = (block.first()? & 3, block.first()? >> 2 & 3);
    // Bytes of the literals' header and of what follows it.
    let (head, body) = match (kind, format) {
        (0 | 1, _) => {
            let (bytes, shift) = [(1, 3), (2, 4), (1, 3), (3, 4)][usize::from(format)];
            (bytes, if kind == 0 { number(bytes)? >> shift } else { 1 })
        }
        _ => {
            let (bytes, bits) = [(3, 10), (3, 10), (4, 14), (5, 18)][usize::from(format)];
            (bytes, number(bytes)? >> (4 + bits) & ((1 << bits) - 1))
        }
    };
    let sequences = block.get(head..)?.get(body as usize..)?;
    match *sequences {
        // A block without sequences ends here.
        [0] => Some(()),
        [0, ..] => None,
        // Two bits of the modes are reserved.
        [1..=127, modes, ..] | [128..=254, _, modes, ..] | [255, _, _, modes, ..] => (modes & 3 == 0).then_some(()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bitstream::uncoded::frame::{compress, decompress};

    /// Planes of the kinds that occur: noise, runs, gradients, repeating text; with sizes near those of blocks and
    /// windows.
    fn planes() -> Vec<Vec<u8>> {
        let mut planes = Vec::new();
        for count in [1usize, 2, 300, 1023, 1024, 1025, 1026, 4096, 131_072, 131_073, 300_000] {
            let noise = |i: usize| (i as u32).wrapping_mul(0x9E37_79B9).rotate_left(i as u32 % 31) as u8;
            planes.push((0..count).map(noise).collect());
            planes.push((0..count).map(|i| noise(i) & 3).collect());
            planes.push(vec![7; count]);
            planes.push((0..count).map(|i| (i / 3) as u8).collect());
        }
        planes
    }

    #[test]
    #[cfg_attr(miri, ignore = "zstd is C, which miri does not run")]
    fn compressed_frames_pass_the_checks_and_round_trip() {
        for plane in planes() {
            let frame = compress(&plane).unwrap().unwrap();
            assert!(outline(&frame, plane.len()).is_some(), "{} bytes: {:02x?}", plane.len(), &frame[..8]);
            let mut read = vec![0; plane.len()];
            assert!(decompress(&frame, &mut read).is_some() && read == plane);
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "zstd is C, which miri does not run")]
    fn frames_that_libraries_read_differently_are_refused() {
        let plane: Vec<u8> = (0..5000).map(|i| (i / 3 % 50) as u8).collect();
        let frame = compress(&plane).unwrap().unwrap();
        let changed = |at: usize, value: u8| {
            let mut frame = frame.clone();
            frame[at] = value;
            outline(&frame, plane.len())
        };
        assert!(changed(4, 0).is_some());
        // A checksum, a content size, a dictionary; a reserved and an unused bit.
        for descriptor in [4, 0x20, 1, 8, 16] {
            assert!(changed(4, descriptor).is_none());
        }
        // 4 KiB, 8 KiB, 9 KiB, 96 MiB.
        assert_eq!([0x10, 0x18, 0x19, 0x84].map(|window| changed(5, window).is_some()), [false, true, true, false]);
        // A reserved type of block.
        assert!(changed(6, frame[6] | 6).is_none());
        for more in [&[0][..], &frame] {
            assert!(outline(&[&frame, more].concat(), plane.len()).is_none(), "something behind it");
        }
        for end in 0..frame.len() {
            assert!(outline(&frame[..end], plane.len()).is_none(), "cut at {end}");
        }
    }

    // Handmade frames, which also run under miri.
    #[test]
    fn blocks_with_reserved_bits_or_the_wrong_length_are_refused() {
        // The block has one literal, which repeats, and sequences, whose modes' lowest bits are reserved.
        let block = [0b01, 9, 1, 0b0101_0100, 0, 0, 0];
        let framed =
            |block: &[u8]| [&START[..], &[0x18], &(block.len() as u32 * 8 + 5).to_le_bytes()[..3], block].concat();
        assert!(outline(&framed(&block), 5000).is_some());
        // Even without the reserved bits, this sequence does not end correctly; a frame without a sequence is read.
        let mut plane = [0; 1];
        assert!(decompress(&framed(&block), &mut plane).is_none());
        assert!(decompress(&framed(&[0b0000_1001, 9, 0]), &mut plane).is_some() && plane == [9]);
        for reserved in [1, 2] {
            let mut block = block;
            block[3] |= reserved;
            assert!(outline(&framed(&block), 5000).is_none());
        }
        // No sequences, with a byte after them.
        assert!(outline(&framed(&[0b01, 9, 0]), 5000).is_some() && outline(&framed(&[0b01, 9, 0, 0]), 5000).is_none());
        // Runs that are longer than the plane.
        let run = [&0xF_FFFAu32.to_le_bytes()[..3], &[9]].concat();
        assert!(outline(&[&START[..], &[0x18], &run].concat(), 5000).is_none());
        // Nothing is read after the end of a frame, whatever its last bytes are.
        let whole = framed(&block);
        for end in 0..whole.len() {
            assert!(outline(&whole[..end], 5000).is_none(), "cut at {end}");
        }
        for value in 0..=255 {
            for at in START.len()..whole.len() {
                let mut changed = whole.clone();
                changed[at] = value;
                let _ = outline(&changed, 5000);
            }
        }
    }
}
