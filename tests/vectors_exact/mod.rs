//! The vectors of the exact layer.

use std::sync::Arc;

use ssplat::unstable::bitstream::splats::{Layout, PackedSplats};
use ssplat::unstable::bitstream::{ExactLayer, to_bytes};
use ssplat::{Channels, Depth, Pixels, Samples};

use super::{Vector, no_primitives, plain, seal_file, section_checksum, small, two};
use crate::synthetic::{Levels, Random, with_layer};

/// Returns a picture with repeated glyphs on flat ground, smooth parts and noise.
fn picture([width, height]: [u32; 2], channels: Channels, depth: Depth, seed: u64) -> Pixels {
    let mut random = Random(seed);
    let top = u64::from(depth.max());
    let mut samples = Vec::new();
    for y in 0..u64::from(height) {
        for x in 0..u64::from(width) {
            let glyph = (x % 6 * 5 + y % 7 * 3 + x % 6 * (y % 7)) % 4 == 0 && y % 7 < 5;
            for k in 0..channels.count() as u64 {
                let is_alpha = channels.alpha() == Some(k as usize);
                samples.push(match (3 * x / u64::from(width), 2 * y / u64::from(height)) {
                    (0, 0) if is_alpha => top,
                    (0, 0) => {
                        if glyph {
                            top * (k + 1) / 9
                        } else {
                            top
                        }
                    }
                    (1, 0) => (x * top / 40 + k * top / 7 + random.below(top / 60 + 1)) % top,
                    (2, 1) => random.below(top + 1),
                    (0, 1) if is_alpha => top * (x % 2) / 3,
                    _ => top * (k + 1) / 6,
                } as u16);
            }
        }
    }
    let samples = match depth {
        Depth::Eight => Samples::U8(samples.iter().map(|&v| v as u8).collect()),
        Depth::Sixteen => Samples::U16(samples),
    };
    Pixels::new(width, height, channels, samples).unwrap()
}

/// Returns `splats` with an exact layer over the cells for which `is_covered` returns true.
fn covered(
    splats: &PackedSplats,
    pixels: &Pixels,
    side: u8,
    is_covered: impl Fn(usize, usize) -> bool,
) -> PackedSplats {
    let exact = Some(Arc::new(ExactLayer::of(pixels, side, is_covered)));
    PackedSplats {
        width: pixels.width(),
        height: pixels.height(),
        channels: pixels.channels(),
        depth: pixels.depth(),
        exact,
        ..splats.clone()
    }
}

/// Returns a file of the layer alone.
fn alone(size: [u32; 2], channels: Channels, depth: Depth, seed: u64) -> PackedSplats {
    covered(&no_primitives(), &picture(size, channels, depth, seed), 11, |_, _| true)
}

/// Returns Gaussians under a layer that covers a chequered part of them, in tiles of 32 pixels.
fn chequered(channels: Channels) -> PackedSplats {
    let splats = small(Layout::Coded, channels, 30, false, 90);
    let splats = PackedSplats { width: 70, height: 40, depth: Depth::Eight, ..splats };
    let is_covered = |x: usize, y: usize| ((x + y) / 8).is_multiple_of(2) && x < 64;
    covered(&splats, &picture([70, 40], channels, Depth::Eight, 91), 5, is_covered)
}

/// A file with a modified section `Exac` and correct checksums of section and file.
fn headed(base: &[u8], change: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let at = base.windows(4).position(|w| w == b"Exac").unwrap();
    let length = usize::from(base[at + 4]);
    let mut contents = base[at + 9..at + 9 + length].to_vec();
    change(&mut contents);
    let mut section = b"Exac".to_vec();
    section.push(contents.len() as u8);
    section.extend(section_checksum(base, *b"Exac", &contents));
    section.extend(contents);
    let mut bytes = base.to_vec();
    bytes.splice(at..at + 9 + length, section);
    seal_file(&mut bytes);
    bytes
}

/// Returns the position of the index of a file of the layer alone whose tile has a stream of 128 bytes or more.
fn index_of(bytes: &[u8]) -> usize {
    let at = bytes.windows(4).position(|w| w == b"Exac").unwrap();
    at + 9 + usize::from(bytes[at + 4]) + usize::from(bytes[at + 9])
}

