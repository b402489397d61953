//! Files found by fuzzing: each is refused, or reads as integers that write the same bytes (the same integers for
//! groups and the planes layout).

use std::fs;
use std::path::Path;

use crate::seal::seal;
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::unstable::bitstream::{read, to_bytes};
use ssplat::{Error, FormatError, Limits};

/// Returns the finds by name. Some are from a time when fuzzing did not check the checksum, so it is corrected here.
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
            if crate::groups::is_grouped(&bytes) {
                crate::groups::assert_kept(&splats, &Limits::default(), &name);
                continue;
            }
            let again = to_bytes(&splats).unwrap();
            // Different zstd streams can have the same contents.
            assert!(again == bytes || splats.layout == Layout::Planes, "{name} is not canonical");
            assert_eq!(read(&again[..], &Limits::default()).unwrap(), splats, "{name}");
        }
    }
}

/// Returns the reason why a find is invalid.
fn reason(name: &str) -> FormatError {
    let (_, bytes) = finds().into_iter().find(|f| f.0 == name).unwrap_or_else(|| panic!("{name}"));
    match read(&bytes[..], &Limits::default()) {
        Err(Error::Format(e)) => e,
        other => panic!("{name}: {other:?}"),
    }
}

#[test]
fn zstd_frames_that_libraries_read_differently_are_refused() {
    for name in ["reserved-bits-of-zstd", "a-window-of-96-mib", "a-window-that-another-library-refuses"] {
        let reason = reason(&format!("planes-with-{name}"));
        assert!(matches!(reason, FormatError::Compression { .. }), "{name}: {reason}");
    }
}

#[test]
fn colours_beyond_single_precision_are_refused() {
    for i in 1..=4 {
        let reason = reason(&format!("colours-beyond-single-precision-{i}"));
        assert!(matches!(reason, FormatError::BadValue { field: "background", .. }), "{i}: {reason}");
    }
}

#[test]
fn ambiguous_planes_decode_to_a_single_picture() {
    // A broken frame, with the checksum of its contents as each of two libraries reads it. The checksum is not
    // corrected. Native machines and WebAssembly use the same library.
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/finds");
    let read_as = |library| {
        let bytes = fs::read(folder.join(format!("planes-with-two-pictures-as-{library}-reads.bin"))).unwrap();
        read(&bytes[..], &Limits::default())
    };
    assert!(read_as("ruzstd").is_ok());
    let refused = read_as("zstd");
    assert!(matches!(refused, Err(Error::Format(FormatError::Checksum { what: "planes", .. }))), "{refused:?}");
}

#[test]
fn a_coded_stream_that_starts_above_its_interval_is_refused() {
    let (_, bytes) = finds().into_iter().find(|f| f.0 == "coded-stream-starts-above-its-interval").unwrap();
    match read(&bytes[..], &Limits::default()) {
        Err(Error::Format(FormatError::BadValue { field: "start of the coded stream", .. })) => {}
        other => panic!("{other:?}"),
    }
}
