//! The conformance vectors in `spec/vectors`: small files with the results that a decoder must return.
//!
//! `cargo test --release --test reading vectors -- --ignored` writes them again; the other tests compare the library with
//! them.

#[path = "../vectors_exact/mod.rs"]
mod vectors_exact;

use std::fs;
use std::path::{Path, PathBuf};

use crate::seal::{layer, seal};
use crate::sha256::sha256;
use crate::synthetic::{Levels, Random, Scene, any_primitive, scene, with_layer};
use ssplat::View;
use ssplat::unstable::bitstream::header::Header;
use ssplat::unstable::bitstream::lattice::Lattice;
use ssplat::unstable::bitstream::splats::{Layout, PackedGaussian, PackedSplats, Steps};
use ssplat::unstable::bitstream::{DetailHead, read, read_partial, to_bytes};
use ssplat::unstable::raster::reference;
use ssplat::{Blend, Channels, Cicp, Depth, Error, Limits, Pixels, Result, Samples};

/// The folders of the vectors.
const FOLDERS: [&str; 5] = ["valid", "invalid", "limits", "reduced", "partial"];

/// A file and its expected result.
struct Vector {
    folder: &'static str,
    name: String,
    shows: String,
    bytes: Vec<u8>,
    /// The size to render at, if it is not the picture's own.
    size: Option<[u32; 2]>,
}

