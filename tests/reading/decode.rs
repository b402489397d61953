//! Guarantees of the decoder: parts at any size, and the remainder of a damaged file.

use ssplat::unstable::bitstream::{read, to_bytes};
use ssplat::unstable::{DecodeOptions, EncodeOptions};
use ssplat::unstable::{decode, decode_into, encode};
use ssplat::{Channels, Damage, Error, Limit, Limits, Parameter, Pixels, Reader, Rect, Samples, Target};
use ssplat::{Renderer, SamplesMut, View};

fn picture() -> Pixels {
    let samples = (0..96 * 64 * 3).map(|i| ((i / 3 % 96) * 2 + (i / 288) * (1 + i % 3)) as u8).collect();
    Pixels::new(96, 64, Channels::Rgb, Samples::U8(samples)).unwrap()
}

fn options() -> EncodeOptions {
    let mut options = EncodeOptions::default();
    options.target = Target::Gaussians(120);
    options.effort = 1;
    options
}

#[test]
fn a_region_is_the_part_of_the_whole() {
    let bytes = encode(&picture(), &options()).unwrap().bytes;
    let whole = decode(&bytes, &DecodeOptions::default()).unwrap().pixels;
    let mut of_part = DecodeOptions::default();
    of_part.region = Some(Rect::new(10, 20, 30, 40));
    let part = decode(&bytes, &of_part).unwrap().pixels;
    let (Samples::U8(whole), Samples::U8(part)) = (whole.samples(), part.samples()) else { panic!("8 bits") };
    for y in 0..40 {
        assert_eq!(part[y * 90..][..90], whole[((y + 20) * 96 + 10) * 3..][..90], "row {y}");
    }
    of_part.size = Some([60, 80]);
    let large = decode(&bytes, &of_part).unwrap().pixels;
    assert_eq!((large.width(), large.height()), (60, 80));
}

#[test]
fn an_eighth_of_the_size_is_the_average_of_the_pixels() {
    // Gaussians as small as half a pixel.
    let made = crate::synthetic::Scene { size: [96, 64], count: 3000, ..Default::default() };
    let bytes = to_bytes(&crate::synthetic::scene(&made)).unwrap();
    let mut options = DecodeOptions::default();
    let whole = decode(&bytes, &options).unwrap().pixels;
    options.size = Some([12, 8]);
    let small = decode(&bytes, &options).unwrap().pixels;
    let (Samples::U8(whole), Samples::U8(small)) = (whole.samples(), small.samples()) else { panic!("8 bits") };
    let mut contrast = 0;
    for (i, &value) in small.iter().enumerate() {
        let (x, y, c) = (i / 3 % 12 * 8, i / 36 * 8, i % 3);
        let block = (0..64).map(|k| whole[((y + k / 8) * 96 + x + k % 8) * 3 + c]);
        let average = block.clone().map(f32::from).sum::<f32>() / 64.0;
        contrast = contrast.max(block.clone().max().unwrap() - block.min().unwrap());
        // Half a code value for each of two roundings.
        assert!((f32::from(value) - average).abs() <= 1.0, "sample {i}: {value} for {average}");
    }
    assert!(contrast > 100, "{contrast}: any sample would do");
}

#[test]
fn a_reduced_region_of_a_file_in_groups_misses_nothing() {
    let made = crate::synthetic::Scene { size: [2048, 1536], count: 40_000, ..Default::default() };
    let bytes = to_bytes(&crate::synthetic::scene(&made)).unwrap();
    let mut options = DecodeOptions::default();
    let splats = read(&bytes[..], &options.limits).unwrap();
    // Samples that are 12.5, 4, 32 and 1.07 pixels apart widen Gaussians by a box of that width, of which 3.5
    // deviations are visible beyond each edge.
    let cases = [
        ([100, 200, 900, 800], [9, 8], [87, 187, 926, 826]),
        ([1000, 700, 256, 256], [8, 1], [996, 667, 264, 322]),
        ([900, 5, 64, 64], [60, 2], [899, 1, 66, 72]),
        ([900, 5, 64, 64], [64, 900], [900, 5, 64, 64]),
    ];
    for (region, size, area) in cases {
        (options.region, options.size) = (Some(region.into()), Some(size));
        let [x, y, width, height] = region;
        let view =
            View::new(2048, 1536).crop(Rect::new(x, y, width, height)).unwrap().resized(size[0], size[1]).unwrap();
        assert_eq!(view.area(), area.into());
        let whole =
            Renderer::new(&splats.to_gaussians(), &view, &options.limits).unwrap().render(splats.depth).unwrap();
        assert_eq!(decode(&bytes, &options).unwrap().pixels, whole, "{region:?}");
    }
}

