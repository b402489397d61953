//! Peak memory of reading and rendering, as counted by the allocator, compared with the limit.
#![cfg(all(feature = "unstable", feature = "image"))]

mod seal;
mod synthetic;

use std::fs;
use std::io::Cursor;
use std::path::Path;

use image::ImageReader;
use peak_alloc::PeakAlloc;
use ssplat::unstable::DecodeOptions;
use ssplat::unstable::bitstream::splats::{Layout, PackedGaussian, PackedSplats, Steps};
use ssplat::unstable::bitstream::{DetailHead, inspect, to_bytes};
use ssplat::{Blend, Channels, Damage, Depth, Limits, Reader, Rect};
use synthetic::{Levels, Scene, scene, with_layer};

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// The models of the coded layout and a tile for each thread, and error values: the same for every file.
const SLACK: u64 = 4 << 20;

/// Files that need as much memory as possible for their size.
fn worst() -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    let steps = Steps { scale: 0, angle: 0, position: 15, coarsest: 0, range: 10, luma: 6, chroma: 2 };
    for (layout, kind) in [(Layout::Packed, "packed"), (Layout::Planes, "planes"), (Layout::Coded, "coded")] {
        for (channels, codebook) in [(Channels::Grey, false), (Channels::Rgba, false), (Channels::Rgb, true)] {
            let made = Scene { layout, channels, codebook, count: 60_000, size: [1200, 900], ..Scene::default() };
            files.push((format!("{kind} {channels:?} {codebook}"), to_bytes(&scene(&made)).unwrap()));
        }
        // Equal primitives: the largest number for the bytes, all at the same position.
        let mut steps = steps;
        if layout == Layout::Packed {
            (steps.coarsest, steps.range) = (-6, 0);
        }
        let p = PackedGaussian { x: 9, y: 7, major: 40, minor: 40, angle: 0, color: [5; 4] };
        let equal = PackedSplats {
            width: 64,
            height: 64,
            channels: Channels::Rgba,
            depth: Depth::Eight,
            blend: Blend::Sum,
            layout,
            steps,
            background: [0; 4],
            codebook: None,
            gaussians: vec![p; 7000],
            levels: Vec::new(),
            detail: None,
            exact: None,
            metadata: Default::default(),
        };
        // As many as the format allows for these bytes.
        let mut equal = equal;
        while to_bytes(&equal).is_err() {
            equal.gaussians.truncate(equal.gaussians.len() * 9 / 10);
        }
        files.push((format!("{kind} of {} equal ones", equal.gaussians.len()), to_bytes(&equal).unwrap()));
        equal.gaussians.truncate(50);
        equal.metadata.icc = Some(vec![1; 6 << 20]);
        files.push((format!("{kind} with metadata"), to_bytes(&equal).unwrap()));
    }
    // Levels nearly everywhere, and many tiles with hardly any.
    let mut full = DetailHead::PLAIN;
    full.sizes = [[3, 3], [3, 3]];
    let ground = |size, channels| scene(&Scene { size, channels, count: 50, ..Scene::default() });
    let everywhere = Levels { filled: 1, most: 3000, ..Levels::new(1) };
    let dense = with_layer(ground([1024, 768], Channels::Rgb), full, everywhere);
    files.push(("a dense detail layer".into(), to_bytes(&dense).unwrap()));
    let here_and_there = Levels { filled: 500, most: 1, ..Levels::new(2) };
    let sparse = with_layer(ground([4096, 2048], Channels::Grey), full, here_and_there);
    files.push(("a sparse detail layer".into(), to_bytes(&sparse).unwrap()));
    // Fuzzing of views found that slices of rows took as much memory as the samples of pictures like this.
    let narrow =
        Scene { layout: Layout::Packed, channels: Channels::Grey, size: [8, 1 << 20], count: 1, ..Scene::default() };
    files.push(("a narrow picture of a million rows".into(), to_bytes(&scene(&narrow)).unwrap()));
    for checksums in [Checksums::Right, Checksums::Wrong] {
        files.push((format!("a million empty sections with {checksums:?} checksums"), empty_sections(checksums)));
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("spec/vectors");
    for kind in ["valid", "invalid", "limits", "partial"] {
        for entry in fs::read_dir(folder.join(kind)).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            files.push((name, fs::read(path.join("file.ssplat")).unwrap()));
        }
    }
    files
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Checksums {
    Right,
    Wrong,
}

