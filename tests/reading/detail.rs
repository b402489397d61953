//! Guarantees of the detail layer for readers: parts have the pixels of the whole, either layer can be rendered alone,
//! results do not depend on threads, and a damaged tile affects nothing else.

use crate::seal::layer;
use crate::synthetic::{Levels, Scene, scene, with_layer};
use ssplat::View;
use ssplat::unstable::bitstream::splats::PackedSplats;
use ssplat::unstable::bitstream::{DetailHead, MissingParts, inspect, read, read_partial, to_bytes};
use ssplat::unstable::{DecodeOptions, decode};
use ssplat::{Channels, Damage, Depth, Error, Layers, Limit, Limits, Parameter, Pixels, Reader, Rect, Samples};

/// A picture of six tiles with levels in most blocks.
fn large(channels: Channels) -> PackedSplats {
    let mut head = DetailHead::SEEN;
    (head.step, head.alpha) = (700, channels.alpha().is_some());
    let ground = scene(&Scene { channels, size: [530, 300], count: 400, seed: 61, ..Scene::default() });
    with_layer(ground, head, Levels::new(61))
}

/// A small file of three tiles.
fn small() -> Vec<u8> {
    let mut head = DetailHead::PLAIN;
    head.step = 900;
    let ground = scene(&Scene { channels: Channels::Grey, size: [515, 6], count: 4, seed: 62, ..Scene::default() });
    to_bytes(&with_layer(ground, head, Levels { filled: 6, ..Levels::new(62) })).unwrap()
}

fn draw(bytes: &[u8], view: &View, layers: Layers) -> Pixels {
    let view = view.layers(layers);
    let reader = Reader::new(bytes, &Limits::default()).unwrap();
    reader.read_for(&view).unwrap().render(&view).unwrap()
}

fn samples(pixels: &Pixels) -> Vec<u16> {
    match pixels.samples() {
        Samples::U8(v) => v.iter().map(|&v| v.into()).collect(),
        Samples::U16(v) => v.clone(),
    }
}

/// Returns the samples of a rectangle.
fn cut(pixels: &Pixels, [x, y, width, height]: [u32; 4]) -> Vec<u16> {
    let (all, count) = (samples(pixels), pixels.channels().count());
    let row = |y: u32| ((y * pixels.width() + x) as usize * count)..((y * pixels.width() + x + width) as usize * count);
    (y..y + height).flat_map(|y| all[row(y)].to_vec()).collect()
}

#[test]
fn parts_have_the_samples_of_the_whole_at_any_size() {
    for (channels, depth) in [(Channels::Rgb, Depth::Eight), (Channels::GreyAlpha, Depth::Sixteen)] {
        let mut splats = large(channels);
        splats.depth = depth;
        let bytes = to_bytes(&splats).unwrap();
        let full = View::new(530, 300);
        for view in
            [full, full.resized(200, 110).unwrap(), full.resized(61, 700).unwrap(), full.resized(777, 431).unwrap()]
        {
            let whole = draw(&bytes, &view, Layers::Both);
            let [w, h] = [view.width(), view.height()];
            // Corners, a single pixel, across edges of tiles, and a row.
            for part in [
                [0, 0, 9, 7],
                [w - 5, h - 9, 5, 9],
                [w / 2 - 3, h / 2, 1, 1],
                [w / 3, h / 4, w / 2, h / 2],
                [0, h / 2, w, 1],
            ] {
                let [x, y, width, height] = part;
                let drawn = draw(&bytes, &view.crop(Rect::new(x, y, width, height)).unwrap(), Layers::Both);
                assert!(samples(&drawn) == cut(&whole, part), "{channels:?}: {part:?} of {w} × {h}");
            }
        }
    }
}

#[cfg(feature = "rayon")]
#[test]
fn threads_change_no_sample() {
    let bytes = to_bytes(&large(Channels::Rgba)).unwrap();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            [[530, 300], [170, 90], [600, 400]]
                .map(|[width, height]| draw(&bytes, &View::new(530, 300).resized(width, height).unwrap(), Layers::Both))
        })
    };
    assert!(with(1) == with(7));
}