pub fn all() -> Vec<Vector> {
    let mut out = Vec::new();
    let mut add = |folder: &'static str, name: &str, shows: &str, bytes: Vec<u8>, size: Option<[u32; 2]>| {
        out.push(Vector { folder, name: format!("exact-{name}"), shows: shows.into(), bytes, size });
    };
    let bytes = |splats: &PackedSplats| to_bytes(splats).unwrap();
    for (channels, kind) in [
        (Channels::Grey, "grey"),
        (Channels::GreyAlpha, "grey-alpha"),
        (Channels::Rgb, "rgb"),
        (Channels::Rgba, "rgba"),
    ] {
        for (depth, name) in [(Depth::Eight, "8"), (Depth::Sixteen, "16")] {
            let shows = format!("{kind} with {name} bits, the whole picture: glyphs, gradients, noise, flat ground");
            let file = bytes(&alone([45, 30], channels, depth, 60));
            add("valid", &format!("{kind}-{name}"), &shows, file, None);
        }
    }
    add("valid", "dot", "one pixel", bytes(&alone([1, 1], Channels::Rgb, Depth::Eight, 61)), None);
    add("valid", "thin", "one pixel wide", bytes(&alone([1, 70], Channels::Grey, Depth::Eight, 62)), None);
    add("valid", "flat-row", "a long run in one row", bytes(&alone([900, 2], Channels::Grey, Depth::Eight, 63)), None);
    let tiles = covered(&no_primitives(), &picture([70, 40], Channels::Rgb, Depth::Eight, 64), 5, |_, _| true);
    add("valid", "tiles", "six tiles of up to 32 pixels a side", bytes(&tiles), None);
    add("valid", "mask", "a mask over Gaussians; some tiles have no stream", bytes(&chequered(Channels::Rgb)), None);
    add("valid", "mask-alpha", "a mask over Gaussians with alpha", bytes(&chequered(Channels::Rgba)), None);
    let layers = with_layer(small(Layout::Coded, Channels::Rgb, 20, false, 92), plain(700), Levels::new(92));
    let pixels = picture([layers.width, layers.height], Channels::Rgb, Depth::Eight, 93);
    let layers = covered(&layers, &pixels, 5, |x, _| x >= 8);
    add("valid", "both-layers", "a detail layer and an exact layer", bytes(&layers), None);
    let mut levels = small(Layout::Coded, Channels::Rgb, 60, false, 11);
    levels.depth = Depth::Eight;
    levels.levels = vec![10, 50];
    let pixels = picture([levels.width, levels.height], Channels::Rgb, Depth::Eight, 94);
    add("valid", "groups", "behind groups", bytes(&covered(&levels, &pixels, 6, |_, y| y >= 8)), None);

    let whole = alone([12, 8], Channels::Rgba, Depth::Eight, 65);
    add("reduced", "triple", "enlarged three times: pixels with sharp edges", bytes(&whole), Some([36, 24]));
    add("reduced", "halves", "means of four pixels", bytes(&whole), Some([6, 4]));
    add("reduced", "odd", "parts of pixels, enlarged along y", bytes(&whole), Some([7, 11]));
    let mask = chequered(Channels::Rgb);
    add("reduced", "mask", "covered parts mixed with Gaussians", bytes(&mask), Some([33, 21]));
    add("reduced", "mask-alpha", "the same with alpha", bytes(&chequered(Channels::Rgba)), Some([33, 21]));
    add("reduced", "mask-larger", "enlarged over Gaussians", bytes(&mask), Some([90, 51]));

    let base = bytes(&alone([45, 30], Channels::Rgb, Depth::Eight, 60));
    let contents = base.windows(4).position(|w| w == b"Exac").unwrap() + 9;
    let side = usize::from(base[contents - 5]) - 1;
    add("invalid", "side-small", "tiles of 16 pixels", headed(&base, |c| c[side] = 4), None);
    add("invalid", "side-large", "tiles of 4096 pixels", headed(&base, |c| c[side] = 12), None);
    add("invalid", "detail-length", "a detail length without a detail layer", headed(&base, |c| c[side - 1] = 1), None);
    add("invalid", "payload-checksum", "a wrong checksum of the payload", headed(&base, |c| c[1] ^= 1), None);
    add("invalid", "section-long", "a byte too many in the section", headed(&base, |c| c.push(0)), None);
    let mut wrong = base.clone();
    wrong[contents + side] ^= 1;
    add("invalid", "section-checksum", "a wrong bit in the section", wrong, None);
    let both = bytes(&layers);
    add("invalid", "spans", "payload lengths that differ", headed(&both, |c| c[0] ^= 1), None);
    let (at, end) = (index_of(&base), base.len() - 4);
    let file = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = base.clone();
        change(&mut bytes);
        seal_file(&mut bytes);
        bytes
    };
    // The length takes two bytes, the check two more.
    add("invalid", "check", "a wrong check of the tile", file(&|b| b[at + 2] ^= 1), None);
    add("invalid", "tile", "a wrong bit in the tile", file(&|b| b[at + 9] ^= 1), None);
    add("invalid", "no-index", "no index", file(&|b| drop(b.drain(at..end))), None);
    add("invalid", "tile-cut", "a tile that is longer than the file", file(&|b| drop(b.drain(end - 1..end))), None);
    add("invalid", "trailing", "a byte behind the tile", file(&|b| b.insert(end, 7)), None);
    let stream = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut stream = base[at + 4..end].to_vec();
        change(&mut stream);
        let mut bytes = base[..at].to_vec();
        bytes.extend([stream.len() as u8 | 128, (stream.len() >> 7) as u8]);
        bytes.extend((crc32fast::hash(&stream) as u16).to_le_bytes());
        bytes.extend(stream);
        bytes.extend(&base[end..]);
        seal_file(&mut bytes);
        bytes
    };
    add("invalid", "stream-trailing", "a byte too many in the stream", stream(&|s| s.push(1)), None);
    add("invalid", "stream-trailing-zero", "a zero byte too many in the stream", stream(&|s| s.push(0)), None);
    let packed = PackedSplats { layout: Layout::Coded, ..two(Layout::Packed) };
    let pixels = picture([8, 8], Channels::Rgb, Depth::Eight, 66);
    let mut packed = bytes(&covered(&packed, &pixels, 11, |_, _| true));
    packed[5] &= !3;
    add("invalid", "packed", "a layer behind the packed layout", headed(&packed, |_| ()), None);

    let row = bytes(&tiles);
    add(
        "partial",
        "tile",
        "a wrong bit in the last tile",
        {
            let mut bytes = row.clone();
            let last = bytes.len() - 9;
            bytes[last] ^= 4;
            bytes
        },
        None,
    );
    add("partial", "cut", "cut in the last tile", row[..row.len() - 30].to_vec(), None);
    add("partial", "cut-index", "cut in the index: the background alone", row[..index_of(&row) + 3].to_vec(), None);
    out
}
