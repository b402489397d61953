//! Parses any bytes: the result is a typed error, or integers that write the same bytes, however the reader splits its
//! input, in bounded memory.
#![no_main]

#[path = "../../tests/groups/mod.rs"]
mod groups;

use libfuzzer_sys::{fuzz_mutator, fuzz_target};
use peak_alloc::PeakAlloc;
use ssplat::unstable::bitstream::sections::SectionFate;
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::unstable::bitstream::{MissingParts, inspect, read, read_area, read_partial, to_bytes};
use ssplat_fuzz::mutate::mutate;
use ssplat_fuzz::{SLACK, Sliced, tight_limits};

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

fuzz_mutator!(|data: &mut [u8], size: usize, max: usize, seed: u32| { mutate(data, size, max, seed) });

fuzz_target!(|data: &[u8]| {
    let limits = tight_limits();
    ALLOCATOR.reset_peak_usage();
    let before = ALLOCATOR.current_usage();
    let whole = read(data, &limits);
    let peak = (ALLOCATOR.peak_usage() - before) as u64;
    assert!(peak <= limits.alloc + SLACK, "{peak} bytes allocated");

    let sliced = read(Sliced::new(data), &limits);
    match (&whole, &sliced) {
        (Ok(a), Ok(b)) => assert!(a == b, "sliced input reads differently"),
        (Err(a), Err(b)) => assert_eq!(format!("{a:?}"), format!("{b:?}")),
        (a, b) => panic!("whole {:?}, sliced {:?}", a.as_ref().err(), b.as_ref().err()),
    }
    match (read_partial(data, &limits), &whole) {
        (Ok((part, missing)), Ok(whole)) => assert!(part == *whole && missing == MissingParts::default()),
        (Ok((part, missing)), Err(_)) => {
            let count = part.gaussians.len() as u64 + u64::from(missing.gaussians);
            assert!(count <= limits.gaussians && missing.groups <= missing.of_groups);
        }
        (Err(e), Ok(_)) => panic!("read whole but not in part: {e}"),
        (Err(_), Err(_)) => {}
    }
    let Ok(splats) = whole else { return };
    let part =
        read_area(data, &[splats.width / 2, splats.height / 2, 1, 1].into(), &limits).expect("a part of it reads");
    assert!(part.gaussians.len() <= splats.gaussians.len());
    let (inspected, report) = inspect(data, &limits).expect("what reads can be inspected");
    assert!(inspected == splats);
    assert_eq!(report.parts.iter().map(|p| p.bytes).sum::<u64>(), data.len() as u64);
    if report.sections.iter().all(|s| s.fate == SectionFate::Kept) {
        if groups::is_grouped(data) {
            groups::assert_kept(&splats, &limits, "a file in groups");
            return;
        }
        let again = to_bytes(&splats).expect("what was read can be written");
        if splats.layout == Layout::Planes {
            // Different zstd streams can have the same contents.
            let read = read(&again[..], &limits).expect("what was written reads back");
            assert!(read == splats, "what was written reads differently");
            return;
        }
        assert!(again == data, "bytes are not canonical");
    }
});
