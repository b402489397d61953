//! A zstd frame, as native readers and those in WebAssembly read it: in memory that the plane's length bounds; and what is
//! compressed, both read as it was.
#![no_main]

use libfuzzer_sys::fuzz_target;
use peak_alloc::PeakAlloc;

mod error {
    pub use ssplat::Result;
}
#[path = "../../src/bitstream/frame/native.rs"]
mod native;
#[path = "../../src/bitstream/frame/outline.rs"]
mod outline;
#[path = "../../src/bitstream/frame/wasm.rs"]
mod wasm;

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// Tables and one block of a reader, bytes, whatever the plane.
const TABLES: usize = 3 << 20;

fuzz_target!(|data: &[u8]| {
    let Some((length, rest)) = data.split_first_chunk::<2>() else { return };
    let count = usize::from(u16::from_le_bytes(*length)).max(1);
    if outline::outline(rest, count).is_some() {
        let (mut plane, mut other) = (vec![0; count], vec![0; count]);
        ALLOCATOR.reset_peak_usage();
        let before = ALLOCATOR.current_usage();
        let _ = wasm::decompress(rest, &mut plane);
        let peak = ALLOCATOR.peak_usage() - before;
        assert!(peak <= 8 * count + TABLES, "{peak} bytes for a plane of {count}");
        // What each makes of a broken frame is its own; the planes' checksum tells.
        let _ = native::decompress(rest, &mut other);
    }
    if let Some(frame) = native::compress(rest).expect("bytes can be compressed") {
        if rest.is_empty() {
            return;
        }
        assert!(outline::outline(&frame, rest.len()).is_some(), "a frame of zstd's without the outline");
        for decompress in [native::decompress, wasm::decompress] {
            let mut plane = vec![0; rest.len()];
            assert!(decompress(&frame, &mut plane).is_some() && plane == rest, "other bytes than were compressed");
        }
    }
});