/// Result of decoding a vector: a picture, or a kind of error and its message.
enum Outcome {
    Picture(Pixels),
    Refused(&'static str, String),
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("spec/vectors")
}

/// Returns the view of the whole picture at its own size or another.
fn view(splats: &PackedSplats, size: Option<[u32; 2]>) -> View {
    let full = View::new(splats.width, splats.height);
    size.map_or(full, |[width, height]| full.resized(width, height).unwrap())
}

/// Reads a file; for a vector of the folder `partial`, its intact parts.
fn splats_of(bytes: &[u8], folder: &str, limits: &Limits) -> Result<PackedSplats> {
    if folder == "partial" { read_partial(bytes, limits).map(|read| read.0) } else { read(bytes, limits) }
}

fn decode(bytes: &[u8], folder: &str, size: Option<[u32; 2]>) -> Outcome {
    let mut limits = Limits::default();
    // The same on every machine.
    limits.alloc = 1 << 30;
    let drawn = splats_of(bytes, folder, &limits)
        .and_then(|splats| splats.renderer(&view(&splats, size), &limits)?.render(splats.depth));
    match drawn {
        Ok(pixels) => Outcome::Picture(pixels),
        Err(e) => {
            let kind = match e {
                Error::Format(_) => "format",
                Error::UnsupportedVersion { .. } => "unsupported",
                Error::LimitExceeded { .. } => "limit",
                _ => "other",
            };
            Outcome::Refused(kind, e.to_string())
        }
    }
}

/// Renders the picture by its definition in double precision.
fn reference_pixels(bytes: &[u8], folder: &str, size: Option<[u32; 2]>) -> Pixels {
    let splats = splats_of(bytes, folder, &Limits::default()).unwrap();
    let view = view(&splats, size);
    let values = reference::layered(&splats, &view);
    let codes = values.into_iter().map(|v| reference::code(v, splats.depth));
    let samples = match splats.depth {
        Depth::Eight => Samples::U8(codes.map(|c| c as u8).collect()),
        Depth::Sixteen => Samples::U16(codes.collect()),
    };
    Pixels::new(view.width(), view.height(), splats.channels, samples).unwrap()
}

fn pam(pixels: &Pixels) -> Vec<u8> {
    let (kind, count) = match pixels.channels() {
        Channels::Grey => ("GRAYSCALE", 1),
        Channels::GreyAlpha => ("GRAYSCALE_ALPHA", 2),
        Channels::Rgb => ("RGB", 3),
        Channels::Rgba => ("RGB_ALPHA", 4),
    };
    let (top, samples) = match pixels.samples() {
        Samples::U8(v) => (255, v.clone()),
        Samples::U16(v) => (65535, v.iter().flat_map(|s| s.to_be_bytes()).collect()),
    };
    let (width, height) = (pixels.width(), pixels.height());
    let mut out = format!("P7\nWIDTH {width}\nHEIGHT {height}\nDEPTH {count}\nMAXVAL {top}\nTUPLTYPE {kind}\nENDHDR\n")
        .into_bytes();
    out.extend(samples);
    out
}

/// Returns the largest difference of two pictures in PAM, in code values; `None` if their sizes or formats differ.
fn difference(a: &[u8], b: &[u8]) -> Option<u16> {
    let body = |pam: &[u8]| pam.windows(7).position(|w| w == b"ENDHDR\n").map(|at| at + 7);
    let (start, deep) = (body(a)?, a.windows(12).any(|w| w == b"MAXVAL 65535"));
    if body(b)? != start || a[..start] != b[..start] || a.len() != b.len() {
        return None;
    }
    let codes = |pam: &[u8]| -> Vec<u16> {
        let body = &pam[start..];
        if deep {
            body.chunks(2).map(|c| u16::from_be_bytes([c[0], c[1]])).collect()
        } else {
            body.iter().map(|&c| c.into()).collect()
        }
    };
    Some(codes(a).into_iter().zip(codes(b)).map(|(a, b)| a.abs_diff(b)).max().unwrap_or(0))
}

/// Returns the largest error of a sample as a multiple of `tolerance`, which for colours grows with their transparency
/// in `b` (spec §5.5).
fn excess(a: &Pixels, b: &Pixels, tolerance: f64) -> f64 {
    let codes = |p: &Pixels| -> Vec<f64> {
        match p.samples() {
            Samples::U8(v) => v.iter().map(|&c| c.into()).collect(),
            Samples::U16(v) => v.iter().map(|&c| c.into()).collect(),
        }
    };
    let (count, alpha, top) = (b.channels().count(), b.channels().alpha(), f64::from(b.depth().max()));
    let mut worst = 0.0f64;
    for (got, want) in codes(a).chunks(count).zip(codes(b).chunks(count)) {
        for k in 0..count {
            let alpha = alpha.filter(|&a| a != k).map_or(1.0, |a| want[a] / top);
            worst = worst.max((got[k] - want[k]).abs() * (16.0 * alpha).min(1.0) / tolerance);
        }
    }
    worst
}

/// The two Gaussians of spec §10.
fn two(layout: Layout) -> PackedSplats {
    let steps = Steps { scale: 4, angle: 1, position: 0, coarsest: -1, range: 0, luma: 6, chroma: 2 };
    PackedSplats {
        width: 8,
        height: 8,
        channels: Channels::Rgb,
        depth: Depth::Eight,
        blend: Blend::Normalized,
        layout,
        steps,
        background: [16, 0, 0, 0],
        codebook: None,
        gaussians: vec![
            PackedGaussian { x: 6, y: 8, major: 12, minor: 8, angle: 5, color: [24, 4, -2, 0] },
            PackedGaussian { x: 12, y: 3, major: 8, minor: 8, angle: 0, color: [4, 0, 0, 0] },
        ],
        levels: Vec::new(),
        detail: None,
        exact: None,
        metadata: Default::default(),
    }
}

fn small(layout: Layout, channels: Channels, count: usize, codebook: bool, seed: u64) -> PackedSplats {
    scene(&Scene { layout, channels, size: [24, 16], count, codebook, seed, ..Scene::default() })
}

/// Primitives from the whole range of the integers, including the extreme cases of the formulas.
fn extreme(layout: Layout, steps: Steps, seed: u64) -> PackedSplats {
    let mut splats = two(layout);
    (splats.width, splats.height, splats.steps) = (19, 13, steps);
    let mut random = Random(seed);
    splats.gaussians = (0..60).map(|_| any_primitive(&splats, &mut random)).collect();
    for p in &mut splats.gaussians {
        p.color.iter_mut().take(3).for_each(|c| *c %= 100);
    }
    splats
}

fn valid() -> Vec<Vector> {
    use Layout::{Coded, Packed, Planes};
    let mut out = Vec::new();
    let mut add = |name: &str, shows: &str, bytes: Vec<u8>| {
        out.push(Vector { folder: "valid", name: name.into(), shows: shows.into(), bytes, size: None });
    };
    let bytes = |splats: &PackedSplats| to_bytes(splats).unwrap();
    for (layout, name) in [(Packed, "packed"), (Planes, "planes"), (Coded, "coded")] {
        add(&format!("{name}-two"), "the two Gaussians of section 10", bytes(&two(layout)));
        let mut empty = two(layout);
        empty.gaussians.clear();
        add(&format!("{name}-empty"), "no primitive: the background everywhere", bytes(&empty));
        for (channels, kind, seed) in [
            (Channels::Grey, "grey", 1),
            (Channels::GreyAlpha, "grey-alpha", 2),
            (Channels::Rgb, "rgb", 3),
            (Channels::Rgba, "rgba", 4),
        ] {
            let mut splats = small(layout, channels, 40, false, seed);
            splats.depth = if seed % 2 == 0 { Depth::Sixteen } else { Depth::Eight };
            let depth = if seed % 2 == 0 { 16 } else { 8 };
            add(&format!("{name}-{kind}"), &format!("{kind} with {depth} bits, 40 primitives"), bytes(&splats));
        }
        add(&format!("{name}-codebook"), "colours in a codebook", bytes(&small(layout, Channels::Rgb, 40, true, 5)));
        let mut sum = small(layout, Channels::Rgb, 12, false, 6);
        sum.blend = Blend::Sum;
        add(&format!("{name}-sum"), "the sum blend", bytes(&sum));
        let mut equal = two(layout);
        equal.gaussians = vec![equal.gaussians[0]; 20];
        add(&format!("{name}-equal"), "20 equal primitives", bytes(&equal));
        let mut dot = two(layout);
        (dot.width, dot.height) = (1, 1);
        dot.gaussians.truncate(1);
        (dot.gaussians[0].x, dot.gaussians[0].y) = (1, 0);
        add(&format!("{name}-dot"), "a picture of one pixel", bytes(&dot));
        let thin = scene(&Scene { layout, size: [1, 90], count: 25, seed: 7, ..Scene::default() });
        add(&format!("{name}-thin"), "one pixel wide, 90 high", bytes(&thin));
    }
    for (k, steps) in [
        Steps { scale: 0, angle: 0, position: 15, coarsest: 5, range: 15, luma: 3, chroma: 0 },
        Steps { scale: 15, angle: 3, position: 0, coarsest: 9, range: 15, luma: 0, chroma: 3 },
        Steps { scale: 2, angle: 2, position: 7, coarsest: 0, range: 10, luma: 15, chroma: 1 },
        Steps { scale: 1, angle: 1, position: 4, coarsest: -6, range: 4, luma: 9, chroma: 2 },
    ]
    .into_iter()
    .enumerate()
    {
        let shows = "primitives from all over the integers: needles, huge and tiny ones, steps at their edges";
        add(&format!("coded-extreme-{k}"), shows, bytes(&extreme(Coded, steps, 10 + k as u64)));
        add(&format!("planes-extreme-{k}"), shows, bytes(&extreme(Planes, steps, 20 + k as u64)));
    }
    add("coded-many", "700 primitives: long runs of every model", {
        bytes(&scene(&Scene { size: [48, 32], count: 700, seed: 8, ..Scene::default() }))
    });
    add("planes-many", "700 primitives: zstd frames with literals and sequences", {
        bytes(&scene(&Scene { layout: Planes, size: [48, 32], count: 700, seed: 8, ..Scene::default() }))
    });
    let mut sparse = small(Coded, Channels::Rgb, 9, false, 9);
    for p in &mut sparse.gaussians {
        (p.major, p.minor, p.angle) = (16, 16, 0);
        (p.x, p.y) = (p.x % 48, p.y % 32);
    }
    add("coded-sparse", "gaps between primitives, where a small sum of weights divides", bytes(&sparse));
    let mut levels = small(Coded, Channels::Rgb, 60, false, 11);
    levels.gaussians.sort_by_key(|p| std::cmp::Reverse(p.major));
    levels.levels = vec![10, 20, 30];
    add("groups-levels", "three levels, a group each", bytes(&levels));
    let mut book = small(Coded, Channels::Rgba, 40, true, 12);
    book.levels = vec![25, 15];
    add("groups-codebook", "two levels with a codebook", bytes(&book));
    let mut divided =
        scene(&Scene { channels: Channels::Grey, size: [64, 64], count: 2300, seed: 13, ..Scene::default() });
    for p in divided.gaussians.iter_mut().step_by(23) {
        (p.x, p.y, p.major, p.minor, p.angle) = (p.x % 8, p.y % 8, 44, 40, 0);
    }
    divided.levels = vec![20, 2280];
    add("groups-divided", "two levels, the second in two groups and one of what stays undivided", bytes(&divided));
    let mut vivid = small(Coded, Channels::Rgba, 50, false, 14);
    let most = vivid.quantizer().most_color();
    for (k, p) in vivid.gaussians.iter_mut().enumerate() {
        p.color = std::array::from_fn(|i| {
            if k % 3 == 0 { p.color[i].saturating_mul(1 << (k % 15)).clamp(-most[i], most[i]) } else { p.color[i] }
        });
    }
    add("coded-vivid", "colours far from what is expected, up to the ends of their range", bytes(&vivid));
    let mut with = two(Packed);
    with.metadata.icc = Some(b"not a real profile".to_vec());
    with.metadata.exif = Some(b"II*\0\x08\0\0\0\0\0\0\0".to_vec());
    let carried = bytes(&with);
    add("sections", "an ICC profile and an EXIF block", carried.clone());
    let mut hurt = carried.clone();
    let at = hurt.windows(8).position(|w| w == b"not a re").unwrap();
    hurt[at] ^= 0x20;
    add("sections-damaged", "the ICC profile is damaged: the picture decodes without it", hurt);
    let mut small = two(Coded);
    (small.width, small.height) = (4, 4);
    for p in &mut small.gaussians {
        (p.x, p.y, p.major, p.minor) = (p.x / 2, p.y / 2, p.major - 4, p.minor - 4);
    }
    let mut with = two(Packed);
    with.metadata.thumbnail = Some(bytes(&small));
    add("sections-thumbnail", "a thumbnail of half the sides, a file of its own", bytes(&with));
    let mut with = two(Packed);
    with.metadata.cicp = Some(Cicp::BT2100_PQ);
    let cicp = bytes(&with);
    add("cicp", "the code points 9, 16, 0, 1: BT.2020 primaries, PQ, full range", cicp.clone());
    with.metadata.icc = Some(b"not a real profile".to_vec());
    with.metadata.cicp = Cicp::from_bytes(&[255, 200, 0, 0]).ok();
    add("cicp-and-profile", "reserved code points of narrow range, beside an ICC profile", bytes(&with));
    add("cicp-damaged", "code points with a wrong checksum and an illegal matrix: the picture decodes without them", {
        let mut hurt = cicp;
        let at = hurt.windows(4).position(|w| w == [9, 16, 0, 1]).unwrap();
        hurt[at + 2] = 9;
        hurt
    });
    add("sections-unknown", "an optional section that this version does not know", renamed(&carried, b"iccp", b"zzzz"));
    add("sections-most", "64 sections, the most", with_sections(&bytes(&two(Packed)), 64));
    out
}

/// Files with values that have no effect (spec §1), which decoders accept and ignore.
fn ignored() -> Vec<Vector> {
    let mut out = Vec::new();
    let mut add = |name: &str, shows: &str, splats: &PackedSplats| {
        let (name, bytes) = (format!("ignored-{name}"), to_bytes(splats).unwrap());
        out.push(Vector { folder: "valid", name, shows: shows.into(), bytes, size: None });
    };
    for (layout, name) in [(Layout::Packed, "packed"), (Layout::Coded, "coded")] {
        let mut chroma = small(layout, Channels::Grey, 12, false, 31);
        chroma.steps.chroma = 3;
        add(&format!("{name}-chroma"), "grey, with a chroma step", &chroma);
        let mut position = two(layout);
        position.steps.position = 15;
        add(&format!("{name}-position"), "a position step at range 0", &position);
        let mut angle = two(layout);
        angle.steps.angle = 3;
        for p in &mut angle.gaussians {
            (p.minor, p.angle) = (p.major, 0);
        }
        add(&format!("{name}-angle"), "an angle step without elongated primitives", &angle);
        let mut book = two(layout);
        let used = [book.gaussians[0].color, book.gaussians[1].color];
        book.codebook = Some(vec![used[0], used[1], [-100, 3, 4, 0], [90, 0, 0, 0]]);
        add(&format!("{name}-colours"), "a codebook of four colours, two of them unused", &book);
        book.gaussians.clear();
        add(&format!("{name}-codebook"), "a codebook without primitives", &book);
    }
    let mut metadata = small(Layout::Packed, Channels::Grey, 12, false, 32);
    // The start of a profile of RGB in a grey file; the rest of it is missing.
    let mut profile = vec![0; 40];
    profile[12..20].copy_from_slice(b"mntrRGB ");
    (metadata.metadata.icc, metadata.metadata.exif) = (Some(profile), Some(Vec::new()));
    add("metadata", "a broken profile of another colour space, and an empty EXIF block", &metadata);
    out
}

/// Adds `count` empty sections to a file without sections.
fn with_sections(bytes: &[u8], count: u8) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    bytes[5] |= 0x80;
    let mut sections = vec![count];
    let at = header_length(&bytes);
    for i in 0..count {
        let name = [b'a', b'A' + i / 26, b'a', b'a' + i % 26];
        sections.extend(name);
        sections.push(0);
        sections.extend(section_checksum(&bytes, name, &[]));
    }
    bytes.splice(at..at, sections);
    seal(&mut bytes);
    bytes
}

