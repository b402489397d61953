//! Files that end too early: the error states how many bytes there are, how many there should be, and whether a part of
//! the picture can be decoded.

use ssplat::{Damage, Error, FormatError, Limits, Reader, SsplatImage};

fn read(bytes: &[u8], damage: Damage) -> ssplat::Result<SsplatImage> {
    Reader::new(bytes, &Limits::default())?.damage(damage).read()
}

/// Cuts a vector after every byte.
fn check(name: &str) {
    let path = format!("{}/spec/vectors/valid/{name}/file.ssplat", env!("CARGO_MANIFEST_DIR"));
    let file = std::fs::read(path).unwrap();
    assert!(read(&file, Damage::Refuse).is_ok(), "{name}");
    let (mut with_length, mut with_parts) = (0, 0);
    for end in 0..file.len() {
        let cut = &file[..end];
        let Err(error) = read(cut, Damage::Refuse) else { panic!("{name} after {end} bytes is read") };
        let text = error.to_string();
        let Error::Format(FormatError::CutOff { bytes, of, partial, .. }) = error else {
            panic!("{name} after {end} bytes: {error}")
        };
        assert_eq!(bytes, end as u64, "{name}");
        assert!(of.is_none_or(|of| of == file.len() as u64), "{name} after {end} bytes: {of:?}");
        assert_eq!(partial, read(cut, Damage::Accept).is_ok(), "{name} after {end} bytes");
        assert_eq!(partial, text.contains("Damage::Accept"), "{text}");
        if of.is_some() {
            with_length += 1;
            assert!(text.contains(&format!("cut off after {end} of {} bytes", file.len())), "{text}");
        }
        with_parts += usize::from(partial);
        if let Err(Error::Format(FormatError::CutOff { bytes, partial, .. })) = read(cut, Damage::Accept) {
            assert_eq!((bytes, partial), (end as u64, false), "{name}");
        }
    }
    assert!(with_length >= 4, "{name}: {with_length} of {} cut files state their length", file.len());
    assert!(with_parts >= 4 || name.starts_with("packed"), "{name}: {with_parts}");
}

#[test]
fn files_in_groups_state_their_length() {
    check("groups-levels");
}

#[test]
fn files_with_a_detail_layer_state_their_length() {
    check("detail-rgb");
    check("detail-groups");
    check("detail-sections");
}

#[test]
fn files_with_an_exact_layer_state_their_length() {
    check("exact-rgb-8");
    check("exact-both-layers");
    check("exact-groups");
}

#[test]
fn packed_files_state_their_length() {
    check("packed-rgb");
}

#[test]
fn a_file_whose_length_is_unknown_is_damaged_or_cut_off() {
    let path = format!("{}/spec/vectors/valid/coded-rgb/file.ssplat", env!("CARGO_MANIFEST_DIR"));
    let file = std::fs::read(path).unwrap();
    let error = read(&file[..file.len() - 5], Damage::Refuse).unwrap_err();
    assert!(matches!(error, Error::Format(FormatError::Checksum { .. })), "{error:?}");
    assert!(error.to_string().contains("damaged or cut off"), "{error}");
}

#[test]
fn a_wrong_byte_is_not_a_missing_one() {
    for name in ["groups-levels", "detail-rgb", "exact-rgb-8", "packed-rgb"] {
        let path = format!("{}/spec/vectors/valid/{name}/file.ssplat", env!("CARGO_MANIFEST_DIR"));
        let mut file = std::fs::read(path).unwrap();
        *file.last_mut().unwrap() ^= 1;
        let error = read(&file, Damage::Refuse).unwrap_err();
        assert!(matches!(error, Error::Format(FormatError::Checksum { .. })), "{name}: {error:?}");
    }
}

#[test]
fn a_file_with_its_own_checksum_is_not_cut_off() {
    for name in ["groups-levels", "detail-rgb", "exact-rgb-8", "packed-rgb"] {
        let path = format!("{}/spec/vectors/valid/{name}/file.ssplat", env!("CARGO_MANIFEST_DIR"));
        let file = std::fs::read(path).unwrap();
        let mut short = file[..file.len() - 12].to_vec();
        short.extend(crc32fast::hash(&short).to_le_bytes());
        let error = read(&short, Damage::Refuse).unwrap_err();
        assert!(!matches!(error, Error::Format(FormatError::CutOff { .. })), "{name}: {error:?}");
    }
}
