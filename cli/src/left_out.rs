//! Optional parts that a file does not contain, and the bytes that each would take, measured by writing the file with
//! it.

use ssplat::unstable::bitstream::report::Report;
use ssplat::unstable::bitstream::splats::{Layout, PackedSplats};

/// An optional part that a file does not contain.
#[derive(Debug, Clone, PartialEq)]
pub struct Absent {
    pub what: String,
    /// Bytes by which the part would enlarge the file; `None` if the file cannot be written with it.
    pub saved: Option<u64>,
}

/// Files of more Gaussians are not written again to measure sizes, because that takes seconds; their absent parts have
/// no sizes.
const MOST_WRITTEN: usize = 1 << 20;

/// Returns the optional parts that are absent from `splats`, the file that `report` describes.
pub fn of_file(splats: &PackedSplats, report: &Report) -> Vec<Absent> {
    let mut list = Vec::new();
    let mut add = |what: String, with: Option<PackedSplats>| {
        let written = with.and_then(|w| ssplat::unstable::bitstream::to_bytes(&w).ok());
        // A part that would make the file smaller was not left out to save bytes.
        let saved = written.map(|w| w.len() as i64 - report.bytes as i64);
        if saved.is_none_or(|s| s >= 0) {
            list.push(Absent { what, saved: saved.map(|s| s as u64) });
        }
    };
    match &splats.codebook {
        Some(book) => add(
            format!("a separate colour for each Gaussian: {} colours suffice", book.len()),
            small(splats).map(|s| PackedSplats { codebook: None, ..s.clone() }),
        ),
        None if splats.gaussians.is_empty() => {}
        None => add(
            "codebook of colours: too few colours occur more than once".into(),
            small(splats).and_then(with_codebook),
        ),
    }
    if splats.layout == Layout::Coded && splats.levels.len() < 2 && splats.gaussians.len() > 2 {
        add("progressive levels: 3 of them".into(), small(splats).map(with_levels));
    }
    let count = splats.gaussians.len();
    let round = splats.gaussians.iter().filter(|g| g.major == g.minor).count();
    if round > 0 {
        add(format!("angles: {round} of {count} Gaussians are circular and need none"), None);
    }
    // With a codebook, the channels have no fields of their own.
    let own = count > 0 && splats.codebook.is_none() && splats.layout == Layout::Coded;
    let constant = |k: usize| own && splats.gaussians.iter().all(|g| g.color[k] == splats.gaussians[0].color[k]);
    if splats.channels.count() >= 3 && constant(1) && constant(2) {
        let bytes = bytes_of(report, &["colour 1", "colour 2"]);
        add(format!("chroma: constant, {bytes} bytes in total"), None);
    }
    if let Some(a) = splats.channels.alpha().filter(|&a| constant(a)) {
        let bytes = bytes_of(report, &["colour 0", "colour 1", "colour 2", "colour 3"][a..=a]);
        add(format!("alpha: constant, {bytes} bytes in total"), None);
    }
    if report.sections.is_empty() {
        add(
            "sections: no code points, ICC profile, EXIF block or thumbnail, and therefore no table of sections".into(),
            None,
        );
    }
    list
}

/// Returns `splats` if they are few enough to be written again.
fn small(splats: &PackedSplats) -> Option<&PackedSplats> {
    (splats.gaussians.len() <= MOST_WRITTEN).then_some(splats)
}

/// Returns the list as lines of text.
pub fn as_text(list: &[Absent]) -> String {
    let mut text = String::new();
    for a in list {
        text += &match a.saved {
            Some(saved) => format!("  {}: saves {saved} bytes\n", a.what),
            None => format!("  {}\n", a.what),
        };
    }
    text
}

/// Returns the bytes of the named fields, rounded up.
fn bytes_of(report: &Report, names: &[&str]) -> u64 {
    let fields = report.fields.iter().filter(|f| names.contains(&f.name));
    (fields.map(|f| f.bits).sum::<f64>() / 8.0).ceil() as u64
}

fn with_codebook(splats: &PackedSplats) -> Option<PackedSplats> {
    let mut colors: Vec<[i16; 4]> = splats.gaussians.iter().map(|g| g.color).collect();
    colors.sort_unstable();
    colors.dedup();
    (colors.len() <= 65536).then(|| PackedSplats { codebook: Some(colors), ..splats.clone() })
}

/// Divides the Gaussians into three levels, as the encoder does.
fn with_levels(splats: &PackedSplats) -> PackedSplats {
    let mut with = splats.clone();
    ssplat::unstable::divide(&mut with, 3);
    with
}