#[test]
fn each_layer_can_be_rendered_alone() {
    let splats = large(Channels::Rgb);
    let bytes = to_bytes(&splats).unwrap();
    let view = View::new(530, 300);
    let [both, gaussians, detail] = [Layers::Both, Layers::Gaussians, Layers::Detail].map(|l| draw(&bytes, &view, l));
    let without = to_bytes(&PackedSplats { detail: None, ..splats.clone() }).unwrap();
    assert_eq!(gaussians, draw(&without, &view, Layers::Both));
    assert!(samples(&draw(&without, &view, Layers::Detail)).iter().all(|&v| v == 128), "grey where there is no layer");
    let mut changed = 0;
    for ((both, gaussians), detail) in samples(&both).into_iter().zip(samples(&gaussians)).zip(samples(&detail)) {
        let [both, gaussians, detail] = [both, gaussians, detail].map(f64::from);
        changed += u32::from(both != gaussians);
        if [both, gaussians, detail].iter().all(|v| (1.0..255.0).contains(v)) {
            // Grey is 127.5. Half a code value for each of three roundings.
            assert!((both - gaussians - (detail - 127.5)).abs() <= 1.5, "{both} {gaussians} {detail}");
        }
    }
    assert!(changed > 100_000, "{changed}: the layer shows nothing");
    let mut options = DecodeOptions::default();
    options.layers = Layers::Gaussians;
    assert_eq!(decode(&bytes, &options).unwrap().pixels, gaussians);
}

#[test]
fn a_detail_layer_is_no_metadata() {
    let mut limits = Limits::default();
    limits.metadata = 0;
    assert!(Reader::new(&small(), &limits).unwrap().read().is_ok());
    let mut tagged = large(Channels::Rgb);
    tagged.metadata.exif = Some(b"II*\0\x08\0\0\0\0\0\0\0\0\0".to_vec());
    let bytes = to_bytes(&tagged).unwrap();
    let refused = Reader::new(&bytes, &limits).and_then(|reader| reader.read());
    assert!(matches!(refused, Err(Error::LimitExceeded { limit: Limit::Metadata, .. })));
}

#[test]
fn reading_and_writing_gives_the_same_bytes() {
    for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
        let splats = large(channels);
        let bytes = to_bytes(&splats).unwrap();
        let (again, report) = inspect(&bytes, &Limits::default()).unwrap();
        assert_eq!(again.detail, splats.detail);
        assert!(to_bytes(&again).unwrap() == bytes);
        assert_eq!(report.parts.iter().map(|p| p.bytes).sum::<u64>(), bytes.len() as u64);
        // The bits are those of the streams; the index has a few bytes per tile.
        let bits = report.layer_bits / 8.0;
        let bytes = report.layer_bytes() as f64;
        assert!(bits < bytes && bits > bytes - 6.0 * 6.0 - 6.0 * 4.0, "{bits} of {bytes}");
    }
}

#[test]
fn a_layer_of_another_picture_is_not_written() {
    let splats = large(Channels::Rgb);
    for other in [
        PackedSplats { width: 100, ..splats.clone() },
        PackedSplats { channels: Channels::Grey, ..splats.clone() },
        PackedSplats { layout: ssplat::unstable::bitstream::splats::Layout::Planes, ..splats.clone() },
    ] {
        assert!(matches!(to_bytes(&other), Err(Error::Parameter { .. })), "{} {:?}", other.width, other.channels);
    }
    let grey = large(Channels::Grey);
    let wider = PackedSplats { channels: Channels::Rgb, ..grey };
    assert!(matches!(to_bytes(&wider), Err(Error::Parameter { .. })));
}