#[test]
fn impossible_regions_and_sizes_are_parameter_errors() {
    let bytes = encode(&picture(), &options()).unwrap().bytes;
    for region in [[90, 0, 10, 10], [0, 0, 0, 1], [u32::MAX, 0, 2, 2]] {
        let mut options = DecodeOptions::default();
        options.region = Some(region.into());
        assert!(matches!(decode(&bytes, &options), Err(Error::Parameter { .. })), "{region:?}");
    }
    let mut options = DecodeOptions::default();
    options.size = Some([0, 5]);
    assert!(matches!(decode(&bytes, &options), Err(Error::Parameter { .. })));
}

#[test]
fn a_progressive_file_cut_after_a_level_is_a_coarser_picture() {
    let pixels = picture();
    let mut options = options();
    options.levels = 3;
    let bytes = encode(&pixels, &options).unwrap().bytes;
    let mut accept = DecodeOptions::default();
    accept.damage = Damage::Accept;
    let whole = decode(&bytes, &accept).unwrap();
    assert_eq!((whole.missing.groups, whole.missing.gaussians), (0, 0));
    // Every truncated file gives all groups that are complete; more bytes never give fewer groups.
    let mut missing = u32::MAX;
    let mut seen = Vec::new();
    for end in 0..bytes.len() {
        assert!(decode(&bytes[..end], &DecodeOptions::default()).is_err(), "{end} bytes were accepted as a whole file");
        let Ok(part) = decode(&bytes[..end], &accept) else { continue };
        assert!(part.missing.groups <= missing, "at {end} bytes");
        if part.missing.groups < missing {
            seen.push(ssplat::unstable::metrics::psnr(&pixels, &part.pixels).unwrap());
        }
        missing = part.missing.groups;
    }
    assert_eq!(seen.len(), 4, "none, one, two and all three levels: {seen:?}");
    assert!(seen.windows(2).all(|w| w[1] > w[0]), "each level adds: {seen:?}");
}

#[test]
fn levels_out_of_range_are_parameter_errors() {
    for levels in [0, 9] {
        let mut options = options();
        options.levels = levels;
        assert!(matches!(encode(&picture(), &options), Err(Error::Parameter { parameter: Parameter::Levels, .. })));
    }
}

#[test]
fn an_opened_file_renders_every_view_like_decode() {
    let made = crate::synthetic::Scene { size: [1024, 768], count: 40_000, ..Default::default() };
    let bytes = to_bytes(&crate::synthetic::scene(&made)).unwrap();
    let opened = Reader::new(&bytes, &Limits::default()).and_then(|reader| reader.read()).unwrap();
    let mut memory = Vec::new();
    for (region, size) in
        [([0, 0, 1024, 768], [1024, 768]), ([100, 200, 300, 400], [300, 400]), ([5, 9, 800, 700], [70, 33])]
    {
        let mut options = DecodeOptions::default();
        (options.region, options.size) = (Some(region.into()), Some(size));
        let want = decode(&bytes, &options).unwrap().pixels;
        let view = opened.view().crop(Rect::new(region[0], region[1], region[2], region[3])).unwrap();
        let view = view.resized(size[0], size[1]).unwrap();
        assert!(opened.render(&view).unwrap() == want, "{region:?}");
        // Into memory that still holds the previous view.
        memory.resize((size[0] * size[1] * 3) as usize, 0);
        opened.render_into(&view, SamplesMut::U8(&mut memory)).unwrap();
        assert!(Samples::U8(memory.clone()) == *want.samples(), "{region:?}");
        memory.reverse();
        decode_into(&bytes, &options, SamplesMut::U8(&mut memory)).unwrap();
        assert!(Samples::U8(memory.clone()) == *want.samples(), "{region:?}");
    }
}