/// Returns the checksum of a section of the file `bytes`, which covers the header.
fn section_checksum(bytes: &[u8], name: [u8; 4], contents: &[u8]) -> [u8; 4] {
    let header = crc32fast::hash(&bytes[..header_length(bytes)]).to_le_bytes();
    crc32fast::hash(&[&header[..], &name, contents].concat()).to_le_bytes()
}

fn header_length(bytes: &[u8]) -> usize {
    let mut rest = bytes;
    Header::read(&mut rest, &Limits::default()).unwrap();
    bytes.len() - rest.len()
}

/// Renames a section of a file.
fn renamed(bytes: &[u8], from: &[u8; 4], to: &[u8; 4]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let at = bytes.windows(4).position(|w| w == from).unwrap();
    bytes[at..at + 4].copy_from_slice(to);
    let length = usize::from(bytes[at + 4]);
    let checksum = section_checksum(&bytes, *to, &bytes[at + 9..at + 9 + length]);
    bytes[at + 5..at + 9].copy_from_slice(&checksum);
    seal(&mut bytes);
    bytes
}

/// Returns the first of a series of seeded changes to `base` that is refused for `reason`.
fn refused_for(base: &[u8], reason: &str) -> Vec<u8> {
    let mut random = Random(17);
    for _ in 0..20_000 {
        let mut bytes = base.to_vec();
        for _ in 0..1 + random.below(3) {
            let at = 12 + random.below(bytes.len() as u64 - 16) as usize;
            bytes[at] = random.next() as u8;
        }
        seal(&mut bytes);
        if let Outcome::Refused("format", text) = decode(&bytes, "invalid", None)
            && text.contains(&format!("file: {reason} "))
        {
            return bytes;
        }
    }
    panic!("no change is refused for {reason}");
}

