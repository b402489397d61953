//! Imports Gaussians of other programs from archives, arrays and tables: they are rejected, or packed to a file or a
//! typed error, in bounded memory.
#![no_main]
#![allow(dead_code, reason = "the program's modules are used in part")]

use std::collections::BTreeMap;

use libfuzzer_sys::fuzz_target;
use peak_alloc::PeakAlloc;

use ssplat::{Blend, Encoder, Limits, Reader};

#[path = "../../cli/src/exchange/csv.rs"]
mod csv;
#[path = "../../cli/src/failure.rs"]
mod failure;
#[path = "../../cli/src/exchange/foreign.rs"]
mod foreign;
#[path = "../../cli/src/names.rs"]
mod names;
#[path = "../../cli/src/exchange/npy.rs"]
mod npy;
#[path = "../../cli/src/exchange/npz.rs"]
mod npz;
#[path = "../../cli/src/exchange/parameters.rs"]
mod parameters;
#[path = "../../cli/src/exchange/ply.rs"]
mod ply;
#[path = "../../cli/src/exchange/problem.rs"]
mod problem;
#[path = "../../cli/src/exchange/stated.rs"]
mod stated;

use npy::Array;
use parameters::{Given, Parameters};

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// Names of arrays that the import knows: those of ssplat and of other programs.
const NAMES: [&str; 20] = [
    "means",
    "scales",
    "rotations",
    "covariances",
    "colors",
    "background",
    "size",
    "blend",
    "depth",
    "layout",
    "steps",
    "_xyz",
    "_cholesky",
    "_scaling",
    "_rotation",
    "_features_dc",
    "xy",
    "scale",
    "rot",
    "feat",
];

fn limits() -> Limits {
    let mut limits = Limits::default();
    (limits.alloc, limits.gaussians) = (16 << 20, 1 << 16);
    limits
}

fn of_arrays(arrays: &BTreeMap<String, Array>, given: Given) -> Option<Parameters> {
    if foreign::is_known(arrays) {
        foreign::read(arrays, given).ok().map(|found| found.0)
    } else {
        Parameters::from_arrays(arrays, given).ok()
    }
}

/// Reads the bytes in the format that the lowest bits of the first byte select.
fn read(kind: u8, rest: &[u8], given: Given) -> Option<Parameters> {
    match kind & 6 {
        0 => {
            let (mut arrays, mut left) = (BTreeMap::new(), limits().alloc);
            for part in rest.split(|&b| b == 0xFE) {
                let Some((name, file)) = part.split_first() else { continue };
                if let Ok(array) = npy::read(file, limits().gaussians, &mut left) {
                    arrays.insert(NAMES[usize::from(*name) % NAMES.len()].to_owned(), array);
                }
            }
            of_arrays(&arrays, given)
        }
        2 => npz::read(rest, &NAMES, &limits()).ok().and_then(|arrays| of_arrays(&arrays, given)),
        4 => ply::read(rest, given, &limits()).ok().map(|found| found.0),
        _ => csv::read(std::str::from_utf8(rest).ok()?, given, &limits()).ok(),
    }
}

fuzz_target!(|data: &[u8]| {
    let Some((&kind, rest)) = data.split_first() else { return };
    let given = if kind & 1 == 0 { Given { size: Some([64, 48]), blend: Some(Blend::Sum) } } else { Given::default() };
    ALLOCATOR.reset_peak_usage();
    let before = ALLOCATOR.current_usage();
    let found = read(kind, rest, given);
    let peak = (ALLOCATOR.peak_usage() - before) as u64;
    assert!(peak <= 3 * limits().alloc + 64 * data.len() as u64, "{peak} bytes for {}", data.len());
    if let Some(found) = found
        && let Ok(encoded) = Encoder::new().encode_gaussians(&found.picture)
    {
        let image = Reader::new(&encoded.bytes, &Limits::default()).and_then(|reader| reader.read());
        let stored = image.expect("an encoded file is read").gaussians().expect("within the default limits");
        assert_eq!(stored.list.len(), found.picture.list.len());
    }
});