#[test]
fn every_truncation_keeps_the_complete_tiles() {
    let bytes = small();
    let whole = read(&bytes[..], &Limits::default()).unwrap();
    let at = layer::layout(&bytes).unwrap();
    let ends: Vec<usize> = at.tiles.iter().map(|tile| tile.1.end).collect();
    let index = at.tiles[0].1.start;
    assert_eq!(ends.len(), 3);
    let view = View::new(515, 6);
    let base = draw(&bytes, &view, Layers::Gaussians);
    for end in 0..bytes.len() {
        assert!(matches!(read(&bytes[..end], &Limits::default()), Err(Error::Format(_))), "cut at {end}");
        let part = read_partial(&bytes[..end], &Limits::default());
        let Ok((part, missing)) = part else {
            assert!(end < at.payload.end, "cut at {end}: {:?}", part.err());
            continue;
        };
        assert!(end >= at.payload.end, "cut at {end}");
        let lost = if end < index { 3 } else { ends.iter().filter(|&&e| e > end).count() as u32 };
        assert_eq!((missing.tiles, missing.of_tiles, missing.gaussians), (lost, 3, 0), "cut at {end}");
        assert_eq!(part.gaussians, whole.gaussians);
        assert_ne!(missing, MissingParts::default());
        if ends.contains(&end) || end == at.payload.end {
            // Missing tiles show only the Gaussians; the others show the picture.
            let drawn = part.renderer(&view, &Limits::default()).unwrap().render(Depth::Eight).unwrap();
            let picture = draw(&bytes, &view, Layers::Both);
            let there = 256 * (3 - lost).min(2) + if lost == 0 { 3 } else { 0 };
            for (area, like) in [([0, 0, there, 6], &picture), ([there, 0, 515 - there, 6], &base)] {
                assert!(cut(&drawn, area) == cut(like, area), "cut at {end}: {area:?}");
            }
        }
    }
}

#[test]
fn every_flipped_bit_loses_at_most_one_tile() {
    let bytes = small();
    let whole = read(&bytes[..], &Limits::default()).unwrap();
    let at = layer::layout(&bytes).unwrap();
    for bit in 0..8 * bytes.len() {
        let mut hurt = bytes.clone();
        hurt[bit / 8] ^= 1 << (bit % 8);
        assert!(
            matches!(
                read(&hurt[..], &Limits::default()),
                Err(Error::Format(_) | Error::UnsupportedVersion { .. } | Error::LimitExceeded { .. })
            ),
            "bit {bit}"
        );
        let streams = at.tiles[0].1.start..at.tiles[2].1.end;
        match read_partial(&hurt, &Limits::default()) {
            Ok((part, missing)) => {
                assert_eq!(part.gaussians, whole.gaussians, "bit {bit}");
                let lost = if streams.contains(&(bit / 8)) { 1 } else { missing.tiles };
                assert_eq!(missing.tiles, lost, "bit {bit}");
                let (some, all) = (part.detail, whole.detail.as_ref().unwrap());
                let there = some.as_ref().map_or(0, |some| some.tiles() as u32);
                assert_eq!(there, 3 - missing.tiles, "bit {bit}");
                assert!(missing.tiles > 0 || some.as_ref() == Some(all), "bit {bit}");
                assert!(missing.damaged, "bit {bit}");
            }
            Err(e) => assert!(bit / 8 < at.payload.end, "bit {bit}: {e}"),
        }
    }
}

#[test]
fn views_select_the_layers_of_a_whole_file_and_only_those_that_were_read() {
    let bytes = small();
    let reader = || Reader::new(&bytes, &Limits::default()).unwrap();
    let all = [Layers::Both, Layers::Gaussians, Layers::Detail];
    let whole = reader().read().unwrap();
    for layers in all {
        let view = whole.view().layers(layers);
        let read = reader().read_for(&view).unwrap();
        assert_eq!(whole.render(&view).unwrap(), read.render(&read.view()).unwrap(), "{layers:?}");
        for other in all {
            let found = read.render(&view.layers(other));
            let is_read = layers == Layers::Both || layers == other;
            match found {
                Ok(_) => assert!(is_read, "{other:?} of {layers:?}"),
                Err(Error::Parameter { parameter: Parameter::View, .. }) => {
                    assert!(!is_read, "{other:?} of {layers:?}")
                }
                other => panic!("{other:?}"),
            }
        }
    }
}