fn invalid() -> Vec<Vector> {
    use Layout::{Coded, Packed, Planes};
    let mut out = Vec::new();
    let mut add = |name: &str, shows: &str, bytes: Vec<u8>| {
        out.push(Vector { folder: "invalid", name: name.into(), shows: shows.into(), bytes, size: None });
    };
    let packed = to_bytes(&two(Packed)).unwrap();
    let planes = to_bytes(&two(Planes)).unwrap();
    let coded = to_bytes(&two(Coded)).unwrap();
    // Changes a byte and corrects the checksum.
    let changed = |base: &[u8], at: usize, value: u8| {
        let mut bytes = base.to_vec();
        bytes[at] = value;
        seal(&mut bytes);
        bytes
    };
    let spliced = |base: &[u8], at: usize, remove: usize, insert: &[u8]| {
        let mut bytes = base.to_vec();
        bytes.splice(at..at + remove, insert.iter().copied());
        seal(&mut bytes);
        bytes
    };
    add("empty-file", "no byte at all", Vec::new());
    add("signature-seven-bits", "the signature after a transfer with 7 bits", changed(&packed, 0, 9));
    add("version-7", "a newer version", changed(&packed, 4, 7));
    add("version-5", "a version from before the first release", changed(&packed, 4, 5));
    add("width-0", "no pixels", changed(&packed, 6, 0));
    add("height-huge", "a height of 2^20 + 1", spliced(&packed, 7, 1, &[0x81, 0x80, 0x40]));
    add("width-long", "a width in more bytes than it needs", spliced(&packed, 6, 1, &[0x88, 0]));
    add("packed-range", "a range of position steps in the packed layout", changed(&packed, 11, 0x15));
    add("steps-fine", "a finest position step below 2^-10 pixels", changed(&coded, 11, 0x90));
    add("header-cut", "the file ends in the header", packed[..9].to_vec());
    add("checksum-cut", "the file ends before its checksum", packed[..packed.len() - 4].to_vec());
    add("checksum", "a wrong bit in the payload", {
        let mut bytes = packed.clone();
        bytes[26] ^= 1;
        bytes
    });
    add("count-without-bytes", "a million primitives in a few bytes", spliced(&coded, 8, 1, &[0xc0, 0x84, 0x3d]));
    let end = |base: &[u8]| base.len() - 4;
    add("packed-trailing", "a byte too many", spliced(&packed, end(&packed), 0, &[0]));
    add("planes-trailing", "a byte too many", spliced(&planes, end(&planes), 0, &[7]));
    add("coded-trailing-zero", "a zero byte too many", spliced(&coded, end(&coded), 0, &[0]));
    add("coded-trailing", "a byte too many", spliced(&coded, end(&coded), 0, &[1]));
    add("coded-start", "a stream that starts with FF FF FF FF", spliced(&coded, 12, 4, &[255; 4]));

    let mut with = two(Packed);
    with.metadata.icc = Some(b"profile".to_vec());
    with.metadata.exif = Some(b"II*\0".to_vec());
    let sections = to_bytes(&with).unwrap();
    add("section-critical", "a critical section that this version does not know", renamed(&sections, b"exif", b"Newx"));
    add("section-order", "sections out of order", renamed(&sections, b"exif", b"zzzz"));
    add("section-name", "a section whose name is not made of letters", renamed(&sections, b"exif", b"ex1f"));
    let mut with = two(Packed);
    with.metadata.cicp = Some(Cicp::BT2100_PQ);
    let cicp = to_bytes(&with).unwrap();
    let at = cicp.windows(4).position(|w| w == [9, 16, 0, 1]).unwrap();
    let other = |contents: &[u8]| {
        let mut bytes = cicp.clone();
        bytes.splice(at..at + 4, contents.iter().copied());
        bytes[at - 5] = contents.len() as u8;
        renamed(&bytes, b"cicp", b"cicp")
    };
    add("cicp-empty", "code points of no bytes", other(&[]));
    add("cicp-short", "code points of three bytes", other(&[9, 16, 0]));
    add("cicp-long", "code points of five bytes", other(&[9, 16, 0, 1, 0]));
    add("cicp-matrix", "code points with matrix coefficients of YCbCr", other(&[9, 16, 9, 1]));
    add("cicp-range", "code points with a full-range flag of 2", other(&[9, 16, 0, 2]));
    add("section-none", "the flag for sections, and none", {
        let mut bytes = changed(&packed, 5, packed[5] | 0x80);
        bytes.insert(12, 0);
        seal(&mut bytes);
        bytes
    });
    add("section-count", "65 sections: more than a file may have", with_sections(&packed, 65));
    add("section-cut", "a section that is longer than the file", changed(&sections, 17, 0x7f));

    let coarse = Steps { scale: 2, angle: 2, position: 7, coarsest: 4, range: 10, luma: 15, chroma: 1 };
    // The smallest scale is four squares above the finest.
    let sparse = Steps { scale: 4, angle: 1, position: 0, coarsest: 0, range: 6, luma: 4, chroma: 1 };
    let codebook = |layout| to_bytes(&small(layout, Channels::Rgb, 40, true, 5)).unwrap();
    let scene = |layout| to_bytes(&small(layout, Channels::Rgb, 40, false, 3)).unwrap();
    let mut levels = small(Coded, Channels::Rgb, 60, false, 11);
    levels.levels = vec![10, 20, 30];
    let groups = to_bytes(&levels).unwrap();
    add("groups-directory", "a wrong bit in the directory, under a right checksum of the file", {
        let mut bytes = groups.clone();
        bytes[16] ^= 1;
        let body = bytes.len() - 4;
        let checksum = crc32fast::hash(&bytes[..body]).to_le_bytes();
        bytes[body..].copy_from_slice(&checksum);
        bytes
    });
    add("groups-group", "a wrong bit in a group, under a right checksum of the file", {
        let mut bytes = groups.clone();
        let body = bytes.len() - 4;
        bytes[body - 1] ^= 1;
        let checksum = crc32fast::hash(&bytes[..body]).to_le_bytes();
        bytes[body..].copy_from_slice(&checksum);
        bytes
    });
    let book = vec![[4, 0, 0, 0], [24, 4, -2, 0]];
    let book = to_bytes(&PackedSplats { codebook: Some(book), ..two(Packed) }).unwrap();
    add("packed-codebook-colour", "a codebook's colour beyond 8", spliced(&book, 16, 3, &[0xcc, 0x88, 0x02]));
    // Checks of zstd frames that every decoder must make, whatever its library tolerates.
    let equal_planes = PackedSplats { layout: Planes, gaussians: vec![two(Planes).gaussians[0]; 300], ..two(Planes) };
    let frames = to_bytes(&equal_planes).unwrap();
    let frame = frames.windows(5).position(|w| w == [0x28, 0xb5, 0x2f, 0xfd, 0]).unwrap();
    add("planes-checksum", "planes that are not those of their checksum", {
        let mut bytes = planes.clone();
        let at = bytes.len() - 9;
        bytes[at] ^= 1;
        let body = bytes.len() - 4;
        let checksum = crc32fast::hash(&bytes[..body]).to_le_bytes();
        bytes[body..].copy_from_slice(&checksum);
        bytes
    });
    add("planes-frame-checksum", "a zstd frame whose head names a checksum", changed(&frames, frame + 4, 4));
    add("planes-frame-window", "a zstd frame with a window of 96 MiB", changed(&frames, frame + 5, 0x84));
    add("planes-frame-block", "a zstd frame with a block of a reserved kind", changed(&frames, frame + 6, 7));

    for (name, base, reasons) in [
        (
            "packed",
            packed.clone(),
            &[
                "record field width",
                "sum of tile counts",
                "padding of a record",
                "order of records",
                "record format",
                "minor scale",
                "angle",
                "background",
                "colour",
            ][..],
        ),
        ("packed", codebook(Packed), &["codebook size", "codebook order", "codebook index"]),
        (
            "planes",
            scene(Planes),
            &["bytes of a field", "position", "aspect", "compressed stream of", "x", "angle", "colour"],
        ),
        ("coded", scene(Coded), &["end of the coded stream"]),
        ("coded", to_bytes(&extreme(Coded, coarse, 30)).unwrap(), &["x", "y", "colour"]),
        ("coded", to_bytes(&extreme(Coded, sparse, 30)).unwrap(), &["square without a scale"]),
        ("coded", to_bytes(&equal()).unwrap(), &["order of Gaussians"]),
        ("coded", codebook(Coded), &["codebook order", "codebook index"]),
        ("groups", groups, &["level count", "level", "largest scale of a group", "end of the coded stream"]),
    ] {
        for reason in reasons {
            // The names of vectors are permanent.
            let name = format!("{name}-{}", reason.replace("Gaussians", "primitives").replace(' ', "-"));
            add(&name, &format!("refused for: {reason}"), refused_for(&base, reason));
        }
    }
    out
}

