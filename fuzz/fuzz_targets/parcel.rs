//! Runs tasks on a worker: any contents after the header of a task of this version, with a correct checksum, and
//! truncated headers. They are refused, or processed in bounded memory until the worker is stopped.
#![no_main]

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use libfuzzer_sys::fuzz_target;
use peak_alloc::PeakAlloc;
use ssplat::{Error, Parameter, Progress};
use ssplat_fuzz::task_head;

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// Time after which the worker is asked to stop; it must stop soon after.
const STOP: Duration = Duration::from_secs(5);
const STOPPED: Duration = Duration::from_secs(12);

/// Memory of a fit beyond the bytes that its task requests: a constant, and an amount for each byte.
const FIXED: usize = 64 << 20;
const EACH: usize = 4000;

/// Returns a task. The first byte selects whether the others are its contents, the whole task, or only follow the
/// start of the header.
fn task(data: &[u8]) -> Vec<u8> {
    let Some((&how, contents)) = data.split_first() else { return Vec::new() };
    let mut task = task_head();
    match how {
        255 => task.clear(),
        254 => task.truncate(contents.first().map_or(0, |&length| usize::from(length))),
        _ => {}
    }
    task.extend(contents);
    if how < 254 {
        task.extend(crc32fast::hash(&task).to_le_bytes());
    }
    task
}

fuzz_target!(|data: &[u8]| {
    let task = task(data);
    ALLOCATOR.reset_peak_usage();
    let (before, start) = (ALLOCATOR.current_usage(), Instant::now());
    let mut go_on =
        |_: &Progress| if start.elapsed() > STOP { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    let answer = ssplat::work_on_tile(&task, &mut go_on);
    let peak = ALLOCATOR.peak_usage() - before;
    assert!(peak < FIXED + EACH * task.len(), "{peak} bytes for a task of {}", task.len());
    match answer {
        Ok(_) | Err(Error::Parameter { parameter: Parameter::Task, .. }) => {}
        Err(Error::Cancelled) => assert!(start.elapsed() < STOPPED, "stopped only after {:?}", start.elapsed()),
        Err(other) => panic!("a task is refused by {other:?}"),
    }
});