#[test]
fn data_read_for_a_part_renders_only_that_part() {
    let made = crate::synthetic::Scene { size: [2048, 1536], count: 40_000, ..Default::default() };
    let bytes = to_bytes(&crate::synthetic::scene(&made)).unwrap();
    let opening = Reader::new(&bytes, &Limits::default()).unwrap();
    let whole = opening.view();
    let part = whole.crop(Rect::new(300, 400, 500, 600)).unwrap();
    let opened = opening.read_for(&part).unwrap();
    assert!(opened.splats().gaussians.len() < 40_000 / 2, "{}", opened.splats().gaussians.len());
    let inner = part.crop(Rect::new(20, 30, 100, 100)).unwrap();
    let mut options = DecodeOptions::default();
    options.region = Some(Rect::new(320, 430, 100, 100));
    assert_eq!(opened.render(&inner).unwrap(), decode(&bytes, &options).unwrap().pixels);
    for beyond in
        [whole, whole.crop(Rect::new(299, 400, 10, 10)).unwrap(), whole.crop(Rect::new(790, 990, 11, 10)).unwrap()]
    {
        assert!(
            matches!(opened.render(&beyond), Err(Error::Parameter { parameter: Parameter::View, .. })),
            "{beyond:?}"
        );
    }
}

#[test]
fn one_reader_serves_many_parts_from_many_threads() {
    let made = crate::synthetic::Scene { size: [2048, 1536], count: 40_000, ..Default::default() };
    let bytes = to_bytes(&crate::synthetic::scene(&made)).unwrap();
    let whole = decode(&bytes, &DecodeOptions::default()).unwrap().pixels;
    let reader = Reader::from_read(&bytes[..], &Limits::default()).unwrap();
    let tiles = |y| {
        for x in [0, 900, 1984] {
            let view = reader.view().crop(Rect::new(x, y, 64, 64)).unwrap();
            let read = reader.read_for(&view).unwrap();
            assert!(read.splats().gaussians.len() < 40_000 / 2, "the whole picture is read for {x}, {y}");
            let mut options = DecodeOptions::default();
            options.region = Some(view.area());
            assert_eq!(read.render(&view).unwrap(), decode(&bytes, &options).unwrap().pixels, "{x}, {y}");
        }
    };
    std::thread::scope(|scope| {
        for y in [0, 700, 1472] {
            let tiles = &tiles;
            scope.spawn(move || tiles(y));
        }
    });
    // The reader is still there for the whole picture.
    assert_eq!(reader.read().unwrap().render(&reader.view()).unwrap(), whole);
}

#[test]
fn what_is_read_from_one_reader_shares_one_limit() {
    let made = crate::synthetic::Scene { size: [64, 64], count: 5000, ..Default::default() };
    let bytes = to_bytes(&crate::synthetic::scene(&made)).unwrap();
    let mut limits = Limits::default();
    limits.alloc = 8 << 20;
    let reader = Reader::new(&bytes, &limits).unwrap();
    let mut held = Vec::new();
    let error = loop {
        match reader.read() {
            Ok(image) => held.push(image),
            Err(error) => break error,
        }
        assert!(held.len() < 1000, "there is no end");
    };
    assert!(matches!(error, Error::LimitExceeded { limit: Limit::Alloc, .. }), "{error}");
    assert!(!held.is_empty());
    held.clear();
    reader.read().unwrap();
}

#[test]
fn simultaneous_views_share_one_limit() {
    let made = crate::synthetic::Scene { size: [512, 512], count: 5000, ..Default::default() };
    let bytes = to_bytes(&crate::synthetic::scene(&made)).unwrap();
    let mut opened = Reader::new(&bytes, &Limits::default()).and_then(|reader| reader.read()).unwrap();
    // Enough for the picture and one renderer, but not for two.
    let mut alloc = 1 << 18;
    let one = loop {
        opened.limit_alloc(alloc).unwrap();
        match opened.renderer(&opened.view()) {
            Ok(renderer) => break renderer,
            Err(_) => alloc += 1 << 14,
        }
    };
    assert!(matches!(opened.renderer(&opened.view()), Err(Error::LimitExceeded { limit: Limit::Alloc, .. })));
    drop(one);
    assert!(opened.renderer(&opened.view()).is_ok());
    assert!(matches!(opened.limit_alloc(5000), Err(Error::LimitExceeded { limit: Limit::Alloc, .. })));
}