/// Many primitives in one square.
fn equal() -> PackedSplats {
    let mut splats = two(Layout::Coded);
    splats.gaussians = vec![splats.gaussians[0]; 30];
    splats
}

fn limits() -> Vec<Vector> {
    let mut out = Vec::new();
    let mut add = |name: &str, shows: &str, bytes: Vec<u8>| {
        out.push(Vector { folder: "limits", name: name.into(), shows: shows.into(), bytes, size: None });
    };
    let mut huge = two(Layout::Coded);
    (huge.width, huge.height) = (1 << 20, 1 << 20);
    huge.gaussians.clear();
    add("huge-picture", "a terapixel in a few bytes", to_bytes(&huge).unwrap());
    let mut bytes = to_bytes(&two(Layout::Coded)).unwrap();
    bytes.splice(8..9, [255, 255, 255, 255, 15]);
    seal(&mut bytes);
    add("many-primitives", "a count of 2^32 - 1", bytes);
    // Every primitive covers every tile.
    let mut heavy = two(Layout::Coded);
    (heavy.width, heavy.height) = (4096, 4096);
    (heavy.steps.coarsest, heavy.steps.position) = (9, 0);
    let wide = PackedGaussian { x: 4, y: 4, major: 60, minor: 60, angle: 0, color: [9, 0, 0, 0] };
    heavy.gaussians = vec![wide; 1700];
    add("heavy-overlap", "1700 primitives that each cover 16 million pixels", to_bytes(&heavy).unwrap());
    out
}

/// A few Gaussians under a layer.
fn ground(channels: Channels, size: [u32; 2], seed: u64) -> PackedSplats {
    scene(&Scene { channels, size, count: 6, seed, ..Scene::default() })
}

/// Returns the plain preset with the given step.
fn plain(step: u16) -> DetailHead {
    let mut head = DetailHead::PLAIN;
    head.step = step;
    head
}

/// Four tiles in a row, of which the second has no levels.
fn row_of_tiles() -> PackedSplats {
    let levels = Levels { filled: 6, empty: Some(1), ..Levels::new(31) };
    with_layer(ground(Channels::Grey, [770, 4], 31), plain(800), levels)
}

/// Levels of primitives in groups, with a layer.
fn groups_with_layer() -> PackedSplats {
    let mut splats = small(Layout::Coded, Channels::Rgb, 60, false, 11);
    splats.gaussians.sort_by_key(|p| std::cmp::Reverse(p.major));
    splats.levels = vec![10, 20, 30];
    with_layer(splats, plain(700), Levels::new(32))
}

/// Files with a detail layer.
fn layered() -> Vec<Vector> {
    let mut out = Vec::new();
    let mut add = |name: &str, shows: &str, splats: &PackedSplats| {
        let bytes = to_bytes(splats).unwrap();
        out.push(Vector { folder: "valid", name: format!("detail-{name}"), shows: shows.into(), bytes, size: None });
    };
    let seen = |step| {
        let mut head = DetailHead::SEEN;
        head.step = step;
        head
    };
    let rgb = |seed| ground(Channels::Rgb, [40, 24], seed);
    let grey = |size| ground(Channels::Grey, size, 21);
    let levels = Levels::new;
    add("rgb", "a detail layer on colour: the first preset", &with_layer(rgb(21), plain(700), levels(21)));
    add("seen", "the second preset: slopes and four step classes", &with_layer(rgb(22), seen(500), levels(22)));
    add("grey", "a detail layer on grey", &with_layer(grey([40, 24]), plain(900), levels(23)));
    let mut alpha = plain(800);
    alpha.alpha = true;
    let deep = |channels| PackedSplats { depth: Depth::Sixteen, ..ground(channels, [33, 17], 24) };
    add("grey-16", "grey with 16 bits", &with_layer(deep(Channels::Grey), plain(800), levels(24)));
    add(
        "grey-alpha",
        "grey and alpha with 16 bits, a plane each",
        &with_layer(deep(Channels::GreyAlpha), alpha, levels(25)),
    );
    let rgba = ground(Channels::Rgba, [33, 17], 26);
    add(
        "rgba",
        "alpha without a plane stays as the Gaussians have it",
        &with_layer(rgba.clone(), plain(800), levels(26)),
    );
    add("rgba-plane", "alpha with a plane", &with_layer(rgba, alpha, levels(27)));
    let sum = PackedSplats { blend: Blend::Sum, ..rgb(28) };
    add("sum", "a layer on the sum blend", &with_layer(sum, plain(700), levels(28)));
    for size in 0..4u8 {
        let mut head = plain(700);
        head.sizes = [[size; 2]; 2];
        let dense = Levels { filled: 1, most: 12 << (2 * size), largest: 3, ..levels(29) };
        let shows = format!("blocks of {} pixels a side alone, densely filled", 4 << size);
        add(&format!("blocks-{}", 4 << size), &shows, &with_layer(grey([35, 33]), head, dense));
    }
    let mut mixed = plain(700);
    mixed.sizes = [[1, 2], [0, 3]];
    let sparse = Levels { filled: 8, most: 3, ..levels(30) };
    add("blocks-mixed", "blocks of 8 and 16 for luma, of 4 to 32 for chroma", &with_layer(rgb(30), mixed, sparse));
    for classes in 2..=8u8 {
        let mut head = seen(400);
        head.classes = classes;
        let few = Levels { filled: 6, most: 5, ..levels(u64::from(classes)) };
        let shows = format!("{classes} step classes, in a row");
        add(&format!("classes-{classes}"), &shows, &with_layer(grey([256, 2]), head, few));
    }
    let mut eight = plain(700);
    eight.classes = 8;
    let few = Levels { filled: 25, most: 4, ..levels(9) };
    add("classes", "8 step classes, in rows and columns", &with_layer(grey([66, 65]), eight, few));
    let mut odd = plain(300);
    (odd.chroma, odd.slopes, odd.biases) = ([255, 1], [255, 9], [15, 11]);
    add("odd", "ratios, slopes and biases at their ends", &with_layer(rgb(33), odd, levels(33)));
    let mut huge = plain(65_535);
    (huge.chroma, huge.slopes, huge.classes) = ([255, 255], [255, 255], 8);
    let wide = Levels { filled: 3, most: 6, largest: 32_767, ..levels(34) };
    add("largest", "largest steps and levels: sums beyond 32 bits wrap", &with_layer(rgb(34), huge, wide));
    let large = Levels { filled: 4, most: 9, largest: 32_767, ..levels(35) };
    add("large-levels", "large levels of the smallest step", &with_layer(rgb(35), plain(1), large));
    let middling = Levels { filled: 4, most: 30, largest: 60, ..levels(36) };
    add("middling-levels", "levels around 15, where the code changes", &with_layer(rgb(36), plain(40), middling));
    let none = Levels { filled: 0, ..levels(37) };
    add("empty", "a layer without levels", &with_layer(rgb(37), plain(640), none));
    add("tiles-row", "four tiles in a row, the second empty", &row_of_tiles());
    let column = Levels { filled: 6, ..levels(38) };
    add(
        "tiles-column",
        "three tiles in a column",
        &with_layer(ground(Channels::Grey, [3, 520], 38), plain(800), column),
    );
    let dot = Levels { filled: 1, ..levels(39) };
    add(
        "dot",
        "a picture of one pixel",
        &with_layer(PackedSplats { width: 1, height: 1, ..no_primitives() }, plain(640), dot),
    );
    add("groups", "a layer behind groups", &groups_with_layer());
    let mut carried = with_layer(rgb(40), plain(700), levels(40));
    carried.metadata.icc = Some(b"not a real profile".to_vec());
    add("sections", "a layer and an ICC profile", &carried);
    out
}