#[test]
fn the_gaussians_of_a_whole_file_are_read_with_nothing_missing() {
    let bytes = small();
    let reader = Reader::new(&bytes, &Limits::default()).unwrap();
    let view = reader.view().layers(Layers::Gaussians);
    assert_eq!(reader.damage(Damage::Accept).read_for(&view).unwrap().missing(), MissingParts::default());
}

#[test]
fn an_empty_layer_of_a_huge_picture_costs_nothing_before_it_is_refused() {
    // 2²⁴ tiles in a file of a few bytes, although the index has at least a byte for each.
    let mut head = DetailHead::PLAIN;
    head.step = 64;
    let ground = scene(&Scene { size: [300, 1], count: 1, ..Scene::default() });
    let mut bytes = to_bytes(&with_layer(ground, head, Levels { filled: 0, ..Levels::new(1) })).unwrap();
    // The width, a varint of two bytes, becomes 2²⁰, and so does the height.
    bytes.splice(6..9, [0x80, 0x80, 0x40, 0x80, 0x80, 0x40]);
    crate::seal::seal(&mut bytes);
    match read(&bytes[..], &Limits::default()) {
        Err(Error::Format(ssplat::FormatError::BadValue { field: "tiles of the detail layer", value })) => {
            assert_eq!(value, 1 << 24);
        }
        other => panic!("{other:?}"),
    }
    // The Gaussians of the damaged file can be read with a memory limit into which no list of the tiles would fit.
    let mut limits = Limits::default();
    limits.alloc = 1 << 20;
    let (part, missing) = read_partial(&bytes, &limits).unwrap();
    assert_eq!((missing.tiles, missing.of_tiles, missing.damaged), (1 << 24, 1 << 24, true));
    assert!(part.gaussians.len() == 1 && part.detail.is_none());
    let opening = Reader::new(&bytes, &limits).unwrap();
    let corner = opening.view().crop(Rect::new(0, 0, 10, 10)).unwrap();
    assert_eq!(opening.damage(Damage::Accept).read_for(&corner).unwrap().render(&corner).unwrap().width(), 10);
}

/// A stream that is invalid only at its end has been read by then.
#[test]
fn levels_of_invalid_tiles_count_as_work() {
    let mut head = DetailHead::PLAIN;
    head.sizes = [[3, 3], [3, 3]];
    let ground = scene(&Scene { channels: Channels::Grey, size: [1024, 256], count: 1, ..Scene::default() });
    let dense = Levels { filled: 1, most: 3000, ..Levels::new(5) };
    let good = to_bytes(&with_layer(ground, head, dense)).unwrap();
    let mut bad = good.clone();
    for (_, stream) in layer::layout(&good).unwrap().tiles {
        // A stream does not end in a zero (spec §8.1).
        bad[stream.end - 1] = 0;
    }
    crate::seal::seal(&mut bad);
    let read = |bytes: &[u8], work| {
        let mut limits = Limits::default();
        limits.work = work;
        read_partial(bytes, &limits)
    };
    let (mut less, mut enough) = (0, 1 << 40);
    while enough - less > 1 {
        let work = u64::midpoint(less, enough);
        if read(&good, work).is_ok() { enough = work } else { less = work }
    }
    assert_eq!(read(&good, enough).unwrap().1.tiles, 0);
    assert_eq!(read(&bad, enough).unwrap().1.tiles, 4);
    // The tiles themselves are a small part of it, and the last level may differ.
    assert!(enough > 20_000_000, "{enough}");
    let few = enough - enough / 1000;
    for bytes in [&good, &bad] {
        assert!(matches!(read(bytes, few), Err(Error::LimitExceeded { limit: Limit::Work, .. })));
    }
}

