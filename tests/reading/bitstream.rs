//! Guarantees of the bitstream: exact round trips, canonical bytes, and typed errors for invalid input.

use crate::synthetic::{Random, Scene, scene};
use ssplat::unstable::bitstream::lattice::Lattice;
use ssplat::unstable::bitstream::splats::{Layout, PackedSplats};
use ssplat::unstable::bitstream::{inspect, read, read_area, read_partial, to_bytes};
use ssplat::{Blend, Channels, Depth, Error, FormatError, Limits, Rect};
use ssplat::{Renderer, View};

const LAYOUTS: [Layout; 3] = [Layout::Packed, Layout::Planes, Layout::Coded];

/// Writes, reads and writes again; returns what was read.
fn round_trip(splats: &PackedSplats) -> PackedSplats {
    let bytes = to_bytes(splats).unwrap();
    let again = read(&bytes[..], &Limits::default()).unwrap();
    assert_eq!(to_bytes(&again).unwrap(), bytes, "bytes are not canonical");
    again
}

/// Sorts the primitives of each level: their order is up to the layout.
fn sorted(splats: &PackedSplats) -> Vec<Vec<[i64; 9]>> {
    let mut rest = &splats.gaussians[..];
    let mut levels = splats.levels.clone();
    if levels.is_empty() {
        levels.push(rest.len() as u32);
    }
    levels
        .iter()
        .map(|&n| {
            let (level, tail) = rest.split_at(n as usize);
            rest = tail;
            let mut level: Vec<[i64; 9]> = level
                .iter()
                .map(|p| {
                    let c = p.color.map(i64::from);
                    [p.x.into(), p.y.into(), p.major.into(), p.minor.into(), p.angle.into(), c[0], c[1], c[2], c[3]]
                })
                .collect();
            level.sort_unstable();
            level
        })
        .collect()
}

#[test]
fn every_kind_of_picture_round_trips_exactly() {
    for layout in LAYOUTS {
        for channels in [Channels::Grey, Channels::GreyAlpha, Channels::Rgb, Channels::Rgba] {
            for (count, seed) in [(0, 1), (1, 2), (2, 3), (17, 4), (700, 5)] {
                for codebook in [false, true] {
                    let mut splats = scene(&Scene { layout, channels, count, codebook, seed, ..Scene::default() });
                    if seed % 2 == 0 {
                        (splats.depth, splats.blend) = (Depth::Sixteen, Blend::Sum);
                    }
                    let again = round_trip(&splats);
                    assert_eq!(sorted(&again), sorted(&splats));
                    let fields = |s: &PackedSplats| {
                        (s.width, s.height, s.channels, s.depth, s.blend, s.layout, s.steps, s.background)
                    };
                    assert_eq!(fields(&again), fields(&splats));
                    assert_eq!(again.codebook, splats.codebook);
                }
            }
        }
    }
}

#[test]
fn the_report_adds_up_to_the_file() {
    for layout in LAYOUTS {
        let mut splats = scene(&Scene { layout, count: 300, codebook: true, ..Scene::default() });
        splats.metadata.icc = Some(vec![7; 100]);
        let bytes = to_bytes(&splats).unwrap();
        let (_, report) = inspect(&bytes, &Limits::default()).unwrap();
        assert_eq!(report.parts.iter().map(|p| p.bytes).sum::<u64>(), bytes.len() as u64, "{:?}", report.parts);
    }
}

#[test]
fn bits_of_primitives_add_up_to_those_of_the_fields() {
    for count in [300, 40_000] {
        let splats = scene(&Scene { count, size: [1500, 1000], ..Scene::default() });
        let (read, report) = inspect(&to_bytes(&splats).unwrap(), &Limits::default()).unwrap();
        assert_eq!(report.each.len(), read.gaussians.len());
        let each: f64 = report.each.iter().copied().map(f64::from).sum();
        let fields: f64 = report.fields.iter().map(|f| f.bits).sum();
        assert!((each / fields - 1.0).abs() < 1e-4, "{each} and {fields} bits");
        // They are not all the same.
        let most = report.each.iter().copied().fold(0.0, f32::max);
        assert!(f64::from(most) > 1.2 * each / count as f64, "{most}");
    }
}

#[test]
fn a_plain_colour_picture_has_at_most_20_bytes_of_overhead() {
    let splats = scene(&Scene { count: 200, layout: Layout::Packed, ..Scene::default() });
    let (_, report) = inspect(&to_bytes(&splats).unwrap(), &Limits::default()).unwrap();
    let frame: u64 = report.parts.iter().filter(|p| ["header", "checksum"].contains(&p.name)).map(|p| p.bytes).sum();
    assert!(frame <= 20, "{frame}");
}