/// A background without primitives.
fn no_primitives() -> PackedSplats {
    PackedSplats { gaussians: Vec::new(), ..two(Layout::Coded) }
}

/// Sets the checksum of the file, and no other.
fn seal_file(bytes: &mut [u8]) {
    for _ in 0..2 {
        let Err(Error::Format(ssplat::FormatError::Checksum { what: "file", stored, computed })) =
            read(&*bytes, &Limits::default())
        else {
            return;
        };
        let at = bytes.windows(4).rposition(|w| w == stored.to_le_bytes()).unwrap();
        bytes[at..at + 4].copy_from_slice(&computed.to_le_bytes());
    }
}

/// A file with a modified section `Dtal` and correct checksums of section and file.
fn headed(base: &[u8], change: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let at = layer::layout(base).unwrap();
    let mut contents = base[at.contents.clone()].to_vec();
    change(&mut contents);
    let mut section = b"Dtal".to_vec();
    section.push(contents.len() as u8);
    section.extend(section_checksum(base, *b"Dtal", &contents));
    section.extend(contents);
    let mut bytes = base.to_vec();
    bytes.splice(at.section, section);
    seal_file(&mut bytes);
    bytes
}

/// Files with an invalid layer.
fn broken_layers() -> Vec<Vector> {
    let mut out = Vec::new();
    let mut add = |name: &str, shows: &str, bytes: Vec<u8>| {
        out.push(Vector { folder: "invalid", name: format!("detail-{name}"), shows: shows.into(), bytes, size: None });
    };
    let ground = || small(Layout::Coded, Channels::Rgb, 6, false, 51);
    let base = to_bytes(&with_layer(ground(), plain(700), Levels::new(51))).unwrap();
    // Offsets in the contents: a byte of length, four of checksum, two of step, the flags.
    const STEP: usize = 5;
    const FLAGS: usize = 7;
    let flagged = |bit: u8, fields: &[u8]| {
        headed(&base, |c| {
            c[FLAGS] |= bit;
            c.extend(fields);
        })
    };
    add("step", "a step of 0", headed(&base, |c| c[STEP..STEP + 2].fill(0)));
    add("flag", "the reserved flag", flagged(128, &[]));
    add("chroma", "a chroma step of 0", flagged(1, &[39, 0]));
    add("sizes", "a smallest block that is larger than the largest", flagged(4, &[0b11_10_01_10]));
    add("classes-0", "no step class", flagged(16, &[0]));
    add("classes-9", "nine step classes", flagged(16, &[9]));
    add("said-twice", "slopes that the preset has already", flagged(2, &[0, 0]));
    add("other-preset", "the preset that takes more bytes", flagged(64 | 1 | 2 | 8 | 16, &[39, 32, 0, 0, 0x42, 1]));
    add("alpha", "a plane of alpha in a picture without", flagged(32, &[]));
    add("section-cut", "a section that ends before its flags", headed(&base, |c| c.truncate(FLAGS)));
    add("section-long", "a byte too many in the section", headed(&base, |c| c.push(0)));
    add("payload-short", "a payload that is a byte longer", headed(&base, |c| c[0] -= 1));
    add("payload-long", "a payload that is a byte shorter", headed(&base, |c| c[0] += 1));
    add(
        "payload-beyond",
        "a payload that is longer than the file",
        headed(&base, |c| drop(c.splice(0..1, [255, 127]))),
    );
    add("payload-checksum", "a wrong checksum of the payload", headed(&base, |c| c[1] ^= 1));
    let at = layer::layout(&base).unwrap();
    let file = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = base.clone();
        change(&mut bytes);
        seal_file(&mut bytes);
        bytes
    };
    add("section-checksum", "a wrong bit in the section", {
        let mut bytes = base.clone();
        bytes[at.contents.start + STEP] ^= 1;
        bytes
    });
    let (check, stream) = at.tiles[0].clone();
    add("check", "a wrong check of a tile", file(&|b| b[check.start] ^= 1));
    add("tile", "a wrong bit in a tile", file(&|b| b[stream.start + 3] ^= 1));
    let end = base.len() - 4;
    add("index", "no index", file(&|b| drop(b.drain(at.payload.end..end))));
    add("index-cut", "an index that ends before the check", file(&|b| drop(b.drain(at.payload.end + 1..end))));
    add(
        "tile-beyond",
        "a tile that is longer than the file",
        file(&|b| drop(b.splice(at.payload.end..check.start, [255, 127]))),
    );
    add("trailing", "a byte behind the last tile", file(&|b| b.insert(end, 7)));
    let longer = |byte: u8| {
        let mut bytes = base.clone();
        bytes.insert(end, byte);
        // The length of a single tile, in one byte or two.
        let mut length = (stream.end - stream.start + 1) as u64;
        let place = at.payload.end..check.start;
        let mut varint = Vec::new();
        while length >= 128 {
            varint.push(length as u8 | 128);
            length >>= 7;
        }
        varint.push(length as u8);
        bytes.splice(place, varint);
        seal(&mut bytes);
        bytes
    };
    add("stream-trailing", "a byte too many in a tile's stream", longer(1));
    add("stream-trailing-zero", "a zero byte too many in a tile's stream", longer(0));
    let mut packed = to_bytes(&two(Layout::Packed)).unwrap();
    let payload = packed[12..packed.len() - 4].to_vec();
    packed[5] |= 0x80;
    let mut contents = vec![payload.len() as u8];
    contents.extend(crc32fast::hash(&[&packed[..12], &payload].concat()).to_le_bytes());
    contents.extend([64, 1, 0]);
    let mut sections = vec![1];
    sections.extend(b"Dtal");
    sections.push(contents.len() as u8);
    sections.extend(section_checksum(&packed, *b"Dtal", &contents));
    sections.extend(contents);
    packed.splice(12..12, sections);
    packed.insert(packed.len() - 4, 0);
    seal_file(&mut packed);
    add("packed", "a layer behind the packed layout", packed);

    let mut small = plain(700);
    small.sizes = [[0, 0], [0, 0]];
    let dense = Levels { filled: 1, most: 60, largest: 2, ..Levels::new(52) };
    let dense = to_bytes(&with_layer(ground(), small, dense)).unwrap();
    let wide = Levels { filled: 2, most: 9, largest: 32_767, ..Levels::new(53) };
    let wide = to_bytes(&with_layer(ground(), plain(700), wide)).unwrap();
    let mut single = plain(700);
    single.sizes = [[3, 3], [3, 3]];
    let dot = PackedSplats { width: 9, height: 9, channels: Channels::Grey, ..no_primitives() };
    let single = to_bytes(&with_layer(dot, single, Levels { filled: 1, most: 2, ..Levels::new(54) })).unwrap();
    for (reason, base) in
        [("levels of a block", dense), ("level", wide), ("levels of a tile", single), ("end of the coded stream", base)]
    {
        add(&reason.replace(' ', "-"), &format!("refused for: {reason}"), refused_for(&base, reason));
    }
    out
}