/// A view may extend beyond the picture, whose border pixels are repeated there.
#[test]
fn views_beyond_the_picture_do_not_depend_on_how_it_was_opened() {
    for channels in [Channels::Rgb, Channels::GreyAlpha] {
        let bytes = to_bytes(&large(channels)).unwrap();
        let whole = Reader::new(&bytes, &Limits::default()).and_then(|reader| reader.read()).unwrap();
        let larger = View::new(4000, 3000);
        let mut seen = 0;
        for [x, y, width, height] in
            [[900, 20, 40, 30], [30, 900, 40, 30], [1500, 1200, 30, 20], [500, 280, 60, 50], [3960, 100, 40, 90]]
        {
            let part = larger.crop(Rect::new(x, y, width, height)).unwrap();
            for view in [part, part.resized(13, 9).unwrap(), part.resized(70, 64).unwrap()] {
                let (all, read) = (whole.render(&view).unwrap(), draw(&bytes, &view, Layers::Both));
                assert!(all == read, "{channels:?}: {x}, {y}, {view:?}");
                seen += usize::from(all != draw(&bytes, &view, Layers::Gaussians));
            }
        }
        assert!(seen > 4, "{channels:?}: the layer is not seen beside the picture");
    }
}

#[test]
fn work_of_the_layer_is_checked_before_it_is_done() {
    let bytes = to_bytes(&large(Channels::Rgb)).unwrap();
    let mut limits = Limits::default();
    limits.work = 1 << 20;
    assert!(matches!(read(&bytes[..], &limits), Err(Error::LimitExceeded { limit: Limit::Work, .. })));
    // The Gaussians alone are within the limit.
    let reader = Reader::new(&bytes, &limits).unwrap();
    let view = reader.view().layers(Layers::Gaussians);
    assert!(reader.read_for(&view).is_ok());
}

/// A view that is enlarged along one axis and reduced along the other has more resampling taps than pixels or samples.
#[test]
fn work_of_a_distorted_view_is_counted() {
    let bytes = to_bytes(&large(Channels::Rgb)).unwrap();
    let mut limits = Limits::default();
    limits.work = 1 << 31;
    let opened = Reader::new(&bytes, &limits).and_then(|reader| reader.read()).unwrap();
    let drawn = |width, height| opened.renderer(&opened.view().resized(width, height).unwrap()).map(drop);
    assert!(drawn(1, 1).is_ok() && drawn(2000, 1).is_ok() && drawn(1, 2000).is_ok());
    for (width, height) in [(1, 1 << 20), (1 << 20, 1)] {
        assert!(
            matches!(drawn(width, height), Err(Error::LimitExceeded { limit: Limit::Work, .. })),
            "{width} × {height}"
        );
    }
}

#[test]
fn work_of_both_layers_is_counted_together() {
    let mut splats = large(Channels::Rgb);
    // So that the Gaussians cost about as much as the layer.
    splats.gaussians = splats.gaussians.repeat(120);
    splats.levels.clear();
    let bytes = to_bytes(&splats).unwrap();
    // The smallest work limit, within an eighth, with which the layers can be rendered.
    let least = |layers: Layers| {
        let is_drawn = |work: u64| {
            let mut limits = Limits::default();
            limits.work = work;
            let view = View::new(530, 300).layers(layers);
            let reader = Reader::new(&bytes, &limits).unwrap();
            reader.read_for(&view).and_then(|image| image.renderer(&view)).is_ok()
        };
        (8 * 24..8 * 36)
            .map(|eighth: u32| (1 << (eighth / 8)) / 8 * u64::from(8 + eighth % 8))
            .find(|&work| is_drawn(work))
            .unwrap()
    };
    let [both, gaussians, detail] = [Layers::Both, Layers::Gaussians, Layers::Detail].map(least);
    assert!(both > gaussians.max(detail) && both <= 2 * (gaussians + detail), "{both} {gaussians} {detail}");
}
