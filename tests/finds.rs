//! Files that fuzzing found: each is refused, or reads as integers that write the same bytes (the same integers, in groups and
//! in the planes layout).

mod groups;
mod seal;

use std::fs;
use std::path::Path;

use seal::seal;
use ssplat::bitstream::splats::Layout;
use ssplat::bitstream::{read, to_bytes};
use ssplat::{Error, FormatError, Limits};

/// The finds by name. Some come from when fuzzing did not check the checksum, so it is set right here.
fn finds() -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/finds");
    fs::read_dir(folder)
        .unwrap()
        .map(|entry| {
            let path = entry.unwrap().path();
            let mut bytes = fs::read(&path).unwrap();
            seal(&mut bytes);
            (path.file_stem().unwrap().to_string_lossy().into_owned(), bytes)
        })
        .collect()
}

#[test]
fn every_find_is_refused_or_canonical() {
    let finds = finds();
    assert!(!finds.is_empty());
    for (name, bytes) in finds {
        if let Ok(splats) = read(&bytes[..], &Limits::default()) {
            if groups::is_grouped(&bytes) {
                groups::assert_kept(&splats, &Limits::default(), &name);
                continue;
            }
            let again = to_bytes(&splats).unwrap();
            // zstd has many streams for the same bytes.
            assert!(again == bytes || splats.layout == Layout::Planes, "{name} is not canonical");
            assert_eq!(read(&again[..], &Limits::default()).unwrap(), splats, "{name}");
        }
    }
}

#[test]
fn a_coded_stream_that_starts_above_its_interval_is_refused() {
    let (_, bytes) = finds().into_iter().find(|f| f.0 == "coded-stream-starts-above-its-interval").unwrap();
    match read(&bytes[..], &Limits::default()) {
        Err(Error::Format(FormatError::BadValue { field: "start of the coded stream", .. })) => {}
        other => panic!("{other:?}"),
    }
}