/// Damaged files with intact parts.
fn partial() -> Vec<Vector> {
    let mut out = Vec::new();
    let mut add = |name: &str, shows: &str, bytes: Vec<u8>| {
        out.push(Vector { folder: "partial", name: name.into(), shows: shows.into(), bytes, size: None });
    };
    let hurt = |bytes: &[u8], at: usize| {
        let mut bytes = bytes.to_vec();
        bytes[at] ^= 4;
        bytes
    };
    let mut levels = small(Layout::Coded, Channels::Rgb, 60, false, 11);
    levels.gaussians.sort_by_key(|p| std::cmp::Reverse(p.major));
    levels.levels = vec![10, 20, 30];
    let groups = to_bytes(&levels).unwrap();
    add("groups-cut", "cut in the last of three groups", groups[..groups.len() - 20].to_vec());
    let row = to_bytes(&row_of_tiles()).unwrap();
    let at = layer::layout(&row).unwrap();
    let (check, second) = at.tiles[1].clone();
    add("detail-tile", "a wrong bit in the third of four tiles: it adds nothing", hurt(&row, second.start + 2));
    add("detail-check", "a wrong check of the third tile", hurt(&row, check.start));
    add("detail-cut", "cut in the third tile: it and the last add nothing", row[..second.end - 1].to_vec());
    add("detail-cut-checksum", "cut in the file's checksum: all is there", row[..row.len() - 2].to_vec());
    add("detail-cut-index", "cut in the index: the Gaussians alone", row[..at.payload.end + 2].to_vec());
    add("detail-cut-layer", "cut behind the payload", row[..at.payload.end].to_vec());
    let both = to_bytes(&groups_with_layer()).unwrap();
    let at = layer::layout(&both).unwrap();
    add(
        "detail-groups",
        "a wrong bit in the last group: the layer is added to what is left",
        hurt(&both, at.payload.end - 9),
    );
    add("detail-groups-cut", "cut in the last group", both[..at.payload.end - 9].to_vec());
    out
}

/// Pictures for reduced views.
fn reduced() -> Vec<Vector> {
    let mut out = Vec::new();
    let mut add = |name: &str, shows: &str, splats: &PackedSplats, size: [u32; 2]| {
        let bytes = to_bytes(splats).unwrap();
        out.push(Vector { folder: "reduced", name: name.into(), shows: shows.into(), bytes, size: Some(size) });
    };
    let colour = small(Layout::Coded, Channels::Rgb, 40, false, 3);
    add("halves", "2 × 2 samples a pixel, none widened", &colour, [12, 8]);
    add("thirds", "samples 1.5 pixels apart along x, 1.33 along y, widened", &colour, [8, 6]);
    add("one-axis", "reduced along x, enlarged along y", &colour, [5, 40]);
    let mut sum = small(Layout::Packed, Channels::Grey, 20, false, 6);
    (sum.blend, sum.depth) = (Blend::Sum, Depth::Sixteen);
    add("sum", "the sum blend, 16 bits, 8 samples a side", &sum, [3, 2]);
    let mut logo = small(Layout::Coded, Channels::Rgba, 60, false, 4);
    logo.depth = Depth::Eight;
    // Y, Co and Cg of red, which is hidden, and of white; alpha.
    for p in &mut logo.gaussians {
        (p.major, p.minor, p.angle) = (p.major.min(24), p.minor.min(24), 0);
        let lattice = Lattice::new(&logo.steps, logo.layout);
        let [ex, ey] = lattice.exponents(p.major, p.minor, p.angle);
        p.x = p.x.min(Lattice::positions(logo.width, ex) - 1);
        p.y = p.y.min(Lattice::positions(logo.height, ey) - 1);
        let is_left = (f64::from(p.x) + 0.5) * f64::from(ex).exp2() < 11.0;
        p.color = if is_left { [32, 0, 0, 32] } else { [8, 16, -8, 0] };
    }
    logo.background = [8, 16, -8, 0];
    add("alpha", "white beside red that hides under alpha 0: colours count by their alpha", &logo, [5, 4]);
    add("alpha-pixel", "the same in one pixel, 8 × 8 samples, widened", &logo, [1, 1]);
    let mut grey = small(Layout::Coded, Channels::GreyAlpha, 40, false, 2);
    grey.depth = Depth::Sixteen;
    add("grey-alpha", "grey and alpha with 16 bits", &grey, [9, 5]);
    let layer = |channels| with_layer(ground(channels, [40, 24], 41), plain(900), Levels::new(41));
    add("detail-halves", "a detail layer: means of four pixels", &layer(Channels::Rgb), [20, 12]);
    add("detail-odd", "means over parts of pixels", &layer(Channels::Grey), [13, 7]);
    add("detail-larger", "a detail layer between the pixels", &layer(Channels::Rgb), [50, 31]);
    add("detail-one-axis", "reduced along x, enlarged along y", &layer(Channels::Grey), [9, 60]);
    add("detail-pixel", "all of a picture in one pixel", &layer(Channels::Rgb), [1, 1]);
    let mut alpha = plain(900);
    alpha.alpha = true;
    let alpha = with_layer(ground(Channels::Rgba, [40, 24], 42), alpha, Levels::new(42));
    add("detail-alpha", "additions to colours do not count by alpha", &alpha, [17, 10]);
    let tiles =
        with_layer(ground(Channels::Grey, [300, 290], 43), plain(1200), Levels { filled: 60, ..Levels::new(43) });
    add("detail-tiles", "four tiles, drawn small", &tiles, [21, 19]);
    out
}

