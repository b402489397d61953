//! Runs modified tasks with correct checksums on a worker: they are refused, or processed in bounded memory until the
//! worker is stopped.
#![no_main]

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use libfuzzer_sys::{fuzz_mutator, fuzz_target, fuzzer_mutate};
use peak_alloc::PeakAlloc;
use ssplat::{Error, Progress};

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// Time after which the worker is asked to stop; it must stop soon after.
const STOP: Duration = Duration::from_secs(5);
const STOPPED: Duration = Duration::from_secs(12);

/// Memory of a fit beyond the bytes that its task requests: a constant, and an amount for each byte.
const FIXED: usize = 64 << 20;
const EACH: usize = 4000;

fuzz_mutator!(|data: &mut [u8], size: usize, max: usize, _seed: u32| {
    let size = fuzzer_mutate(data, size, max);
    if let Some(body) = size.checked_sub(4) {
        let checksum = crc32fast::hash(&data[..body]).to_le_bytes();
        data[body..size].copy_from_slice(&checksum);
    }
    size
});

fuzz_target!(|data: &[u8]| {
    ALLOCATOR.reset_peak_usage();
    let (before, start) = (ALLOCATOR.current_usage(), Instant::now());
    let mut go_on =
        |_: &Progress| if start.elapsed() > STOP { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    let answer = ssplat::work_on_tile(data, &mut go_on);
    let peak = ALLOCATOR.peak_usage() - before;
    assert!(peak < FIXED + EACH * data.len(), "{peak} bytes for a task of {}", data.len());
    if let Err(Error::Cancelled) = answer {
        assert!(start.elapsed() < STOPPED, "stopped only after {:?}", start.elapsed());
    }
});
