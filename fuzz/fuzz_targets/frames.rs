//! Reads a zstd frame: it is read or refused, in memory that the plane's length bounds. Compresses a plane: it
//! decompresses to the same bytes, also with zstd.
#![no_main]

use libfuzzer_sys::fuzz_target;
use peak_alloc::PeakAlloc;

mod error {
    pub use ssplat::Result;
}
#[path = "../../src/bitstream/uncoded/frame/compress.rs"]
mod compress;
#[path = "../../src/bitstream/uncoded/frame/decompress.rs"]
mod decompress;
#[path = "../../src/bitstream/uncoded/frame/outline.rs"]
mod outline;

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// Tables and one block of a decompressor, bytes, for any plane.
const TABLES: usize = 3 << 20;

fuzz_target!(|data: &[u8]| {
    let Some((length, rest)) = data.split_first_chunk::<2>() else { return };
    let count = usize::from(u16::from_le_bytes(*length)).max(1);
    if outline::outline(rest, count).is_some() {
        let mut plane = vec![0; count];
        ALLOCATOR.reset_peak_usage();
        let before = ALLOCATOR.current_usage();
        let _ = decompress::decompress(rest, &mut plane);
        let peak = ALLOCATOR.peak_usage() - before;
        assert!(peak <= 8 * count + TABLES, "{peak} bytes for a plane of {count}");
    }
    if let Some(frame) = compress::compress(rest).expect("bytes can be compressed") {
        if rest.is_empty() {
            return;
        }
        assert!(outline::outline(&frame, rest.len()).is_some(), "a frame of zstd's without the outline");
        let (mut plane, mut other) = (vec![0; rest.len()], vec![0; rest.len()]);
        assert!(
            decompress::decompress(&frame, &mut plane).is_some() && plane == rest,
            "other bytes than were compressed"
        );
        let written = zstd::bulk::decompress_to_buffer(&frame, &mut other).expect("zstd reads what it wrote");
        assert!(written == rest.len() && other == rest, "zstd reads other bytes than were compressed");
    }
});
