//! Truncated, damaged and synthetic files: the result is a typed error or a valid picture, never a panic, and no
//! damage goes unnoticed.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use crate::seal::mutations::mutations;
use crate::seal::seal;
use ssplat::View;
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::unstable::bitstream::{MissingParts, inspect, read, read_partial, to_bytes};
use ssplat::{Error, Limits, Rect};

/// Number of times that each outcome occurred.
#[derive(Default)]
struct Outcomes(BTreeMap<&'static str, u64>);

impl Outcomes {
    fn add(&mut self, outcome: &'static str) {
        *self.0.entry(outcome).or_default() += 1;
    }

    fn of(&self, outcome: &str) -> u64 {
        self.0.get(outcome).copied().unwrap_or(0)
    }

    fn print(&self, what: &str) {
        println!("{what}: {} files, {:?}", self.0.values().sum::<u64>(), self.0);
    }
}

/// Returns the valid files among the vectors. It excludes the one that is long enough for its groups to be divided:
/// its 90 000 bits would take minutes, and it has no kind of part that others lack.
fn sound() -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("spec/vectors/valid");
    let mut files: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| {
            let path = entry.unwrap().path();
            (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(path.join("file.ssplat")).unwrap())
        })
        .collect();
    files.retain(|(_, bytes)| bytes.len() < 8192);
    files.sort();
    assert!(files.len() > 40);
    files
}

/// Limits that every vector satisfies.
fn tight() -> Limits {
    let mut limits = Limits::default();
    (limits.width, limits.height, limits.gaussians) = (1 << 12, 1 << 12, 1 << 16);
    (limits.alloc, limits.tile_pairs) = (48 << 20, 1 << 20);
    limits
}

fn kind(e: &Error) -> &'static str {
    match e {
        Error::Format(ssplat::FormatError::Checksum { .. }) => "checksum",
        Error::Format(_) => "format",
        Error::UnsupportedVersion { .. } => "unsupported",
        Error::LimitExceeded { .. } => "limit",
        e => panic!("{e:?}"),
    }
}

/// Reads and renders. Accepted files write the same bytes again.
fn outcome(bytes: &[u8]) -> &'static str {
    let limits = tight();
    let splats = match read(bytes, &limits) {
        Ok(splats) => splats,
        Err(e) => return kind(&e),
    };
    let (_, report) = inspect(bytes, &limits).unwrap();
    let kept = report.sections.iter().all(|s| s.fate == ssplat::unstable::bitstream::sections::SectionFate::Kept);
    if kept && crate::groups::is_grouped(bytes) {
        crate::groups::assert_kept(&splats, &limits, "a file in groups");
    } else if kept && splats.layout != Layout::Planes {
        // Different zstd streams can have the same contents.
        assert!(to_bytes(&splats).unwrap() == bytes, "bytes are not canonical");
    }
    // Rendering the whole of a large picture takes long, so only a corner is rendered.
    let (width, height) = (splats.width, splats.height);
    let view = View::new(width, height).crop(Rect::new(0, 0, width.min(48), height.min(48))).unwrap();
    match splats.renderer(&view, &limits).and_then(|r| r.render(splats.depth)) {
        Ok(_) if !splats.metadata.damaged.is_empty() => "picture without a damaged section",
        Ok(_) => "picture",
        Err(e) => kind(&e),
    }
}

#[test]
fn every_truncation_is_refused() {
    let mut outcomes = Outcomes::default();
    for (name, bytes) in sound() {
        for end in 0..bytes.len() {
            let outcome = outcome(&bytes[..end]);
            assert!(["format", "checksum"].contains(&outcome), "{name} cut at {end}: {outcome}");
            outcomes.add(outcome);
        }
    }
    outcomes.print("truncations");
}

#[test]
fn every_flipped_bit_is_detected() {
    let mut outcomes = Outcomes::default();
    // Changing one bit of the damaged file makes it valid again.
    for (name, bytes) in sound().into_iter().filter(|f| f.0 != "sections-damaged") {
        for bit in 0..8 * bytes.len() {
            let mut hurt = bytes.clone();
            hurt[bit / 8] ^= 1 << (bit % 8);
            let outcome = outcome(&hurt);
            assert!(outcome != "picture", "{name} with bit {bit} flipped is accepted");
            outcomes.add(outcome);
        }
    }
    outcomes.print("flipped bits");
    // The two sections whose contents have checksums of their own.
    assert!(outcomes.of("picture without a damaged section") > 0);
}

#[test]
fn every_value_of_every_header_byte_is_refused_or_valid() {
    let mut outcomes = Outcomes::default();
    for (k, (_, bytes)) in sound().into_iter().enumerate() {
        for at in 0..12 {
            // Each value is tried in a third of the files.
            for value in (0..=255).filter(|value| (k + usize::from(*value)).is_multiple_of(3)) {
                let mut changed = bytes.clone();
                changed[at] = value;
                seal(&mut changed);
                outcomes.add(outcome(&changed));
            }
        }
    }
    outcomes.print("header bytes");
    assert!(outcomes.of("picture") > 0 && outcomes.of("format") > 0 && outcomes.of("limit") > 0);
}

#[test]
fn mutations_with_valid_checksums_are_refused_or_valid() {
    let (mut outcomes, files) = (Outcomes::default(), sound().into_iter().map(|(_, bytes)| bytes).collect::<Vec<_>>());
    for bytes in mutations(&files, 10_000) {
        outcomes.add(outcome(&bytes));
    }
    outcomes.print("mutations");
    assert!(outcomes.of("picture") > 100 && outcomes.of("format") > 1000, "the mutations have lost their bite");
}

#[test]
fn partial_reading_shows_the_intact_groups_and_counts_the_rest() {
    let mut seen = Outcomes::default();
    for (name, bytes) in sound() {
        let whole = read(&bytes[..], &tight()).unwrap();
        // Long files take most of the time, so only every seventh bit of them is flipped, at all positions in a byte.
        for bit in (0..8 * bytes.len()).step_by(if bytes.len() < 1024 { 1 } else { 7 }) {
            let mut hurt = bytes.clone();
            hurt[bit / 8] ^= 1 << (bit % 8);
            seen.add(match read_partial(&hurt, &tight()) {
                Ok((part, missing)) => {
                    let lost = whole.gaussians.len() - part.gaussians.len();
                    assert_eq!(missing.gaussians as usize, lost, "{name} with bit {bit} flipped");
                    // The order is kept, so one pass over the whole finds them all.
                    let mut rest = whole.gaussians.iter();
                    assert!(part.gaussians.iter().all(|p| rest.any(|q| q == p)), "{name} with bit {bit} flipped");
                    if missing == MissingParts::default() { "whole" } else { "part" }
                }
                Err(e) => {
                    // Only damage to the header, the heads of sections and the directory can hide groups.
                    let intact = name.starts_with("groups") && bit / 8 > bytes.len() / 2;
                    assert!(!intact, "{name} with bit {bit} flipped: {e}");
                    kind(&e)
                }
            });
        }
    }
    seen.print("partial reading");
    assert!(seen.of("part") > 0);
}