fn all() -> Vec<Vector> {
    let gaussians = [valid(), ignored(), layered(), invalid(), broken_layers(), limits(), reduced(), partial()];
    gaussians.into_iter().chain([vectors_exact::all()]).flatten().collect()
}

/// Returns the case file of a vector, and its picture if it has one.
fn case(vector: &Vector) -> (String, Option<Vec<u8>>) {
    let mut text = format!("shows: {}\nsha256: {}\n", vector.shows, sha256(&vector.bytes));
    if vector.folder == "partial" {
        text += "partial: yes\n";
    }
    if let Some([width, height]) = vector.size {
        text += &format!("size: {width} {height}\n");
    }
    let picture = match (vector.folder, decode(&vector.bytes, vector.folder, vector.size)) {
        ("valid" | "reduced" | "partial", Outcome::Picture(pixels)) => {
            let tolerance = if matches!(pixels.samples(), Samples::U8(_)) { 1 } else { 257 };
            text += &format!("expect: picture\ntolerance: {tolerance}\n");
            Some(pam(&reference_pixels(&vector.bytes, vector.folder, vector.size)))
        }
        ("invalid" | "limits", Outcome::Refused(kind, reason)) => {
            text += &format!("expect: error\nkind: {kind}\nreason: {reason}\n");
            None
        }
        (_, Outcome::Picture(_)) => panic!("{}/{} is accepted", vector.folder, vector.name),
        (_, Outcome::Refused(_, reason)) => panic!("{}/{}: {reason}", vector.folder, vector.name),
    };
    (text, picture)
}

#[test]
#[ignore = "writes spec/vectors"]
fn write_vectors() {
    for folder in FOLDERS {
        let _ = fs::remove_dir_all(root().join(folder));
    }
    for vector in all() {
        let folder = root().join(vector.folder).join(&vector.name);
        fs::create_dir_all(&folder).unwrap();
        let (text, picture) = case(&vector);
        fs::write(folder.join("case.txt"), text).unwrap();
        fs::write(folder.join("file.ssplat"), &vector.bytes).unwrap();
        if let Some(picture) = picture {
            fs::write(folder.join("picture.pam"), picture).unwrap();
        }
    }
}

/// A vector on disk: name, the fields of the case file, the file, the picture.
type Stored = (String, Vec<(String, String)>, Vec<u8>, Option<Vec<u8>>);

/// The vectors on disk.
fn on_disk() -> Vec<Stored> {
    let mut out = Vec::new();
    for folder in FOLDERS {
        for entry in fs::read_dir(root().join(folder)).unwrap() {
            let path = entry.unwrap().path();
            let name = format!("{folder}/{}", path.file_name().unwrap().to_string_lossy());
            let text = fs::read_to_string(path.join("case.txt")).unwrap();
            let fields = text.lines().map(|l| l.split_once(": ").unwrap()).map(|(k, v)| (k.into(), v.into()));
            let file = fs::read(path.join("file.ssplat")).unwrap();
            out.push((name, fields.collect(), file, fs::read(path.join("picture.pam")).ok()));
        }
    }
    out
}

#[test]
#[cfg_attr(not(feature = "encode"), ignore = "without the encoder, planes are written without zstd")]
fn vectors_are_up_to_date() {
    let vectors = all();
    assert_eq!(on_disk().len(), vectors.len());
    for vector in vectors {
        let folder = root().join(vector.folder).join(&vector.name);
        // Versions of zstd write different frames, so the files of the planes layout may differ.
        if !vector.name.starts_with("planes") {
            assert!(fs::read(folder.join("file.ssplat")).unwrap() == vector.bytes, "{} has changed", vector.name);
        }
    }
}

#[test]
fn the_library_conforms_to_every_vector() {
    let mut counts = [0; 2];
    for (name, fields, file, picture) in on_disk() {
        let field = |key: &str| fields.iter().find(|f| f.0 == key).map(|f| f.1.as_str()).unwrap_or_default();
        assert_eq!(sha256(&file), field("sha256"), "{name}");
        let mut sides = field("size").split(' ').filter_map(|side| side.parse().ok());
        let size = sides.next().zip(sides.next()).map(|(width, height)| [width, height]);
        assert_eq!(size.is_some(), name.starts_with("reduced"), "{name}");
        let folder = name.split('/').next().unwrap();
        if folder == "partial" {
            assert!(read(&file[..], &Limits::default()).is_err(), "{name} is whole");
        }
        match decode(&file, folder, size) {
            Outcome::Picture(pixels) if size.is_some() => {
                let want = reference_pixels(&file, folder, size);
                assert_eq!(Some(pam(&want)), picture, "{name}");
                let excess = excess(&pixels, &want, field("tolerance").parse().unwrap());
                assert!(excess <= 1.0, "{name}: {excess} times the tolerance");
                counts[0] += 1;
            }
            Outcome::Picture(pixels) => {
                assert_eq!(field("expect"), "picture", "{name} is accepted");
                let worst = difference(&pam(&pixels), &picture.expect("a picture")).expect("pictures of one kind");
                assert!(worst <= field("tolerance").parse().unwrap(), "{name}: {worst}");
                counts[0] += 1;
            }
            Outcome::Refused(kind, reason) => {
                assert_eq!((field("expect"), field("kind")), ("error", kind), "{name}: {reason}");
                assert_eq!(field("reason"), reason, "{name}");
                counts[1] += 1;
            }
        }
    }
    println!("{} pictures, {} refusals", counts[0], counts[1]);
    assert!(counts[0] > 40 && counts[1] > 40);
}

#[test]
fn the_comparison_of_pictures_detects_one_code_value() {
    let pixels = reference_pixels(&to_bytes(&two(Layout::Packed)).unwrap(), "valid", None);
    let right = pam(&pixels);
    let mut wrong = right.clone();
    *wrong.last_mut().unwrap() ^= 2;
    assert_eq!((difference(&right, &right), difference(&right, &wrong)), (Some(0), Some(2)));
    assert_eq!(difference(&right, &right[..right.len() - 1]), None);
}

/// The compatibility of later releases depends on files that never change.
#[test]
fn vectors_of_1_0_never_change() {
    let list = fs::read_to_string(root().join("kept.sha256")).unwrap();
    assert!(list.lines().count() > 300, "the list is cut off");
    for line in list.lines() {
        let (digest, name) = line.split_once("  ").unwrap();
        let bytes = fs::read(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(sha256(&bytes), digest, "{name} has changed");
    }
}