/// A file of one primitive after 1 048 577 empty sections that no decoder knows.
fn empty_sections(checksums: Checksums) -> Vec<u8> {
    let made = Scene { layout: Layout::Packed, count: 1, size: [8, 8], ..Scene::default() };
    let steps = Steps { coarsest: -1, range: 0, ..made.steps };
    let plain = to_bytes(&scene(&Scene { steps, ..made })).unwrap();
    // Magic, version, flags, two sides, a count and three steps; all have one byte except the magic.
    let (header, payload) = plain[..plain.len() - 4].split_at(12);
    let mut bytes = header.to_vec();
    bytes[5] |= 1 << 7;
    // 2²⁰ + 1 as a varint.
    bytes.extend([0x81, 0x80, 0x40]);
    for i in 0..(1u32 << 20) + 1 {
        bytes.extend(section_name(i));
        bytes.push(0);
        let checksum = crc32fast::hash(&section_name(i));
        bytes.extend((checksum ^ u32::from(checksums == Checksums::Wrong)).to_le_bytes());
    }
    bytes.extend_from_slice(payload);
    bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
    bytes
}

/// Returns the name of optional section number `i`; names are in ascending order.
fn section_name(i: u32) -> [u8; 4] {
    // Capital letters come before small ones; the first is a small one.
    let letter = |k: u32| if k < 26 { b'A' + k as u8 } else { b'a' + (k - 26) as u8 };
    let places = [52 * 52 * 52, 52 * 52, 52, 1].map(|place| i / place % 52);
    [letter(26 + places[0]), letter(places[1]), letter(places[2]), letter(places[3])]
}

/// The only test of this program, so that it counts no other test's memory.
#[test]
fn decoding_stays_within_its_memory_limit() {
    assert!(ssplat::register());
    layers_of_empty_tiles();
    let mut files = worst();
    files.push(("a layer of 2²⁴ tiles without an index".into(), empty_layer([20, 20], 0)));
    for [decoded, refused] in [
        through_image(&files),
        directly(&files),
        again_and_again(&files),
        inspected(&files),
        what_is_left(&files),
        in_other_sizes(),
    ] {
        assert!(decoded > 100 && refused > 100);
    }
}

/// Pixels count towards the limit.
fn directly(files: &[(String, Vec<u8>)]) -> [u32; 2] {
    keeps("directly", files, |bytes, granted| {
        let mut options = DecodeOptions::default();
        options.limits.alloc = granted;
        ssplat::unstable::decode(bytes, &options).is_ok()
    })
}

/// Returns a file of `2^sides` pixels with a detail layer of empty tiles and an index of `index` bytes.
fn empty_layer(sides: [u32; 2], index: usize) -> Vec<u8> {
    let ground = scene(&Scene { channels: Channels::Grey, size: [300, 1], count: 0, ..Scene::default() });
    let mut bytes = to_bytes(&with_layer(ground, DetailHead::PLAIN, Levels { filled: 0, ..Levels::new(1) })).unwrap();
    // Two sides of three bytes in total become two of three bytes each, and the two tiles become as many as requested.
    bytes.splice(6..9, sides.iter().flat_map(|side| [0x80, 0x80, 1 << (side - 14)]));
    let end = bytes.len() - 4;
    bytes.splice(end - 2..end, vec![0; index]);
    seal::seal(&mut bytes);
    bytes
}

/// Whole layers of half a million empty tiles, read with the smallest sufficient limit.
fn layers_of_empty_tiles() {
    let bytes = empty_layer([16, 19], 1 << 19);
    let peak = |granted| {
        let mut limits = Limits::default();
        limits.alloc = granted;
        ALLOCATOR.reset_peak_usage();
        let before = ALLOCATOR.current_usage();
        let is_read = Reader::new(&bytes, &limits).and_then(|reader| reader.read()).is_ok();
        (is_read, (ALLOCATOR.peak_usage() - before) as u64)
    };
    let (mut less, mut enough) = (0u64, 1u64 << 32);
    while enough - less > 1 << 16 {
        let granted = less.midpoint(enough);
        if peak(granted).0 { enough = granted } else { less = granted }
    }
    let (is_read, taken) = peak(enough);
    println!("{} empty tiles: {taken} bytes of {enough} granted", 1 << 19);
    assert!(is_read && enough > 16 << 20 && taken <= enough + SLACK, "{taken} bytes of {enough}");
}

/// Renders a corner of damaged files. Only tiles that exist may take memory.
fn what_is_left(files: &[(String, Vec<u8>)]) -> [u32; 2] {
    keeps("what is left", files, |bytes, granted| {
        let mut options = DecodeOptions::default();
        (options.limits.alloc, options.damage, options.region) = (granted, Damage::Accept, Some(Rect::new(0, 0, 1, 1)));
        ssplat::unstable::decode(bytes, &options).is_ok()
    })
}