#[test]
fn metadata_is_kept_and_damage_to_it_does_not_hide_the_picture() {
    let mut splats = scene(&Scene { count: 20, layout: Layout::Packed, ..Scene::default() });
    splats.metadata.icc = Some((0..200).collect());
    splats.metadata.exif = Some(b"II*\0".to_vec());
    let again = round_trip(&splats);
    assert_eq!(again.metadata, splats.metadata);
    let mut bytes = to_bytes(&splats).unwrap();
    let start = bytes.windows(4).position(|w| w == [100, 101, 102, 103]).unwrap();
    bytes[start] ^= 1;
    let hurt = read(&bytes[..], &Limits::default()).unwrap();
    assert_eq!((hurt.metadata.icc, hurt.metadata.damaged), (None, vec![*b"iccp"]));
    assert_eq!(hurt.metadata.exif, splats.metadata.exif);
    assert_eq!(hurt.gaussians, again.gaussians);
}

#[test]
fn limits_are_checked_before_memory_is_allocated() {
    let splats = scene(&Scene { count: 50, layout: Layout::Packed, ..Scene::default() });
    let bytes = to_bytes(&splats).unwrap();
    type Set = fn(&mut Limits);
    let sets: [(&str, Set); 4] = [
        ("width", |l| l.width = 10),
        ("height", |l| l.height = 10),
        ("gaussians", |l| l.gaussians = 49),
        ("alloc", |l| l.alloc = 100),
    ];
    for (name, set) in sets {
        let mut limits = Limits::default();
        set(&mut limits);
        match read(&bytes[..], &limits) {
            Err(Error::LimitExceeded { limit, .. }) => assert_eq!(limit.name(), name),
            other => panic!("{name}: {other:?}"),
        }
    }
}

/// Readers cannot encounter these integers, because no bytes of the coded layout represent them, but a caller can set
/// them.
#[test]
fn invalid_integers_are_refused_before_a_byte_is_written() {
    let sound = scene(&Scene { count: 5, ..Scene::default() });
    let written = |change: &dyn Fn(&mut PackedSplats)| {
        let mut splats = sound.clone();
        change(&mut splats);
        to_bytes(&splats)
    };
    assert!(written(&|_| {}).is_ok());
    assert!(written(&|s| s.gaussians[2].minor = s.gaussians[2].major + 1).is_err(), "minor above major");
    assert!(written(&|s| s.gaussians[2].color[3] = 1).is_err(), "alpha in a picture without");
    assert!(written(&|s| s.gaussians[2].angle = u16::MAX).is_err(), "an angle that there is not");
    assert!(written(&|s| s.gaussians[2].color[0] = i16::MIN).is_err(), "a colour beyond the largest");
}

/// The remainder of a damaged file is bounded by its bytes like a whole file.
#[test]
fn a_damaged_file_cannot_claim_more_primitives_than_its_bytes_can_code() {
    let mut bytes = std::fs::read("spec/vectors/valid/detail-rgb/file.ssplat").unwrap();
    // After signature, version, flags and the varints of two sides: the count, which becomes a hundred thousand.
    let after = |at: usize| at + bytes[at..].iter().position(|b| b & 0x80 == 0).unwrap() + 1;
    let count = after(after(6));
    let end = after(count);
    bytes.splice(count..end, [0xa0, 0x8d, 0x06]);
    crate::seal::seal(&mut bytes);
    let refused = read_partial(&bytes, &Limits::default());
    assert!(
        matches!(refused, Err(Error::Format(FormatError::BadValue { field: "number of Gaussians", value: 100_000 }))),
        "{refused:?}"
    );
}

#[test]
fn many_primitives_are_written_in_groups_and_read_back() {
    let splats = scene(&Scene { count: 40_000, size: [1500, 1000], ..Scene::default() });
    let again = round_trip(&splats);
    assert_eq!(sorted(&again), sorted(&splats));
    let (_, report) = inspect(&to_bytes(&splats).unwrap(), &Limits::default()).unwrap();
    assert!(report.groups > 1);
}

