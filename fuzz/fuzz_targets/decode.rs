//! Decodes any bytes through the `image` hook with tight limits: the result is an error or a picture, within the
//! memory limit.
#![no_main]

use ssplat::Reader;
use std::io::Cursor;

use image::ImageReader;
use libfuzzer_sys::{fuzz_mutator, fuzz_target};
use peak_alloc::PeakAlloc;
use ssplat_fuzz::SLACK;
use ssplat_fuzz::mutate::mutate;

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

const SIDE: u32 = 256;
const ALLOC: u64 = 8 << 20;

fuzz_mutator!(|data: &mut [u8], size: usize, max: usize, seed: u32| { mutate(data, size, max, seed) });

fuzz_target!(|data: &[u8]| {
    assert!(ssplat::register());
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(SIDE);
    limits.max_image_height = Some(SIDE);
    limits.max_alloc = Some(ALLOC);
    ALLOCATOR.reset_peak_usage();
    let before = ALLOCATOR.current_usage();
    let mut reader = ImageReader::new(Cursor::new(data)).with_guessed_format().expect("memory can be read");
    reader.limits(limits);
    let picture = reader.decode();
    let peak = (ALLOCATOR.peak_usage() - before) as u64;
    assert!(peak <= ALLOC + SLACK, "{peak} bytes allocated");
    if let Ok(picture) = picture {
        assert!(picture.width() <= SIDE && picture.height() <= SIDE);
    }
    let mut limits = ssplat::Limits::default();
    (limits.width, limits.height, limits.alloc) = (SIDE, SIDE, ALLOC);
    ALLOCATOR.reset_peak_usage();
    let before = ALLOCATOR.current_usage();
    let small = Reader::new(data, &limits).and_then(|reader| reader.thumbnail([16, 16]));
    let peak = (ALLOCATOR.peak_usage() - before) as u64;
    assert!(peak <= ALLOC + SLACK, "{peak} bytes allocated for a thumbnail");
    if let Ok(small) = small {
        assert!(small.pixels.width() <= 16 && small.pixels.height() <= 16);
    }
});