/// The report of where the bytes go.
fn inspected(files: &[(String, Vec<u8>)]) -> [u32; 2] {
    keeps("inspected", files, |bytes, granted| {
        let mut limits = Limits::default();
        limits.alloc = granted;
        inspect(bytes, &limits).is_ok()
    })
}

/// Sizes for which slices of rows or weights once took more memory than the samples.
fn in_other_sizes() -> [u32; 2] {
    let (mut plain, mut layered) = (Vec::new(), Vec::new());
    for size in [[1 << 20, 8], [8, 1 << 20], [1 << 20, 1], [1, 1 << 20]] {
        for depth in [Depth::Eight, Depth::Sixteen] {
            let made = Scene { channels: Channels::Grey, size, count: 3, ..Scene::default() };
            let mut scene = scene(&made);
            scene.depth = depth;
            plain.push((format!("{size:?} {depth:?}"), to_bytes(&scene).unwrap()));
            let sparse = Levels { filled: 900, most: 1, ..Levels::new(2) };
            let bytes = to_bytes(&with_layer(scene, DetailHead::PLAIN, sparse)).unwrap();
            layered.push((format!("{size:?} {depth:?} with a layer"), bytes));
        }
    }
    let drawn = |size: [u32; 2], files: &[_]| {
        keeps(&format!("in {size:?}"), files, |bytes, granted| {
            let mut limits = Limits::default();
            limits.alloc = granted;
            let Ok(opened) = Reader::new(bytes, &limits).and_then(|reader| reader.read()) else {
                return false;
            };
            opened.view().resized(size[0], size[1]).is_ok_and(|view| opened.render(&view).is_ok())
        })
    };
    let mut sum = [0; 2];
    let mut add = |counts: [u32; 2]| sum = [0, 1].map(|k| sum[k] + counts[k]);
    for size in [[1 << 20, 9], [9, 1 << 20], [3, 4], [1 << 19, 2], [2, 1 << 19]] {
        add(drawn(size, &plain));
        add(drawn(size, &layered));
    }
    // These take seconds for files with a layer.
    for size in [[8192, 1024], [1024, 8192]] {
        add(drawn(size, &plain));
    }
    sum
}

/// Two views of an opened file at the same time.
fn again_and_again(files: &[(String, Vec<u8>)]) -> [u32; 2] {
    keeps("again and again", files, |bytes, granted| {
        let mut limits = Limits::default();
        limits.alloc = granted;
        let Ok(opened) = Reader::new(bytes, &limits).and_then(|reader| reader.read()) else {
            return false;
        };
        let Ok(first) = opened.renderer(&opened.view()) else { return false };
        let Ok(second) = opened.renderer(&opened.view()) else { return false };
        let depth = opened.splats().depth;
        first.render(depth).is_ok() && second.render(depth).is_ok()
    })
}

fn through_image(files: &[(String, Vec<u8>)]) -> [u32; 2] {
    keeps("through image", files, |bytes, granted| {
        let mut limits = image::Limits::default();
        limits.max_alloc = Some(granted);
        let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().unwrap();
        reader.limits(limits);
        reader.decode().is_ok()
    })
}

/// Decodes `files` with several limits; `decode` returns whether there was a picture. Returns the number of times with
/// and without one.
fn keeps(way: &str, files: &[(String, Vec<u8>)], decode: impl Fn(&[u8], u64) -> bool) -> [u32; 2] {
    let mut most = (i64::MIN, String::new());
    let (mut decoded, mut refused) = (0, 0);
    for granted in [256 << 10, 1 << 20, 4 << 20, 16 << 20, 29_000_000, 64 << 20] {
        for (name, bytes) in files {
            ALLOCATOR.reset_peak_usage();
            let before = ALLOCATOR.current_usage();
            let is_picture = decode(bytes, granted);
            let peak = (ALLOCATOR.peak_usage() - before) as u64;
            assert!(peak <= granted + SLACK, "{name}: {peak} bytes of {granted}");
            if is_picture {
                decoded += 1
            } else {
                refused += 1
            }
            let beyond = peak as i64 - granted as i64;
            if beyond > most.0 {
                most = (beyond, format!("{name}: {peak} bytes of {granted} granted"));
            }
        }
    }
    println!("{way}: {decoded} decoded, {refused} refused; worst: {}", most.1);
    [decoded, refused]
}