#[test]
fn a_part_of_a_large_file_is_rendered_from_some_of_its_groups() {
    let splats = scene(&Scene { count: 40_000, size: [1500, 1000], ..Scene::default() });
    let bytes = to_bytes(&splats).unwrap();
    let limits = Limits::default();
    let whole = read(&bytes[..], &limits).unwrap();
    let draw = |splats: &PackedSplats, region: [u32; 4]| {
        let picture = splats.to_gaussians();
        let [x, y, width, height] = region;
        let view = View::new(picture.width, picture.height).crop(Rect::new(x, y, width, height)).unwrap();
        Renderer::new(&picture, &view, &limits).unwrap().render(splats.depth).unwrap()
    };
    let mut random = Random(5);
    let mut most = 0;
    for _ in 0..12 {
        let (width, height) = (1 + random.below(200) as u32, 1 + random.below(200) as u32);
        let region = [random.below(1300) as u32, random.below(800) as u32, width, height];
        let part = read_area(&bytes, &region.into(), &limits).unwrap();
        most = most.max(part.gaussians.len());
        assert!(draw(&part, region) == draw(&whole, region), "{region:?}");
    }
    assert!(most < 30_000, "{most} of 40 000 primitives were read");
    assert!(read_area(&bytes, &[0, 0, 1500, 1000].into(), &limits).unwrap() == whole);
    // A file in one piece is read as a whole, and an empty region needs nothing.
    let small = scene(&Scene::default());
    let read = read_area(&to_bytes(&small).unwrap(), &[0, 0, 1, 1].into(), &limits).unwrap();
    assert_eq!(read.gaussians.len(), small.gaussians.len());
    assert!(read_area(&bytes, &[u32::MAX; 4].into(), &limits).unwrap().gaussians.is_empty());
}

#[test]
fn a_few_wide_primitives_do_not_make_every_group_reach_everywhere() {
    let mut splats = scene(&Scene { count: 40_000, size: [1500, 1000], ..Scene::default() });
    let lattice = Lattice::new(&splats.steps, splats.layout);
    let mut random = Random(6);
    let read_for_a_corner = |splats: &PackedSplats| {
        read_area(&to_bytes(splats).unwrap(), &[0, 0, 50, 50].into(), &Limits::default()).unwrap().gaussians.len()
    };
    let before = read_for_a_corner(&splats);
    // 100 pixels and more along the major axis: three times that distance reaches into a third of the picture.
    for p in splats.gaussians.iter_mut().step_by(100) {
        let size = f64::from(splats.steps.scale + 4) / 32.0;
        let major = ((100f64.log2() + 2.0) / size).ceil() as u8;
        (p.major, p.minor, p.angle) = (major, major - 2, 0);
        let [ex, ey] = lattice.exponents(p.major, p.minor, p.angle);
        p.x = random.below(Lattice::positions(1500, ex).into()) as u32;
        p.y = random.below(Lattice::positions(1000, ey).into()) as u32;
    }
    let after = read_for_a_corner(&splats);
    assert_eq!(sorted(&round_trip(&splats)), sorted(&splats));
    assert!(after < before + 2000, "{after} of 40 000 primitives were read, {before} without wide ones");
}

#[test]
fn a_file_cut_after_a_level_shows_the_coarser_picture() {
    let mut splats = scene(&Scene { count: 1000, ..Scene::default() });
    splats.gaussians.sort_by_key(|p| std::cmp::Reverse(u32::from(p.major) + u32::from(p.minor)));
    splats.levels = vec![200, 300, 500];
    let whole = round_trip(&splats);
    assert_eq!(sorted(&whole), sorted(&splats));
    let bytes = to_bytes(&splats).unwrap();
    let mut seen = Vec::new();
    for end in 0..bytes.len() {
        assert!(read(&bytes[..end], &Limits::default()).is_err());
        let Ok((part, missing)) = read_partial(&bytes[..end], &Limits::default()) else { continue };
        assert_eq!(part.gaussians.len() + missing.gaussians as usize, 1000);
        assert_eq!(whole.gaussians[..part.gaussians.len()], part.gaussians);
        assert_eq!(missing.of_groups, 3);
        seen.push(part.gaussians.len());
    }
    seen.dedup();
    assert_eq!(seen, [0, 200, 500, 1000]);
}

#[test]
fn damage_to_one_group_loses_that_group_only() {
    let mut splats = scene(&Scene { count: 900, ..Scene::default() });
    splats.levels = vec![300, 300, 300];
    let mut bytes = to_bytes(&splats).unwrap();
    let at = bytes.len() / 2;
    bytes[at] ^= 16;
    assert!(read(&bytes[..], &Limits::default()).is_err());
    let (part, missing) = read_partial(&bytes, &Limits::default()).unwrap();
    assert_eq!((part.gaussians.len(), part.levels, missing.gaussians, missing.groups), (600, vec![300, 300], 300, 1));
}
