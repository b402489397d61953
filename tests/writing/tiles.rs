//! Fits in tiles: no visible seams, the requested size, and the same bytes on every machine.

use std::collections::VecDeque;
use std::ops::ControlFlow;

use crate::waves::picture;
use ssplat::report::SkipReason;
use ssplat::unstable::Needs;
use ssplat::unstable::bitstream::splats::Layout;
use ssplat::unstable::{DecodeOptions, EncodeOptions};
use ssplat::{
    Backend, Blend, Channels, Detail, Encoded, Encoder, Error, Limits, Parameter, Pixels, Samples, Target, Thumbnail,
    Tune, Workers,
};

fn options(target: Target, tiles: Option<u32>) -> EncodeOptions {
    let mut options = EncodeOptions::default();
    (options.target, options.tiles, options.effort, options.backend) = (target, tiles, 2, Backend::Cpu);
    options
}

/// Returns the mean squared errors within 16 pixels of the seams between tiles of `side` pixels, and elsewhere.
fn errors(original: &Pixels, encoded: &Encoded, side: u32) -> [f64; 2] {
    let decoded = ssplat::unstable::decode(&encoded.bytes, &DecodeOptions::default()).unwrap().pixels;
    let (Samples::U8(a), Samples::U8(b)) = (original.samples(), decoded.samples()) else { panic!("8 bits") };
    let (width, count) = (original.width(), original.channels().count() as u32);
    let is_near = |v: u32, length: u32| {
        let seam = (v + side / 2) / side * side;
        seam > 0 && seam < length && v + 16 >= seam && v < seam + 16
    };
    let mut sums = [[0.0f64; 2]; 2];
    for (i, (a, b)) in a.iter().zip(b).enumerate() {
        let (x, y) = (i as u32 / count % width, i as u32 / count / width);
        let sum = &mut sums[usize::from(!is_near(x, width) && !is_near(y, original.height()))];
        *sum = [sum[0] + (f64::from(*a) - f64::from(*b)).powi(2), sum[1] + 1.0];
    }
    sums.map(|[error, samples]| error / samples)
}

#[test]
fn seams_are_no_worse_than_elsewhere() {
    let pixels = picture(512, 448, Channels::Rgb);
    let mut options = options(Target::Ratio(60.0), None);
    options.tune = Some(Tune::Psnr);
    let whole = errors(&pixels, &ssplat::unstable::encode(&pixels, &options).unwrap(), 256);
    options.tiles = Some(256);
    let encoded = ssplat::unstable::encode(&pixels, &options).unwrap();
    let tiles = errors(&pixels, &encoded, 256);
    let excess = tiles[0] / whole[0] / (tiles[1] / whole[1]);
    // `examples/seams.rs` measures 0.98 to 1.06 on photographs in tiles this small.
    assert!(excess < 1.1, "{excess}: {tiles:?} of {whole:?}");
}

#[test]
fn files_of_tiles_fill_their_size_and_never_exceed_it() {
    for (channels, most) in [(Channels::Grey, 1000), (Channels::GreyAlpha, 500), (Channels::Rgba, 2400)] {
        let pixels = picture(200, 140, channels);
        for (levels, blend) in [(1, Blend::Normalized), (3, Blend::Sum)] {
            let mut options = options(Target::Bytes(most), Some(128));
            (options.levels, options.blend) = (levels, Some(blend));
            let encoded = ssplat::unstable::encode(&pixels, &options).unwrap();
            let bytes = encoded.bytes.len() as u64;
            assert!(bytes <= most && bytes >= most * 97 / 100, "{channels:?} {blend:?}: {bytes} of {most}");
            let decoded = ssplat::unstable::decode(&encoded.bytes, &DecodeOptions::default()).unwrap().pixels;
            let psnr = ssplat::unstable::metrics::compare(&pixels, &decoded).unwrap().psnr;
            // The report weights colours by their opacity.
            let is_opaque = channels.alpha().is_none();
            assert!(
                !is_opaque || (psnr - encoded.report.psnr).abs() < 0.05,
                "{psnr}, said to be {}",
                encoded.report.psnr
            );
        }
    }
    // Almost nothing, and more than the picture needs.
    for most in [40, 60, 90_000] {
        let encoded =
            ssplat::unstable::encode(&picture(200, 140, Channels::Grey), &options(Target::Bytes(most), Some(128)))
                .unwrap();
        assert!(encoded.bytes.len() as u64 <= most, "{} of {most}", encoded.bytes.len());
    }
}

#[test]
fn uncoded_layouts_are_written_in_tiles_and_fill_their_size() {
    let pixels = picture(160, 100, Channels::Rgba);
    for layout in [Layout::Packed, Layout::Planes] {
        for (target, most) in [(Target::Bytes(700), 700), (Target::Ratio(20.0), 3200)] {
            let mut of_tiles = options(target, Some(128));
            (of_tiles.layout, of_tiles.detail) = (layout, Detail::Off);
            let mut of_whole = of_tiles.clone();
            of_whole.tiles = None;
            let [tiles, whole] = [&of_tiles, &of_whole].map(|o| ssplat::unstable::encode(&pixels, o).unwrap());
            let bytes = tiles.bytes.len() as u64;
            assert!(bytes <= most && bytes >= most * 97 / 100, "{layout:?}: {bytes} of {most}");
            let splats = ssplat::unstable::bitstream::read(&tiles.bytes[..], &Limits::default()).unwrap();
            assert_eq!(splats.layout, layout);
            let (found, wanted) = (tiles.report.psnr, whole.report.psnr);
            // Tiles this small lose 0.5 to 1.0 dB. A wrong position or angle would lose far more.
            assert!(found > wanted - 1.2, "{layout:?}: {found} dB in tiles, {wanted} dB as a whole");
        }
    }
    // The Gaussians of other layouts have no layer over them.
    let mut of_tiles = options(Target::Ratio(10.0), Some(128));
    of_tiles.layout = Layout::Packed;
    let here = ssplat::unstable::encode(&pixels, &of_tiles).unwrap().bytes;
    let there = encode_by(&pixels, &of_tiles, &mut Elsewhere::new(2, &|_, answer| answer)).unwrap();
    assert!(here == there, "{} and {} bytes", here.len(), there.len());
}

#[test]
fn a_detail_layer_lies_over_the_gaussians_of_all_tiles() {
    for (channels, is_grey) in [(Channels::Rgb, false), (Channels::Rgba, true)] {
        let pixels = match is_grey {
            false => picture(330, 240, channels),
            // Grey in four channels: the fit omits chroma and alpha, but the file has them.
            true => grey_in_colour(330, 240),
        };
        let mut options = options(Target::Ratio(25.0), Some(128));
        options.tune = Some(Tune::Psnr);
        let with = ssplat::unstable::encode(&pixels, &options).unwrap();
        options.detail = Detail::Off;
        let without = ssplat::unstable::encode(&pixels, &options).unwrap();
        let most = 330 * 240 * channels.count() / 25;
        assert!(with.bytes.len() <= most && with.bytes.len() >= most * 97 / 100, "{} of {most}", with.bytes.len());
        let layer = |encoded: &Encoded| {
            ssplat::unstable::bitstream::read(&encoded.bytes[..], &Limits::default()).unwrap().detail
        };
        assert!(layer(&with).is_some_and(|l| l.tiles() == l.of_tiles()) && layer(&without).is_none());
        let psnr_of = |bytes: &[u8]| {
            let decoded = ssplat::unstable::decode(bytes, &DecodeOptions::default()).unwrap().pixels;
            ssplat::unstable::metrics::compare(&pixels, &decoded).unwrap().psnr
        };
        let psnr = psnr_of(&with.bytes);
        let mut base = ssplat::unstable::bitstream::read(&with.bytes[..], &Limits::default()).unwrap();
        base.detail = None;
        let below = psnr_of(&ssplat::unstable::bitstream::to_bytes(&base).unwrap());
        assert!(psnr > below + 3.0, "{psnr} with the layer, {below} without");
        // The report renders the tiles, in which single samples are rounded in the other direction.
        assert!((psnr - with.report.psnr).abs() < 1e-3, "{psnr}, said to be {}", with.report.psnr);
    }
}

#[test]
fn gaussians_fitted_at_reduced_size_are_as_good_at_full_size() {
    // Odd sides, so that the squares at two borders are cut off.
    let pixels = picture(441, 307, Channels::Rgb);
    for tiles in [None, Some(256)] {
        let mut with_layer = options(Target::Ratio(30.0), tiles);
        (with_layer.tune, with_layer.detail, with_layer.effort) = (Some(Tune::Psnr), Detail::GaussianShare(0.02), 3);
        let encoded = ssplat::unstable::encode(&pixels, &with_layer).unwrap();
        let mut base = ssplat::unstable::bitstream::read(&encoded.bytes[..], &Limits::default()).unwrap();
        base.detail = None;
        let count = base.gaussians.len();
        // Each has more than four times 300 pixels, so that half the size is fitted, and less than sixteen times as
        // many.
        assert!((32..112).contains(&count), "{count}");
        let bytes = ssplat::unstable::bitstream::to_bytes(&base).unwrap();
        let decoded = ssplat::unstable::decode(&bytes, &DecodeOptions::default()).unwrap().pixels;
        let psnr = ssplat::unstable::metrics::compare(&pixels, &decoded).unwrap().psnr;
        let mut alone = options(Target::Gaussians(count as u32), tiles);
        (alone.tune, alone.effort) = (Some(Tune::Psnr), 3);
        let alone = ssplat::unstable::encode(&pixels, &alone).unwrap().report.psnr;
        println!("{tiles:?}: {count} Gaussians, {psnr} dB, {alone} by a whole fit");
        assert!(psnr > alone - 0.5, "{tiles:?}: {count} Gaussians, {psnr} dB, {alone} by a whole fit");
    }
}

fn grey_in_colour(width: u32, height: u32) -> Pixels {
    let grey = picture(width, height, Channels::Grey);
    let Samples::U8(samples) = grey.samples() else { panic!("8 bits") };
    let samples = samples.iter().flat_map(|&v| [v, v, v, 255]).collect();
    Pixels::new(width, height, Channels::Rgba, Samples::U8(samples)).unwrap()
}

#[test]
fn tiles_have_about_the_requested_number_of_primitives() {
    let encoded =
        ssplat::unstable::encode(&picture(300, 200, Channels::Rgb), &options(Target::Gaussians(600), Some(128)))
            .unwrap();
    assert!((590..=610).contains(&encoded.report.gaussians), "{}", encoded.report.gaussians);
}

/// Returns the thumbnail of a file.
fn carried(bytes: &[u8]) -> Option<Vec<u8>> {
    ssplat::unstable::bitstream::read(bytes, &Limits::default()).unwrap().metadata.thumbnail
}

#[test]
fn a_file_of_tiles_has_a_thumbnail_within_its_size() {
    let pixels = picture(300, 200, Channels::Rgb);
    for (target, most) in [(Target::Bytes(3000), 3000), (Target::Gaussians(300), u64::MAX)] {
        let mut options = options(target, Some(128));
        (options.thumbnail, options.levels) = (Thumbnail::Bytes(400), 2);
        let encoded = ssplat::unstable::encode(&pixels, &options).unwrap();
        assert!(encoded.bytes.len() as u64 <= most, "{} of {most}", encoded.bytes.len());
        let small = carried(&encoded.bytes).expect("a thumbnail");
        assert!((200..=400).contains(&small.len()), "{}", small.len());
        let small = ssplat::unstable::decode(&small, &DecodeOptions::default()).unwrap().pixels;
        let mut reduced = DecodeOptions::default();
        reduced.size = Some([small.width(), small.height()]);
        let drawn = ssplat::unstable::decode(&encoded.bytes, &reduced).unwrap().pixels;
        let psnr = ssplat::unstable::metrics::compare(&drawn, &small).unwrap().psnr;
        // Measured: 30.5 and 31.9 dB. The margin for the differences of two fits is 1.5 dB.
        assert!(psnr > 29.0, "{psnr}");
    }
    let plain = ssplat::unstable::encode(&pixels, &options(Target::Bytes(3000), Some(128))).unwrap().bytes;
    assert_eq!(carried(&plain), None);
}

#[test]
fn constant_channels_are_omitted_in_tiles() {
    let grey = picture(240, 160, Channels::Grey);
    let pixels = grey_in_colour(240, 160);
    let mut options = options(Target::Bytes(1280), Some(128));
    let alone = ssplat::unstable::encode(&grey, &options).unwrap();
    let encoded = ssplat::unstable::encode(&pixels, &options).unwrap();
    assert_eq!(encoded.report.skipped.iter().map(|l| &l.what).collect::<Vec<_>>(), [&SkipReason::ColorAndAlpha]);
    assert!((1242..=1280).contains(&encoded.bytes.len()), "{}", encoded.bytes.len());
    let decoded = ssplat::unstable::decode(&encoded.bytes, &DecodeOptions::default()).unwrap().pixels;
    let Samples::U8(samples) = decoded.samples() else { panic!("8 bits") };
    assert!(samples.chunks_exact(4).all(|p| p[0] == p[1] && p[1] == p[2] && p[3] == 255));
    // A quarter of the samples is always exact.
    let (psnr, of_grey) = (encoded.report.psnr - 10.0 * (4f64 / 3.0).log10(), alone.report.psnr);
    assert!((psnr - of_grey).abs() < 0.2, "{psnr} and {of_grey}");
    assert!((encoded.report.float_psnr - encoded.report.psnr).abs() < 3.0, "{:?}", encoded.report);
    let there = encode_by(&pixels, &options, &mut Elsewhere::new(2, &|_, answer| answer)).unwrap();
    assert!(there == encoded.bytes);
    options.needs = Needs::Everything;
    let skipped = ssplat::unstable::encode(&pixels, &options).unwrap().report.skipped;
    assert!(skipped.iter().all(|l| l.what == SkipReason::OwnColors), "{skipped:?}");
}

#[test]
fn a_constant_picture_is_decoded_exactly_from_tiles() {
    let pixels = Pixels::new(300, 140, Channels::Rgb, Samples::U8([200, 90, 30].repeat(300 * 140))).unwrap();
    let encoded = ssplat::unstable::encode(&pixels, &options(Target::Auto, Some(128))).unwrap();
    assert!(encoded.report.psnr > 48.0, "{}", encoded.report.psnr);
}

#[test]
fn a_constant_picture_takes_as_few_bytes_in_tiles_as_without() {
    let color = [200, 90, 30, 255, 77, 77, 77, 255];
    for (channels, color) in
        [(Channels::Rgb, &color[..3]), (Channels::Rgba, &color[4..]), (Channels::Grey, &color[5..6])]
    {
        let pixels = Pixels::new(300, 140, channels, Samples::U8(color.repeat(300 * 140))).unwrap();
        let [whole, tiles] =
            [None, Some(128)].map(|tiles| ssplat::unstable::encode(&pixels, &options(Target::Auto, tiles)).unwrap());
        assert!(whole.bytes == tiles.bytes, "{channels:?}: {} and {}", whole.bytes.len(), tiles.bytes.len());
        assert!(tiles.report.psnr > 70.0 && tiles.report.skipped.iter().any(|l| l.what == SkipReason::Fit));
        assert!(
            ssplat::unstable::decode(&tiles.bytes, &DecodeOptions::default()).unwrap().pixels == pixels,
            "{channels:?}"
        );
        // With a single different pixel, the picture has to be fitted.
        let Samples::U8(mut samples) = pixels.into_samples() else { unreachable!() };
        *samples.last_mut().unwrap() ^= 64;
        let pixels = Pixels::new(300, 140, channels, Samples::U8(samples)).unwrap();
        let spotted = ssplat::unstable::encode(&pixels, &options(Target::Bytes(300), Some(128))).unwrap();
        assert!(spotted.report.skipped.iter().all(|l| l.what != SkipReason::Fit), "{channels:?}");
    }
}

#[test]
fn the_report_says_why_tiles_were_fitted_on_the_cpu() {
    let pixels = picture(300, 140, Channels::Grey);
    let reason = |backend| {
        let mut options = options(Target::Bytes(300), Some(128));
        options.backend = backend;
        ssplat::unstable::encode(&pixels, &options).unwrap().report.chosen.reason
    };
    assert_eq!(reason(Backend::Cpu), "requested");
    assert_eq!(reason(Backend::Auto), "the picture has fewer than 262144 pixels");
}

#[cfg(feature = "rayon")]
#[test]
fn bytes_of_tiles_do_not_depend_on_the_thread_count() {
    let pixels = picture(400, 260, Channels::Rgb);
    // With a detail layer.
    let options = options(Target::Ratio(30.0), Some(128));
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| ssplat::unstable::encode(&pixels, &options).unwrap().bytes)
    };
    assert!(with(1) == with(3));
}

/// Modification of a worker's result.
type Change<'a> = &'a dyn Fn(Vec<u8>) -> Vec<u8>;

/// Workers that run each task when its result is requested, twice if necessary, and modify some results.
struct Elsewhere<'a> {
    at_once: usize,
    out: VecDeque<Vec<u8>>,
    given: Vec<Vec<u8>>,
    change: &'a dyn Fn(usize, Vec<u8>) -> Vec<u8>,
    taken: usize,
}

impl<'a> Elsewhere<'a> {
    fn new(at_once: usize, change: &'a dyn Fn(usize, Vec<u8>) -> Vec<u8>) -> Self {
        Elsewhere { at_once, out: VecDeque::new(), given: Vec::new(), change, taken: 0 }
    }
}

fn work_on(task: &[u8]) -> ssplat::Result<Vec<u8>> {
    ssplat::work_on_tile(task, &mut |_| ControlFlow::Continue(()))
}

impl Workers for Elsewhere<'_> {
    fn submit(&mut self, task: Vec<u8>) -> ssplat::Result<()> {
        self.given.push(task.clone());
        self.out.push_back(task);
        assert!(self.out.len() <= self.at_once);
        Ok(())
    }

    fn receive(&mut self) -> ssplat::Result<Vec<u8>> {
        let answer = work_on(&self.out.pop_front().unwrap())?;
        self.taken += 1;
        Ok((self.change)(self.taken - 1, answer))
    }

    fn capacity(&self) -> usize {
        self.at_once
    }
}

fn encode_by(pixels: &Pixels, options: &EncodeOptions, workers: &mut Elsewhere<'_>) -> ssplat::Result<Vec<u8>> {
    let encoded = Encoder::from(options.clone()).encode_divided(pixels, workers, &mut |_| ControlFlow::Continue(()))?;
    Ok(encoded.bytes)
}

#[test]
fn a_picture_divided_among_workers_gives_the_same_file() {
    for (channels, (tune, effort), (blend, levels), at_once) in [
        (Channels::Rgb, (Tune::Iq, 2), (Blend::Normalized, 1), 1),
        (Channels::GreyAlpha, (Tune::Iq, 1), (Blend::Sum, 2), 2),
        (Channels::Rgba, (Tune::Psnr, 1), (Blend::Normalized, 1), 4),
    ] {
        let pixels = picture(260, 150, channels);
        let mut options = options(Target::Bytes(1500), Some(128));
        (options.tune, options.effort, options.blend, options.levels) = (Some(tune), effort, Some(blend), levels);
        options.icc = Some(vec![7; 60]);
        let here = ssplat::unstable::encode(&pixels, &options).unwrap().bytes;
        let mut workers = Elsewhere::new(at_once, &|_, answer| answer);
        assert!(encode_by(&pixels, &options, &mut workers).unwrap() == here, "{channels:?}, {at_once} at once");
        // Six tiles separately, and all following passes.
        assert!(workers.given.len() > 6 * 5, "{}", workers.given.len());
    }
    let deep: Vec<u16> = (0..200 * 140u32).map(|i| (i * 7919 % 65_521) as u16).collect();
    let deep = Pixels::new(200, 140, Channels::Grey, Samples::U16(deep)).unwrap();
    let options = options(Target::Gaussians(300), Some(128));
    let there = encode_by(&deep, &options, &mut Elsewhere::new(2, &|_, answer| answer)).unwrap();
    assert!(there == ssplat::unstable::encode(&deep, &options).unwrap().bytes);
}

#[test]
fn workers_fit_on_the_cpu_and_refuse_a_requested_gpu() {
    let pixels = picture(300, 140, Channels::Grey);
    let encoded = |backend| {
        let mut options = options(Target::Bytes(300), Some(128));
        options.backend = backend;
        let mut workers = Elsewhere::new(1, &|_, answer| answer);
        Encoder::from(options).encode_divided(&pixels, &mut workers, &mut |_| ControlFlow::Continue(()))
    };
    let chosen = encoded(Backend::Auto).unwrap().report.chosen;
    assert_eq!((chosen.backend, &*chosen.reason), (Backend::Cpu, "workers fit tiles on the CPU"));
    let refused = encoded(Backend::Gpu);
    assert!(matches!(refused, Err(Error::Parameter { parameter: Parameter::Backend, .. })), "{refused:?}");
}

#[test]
fn workers_know_about_the_detail_layer() {
    // The Gaussians of a layer are fitted in fewer steps.
    let pixels = picture(260, 150, Channels::Rgb);
    for tune in [Tune::Psnr, Tune::Iq] {
        let mut options = options(Target::Bytes(9000), Some(128));
        options.tune = Some(tune);
        let here = ssplat::unstable::encode(&pixels, &options).unwrap().bytes;
        let layer = ssplat::unstable::bitstream::read(&here[..], &Limits::default()).unwrap().detail;
        assert!(layer.is_some(), "{tune:?}");
        let there = encode_by(&pixels, &options, &mut Elsewhere::new(2, &|_, answer| answer)).unwrap();
        assert!(here == there, "{tune:?}: {} and {} bytes", here.len(), there.len());
    }
}

#[test]
fn an_invalid_answer_names_its_tile() {
    // Effort 1 has the same passes.
    let pixels = picture(260, 140, Channels::Grey);
    let mut options = options(Target::Bytes(400), Some(128));
    options.effort = 1;
    let mut workers = Elsewhere::new(1, &|_, answer| answer);
    encode_by(&pixels, &options, &mut workers).unwrap();
    // The second tile that is submitted: the tiles of a turn are not adjacent.
    let place = "128 × 128 at 128, 0";
    let foreign = work_on(&workers.given[0]).unwrap();
    let changes: [(&str, Change<'_>); 7] = [
        ("0 bytes", &|_| Vec::new()),
        ("cut", &|answer| answer[..answer.len() - 1].to_vec()),
        ("the answer belongs to task", &|_| foreign.clone()),
        ("begin with", &|_| workers.given[1].clone()),
        ("truncated in the line", &|answer| answer[..contents(&answer) - 1].to_vec()),
        ("checksum", &|mut answer| {
            answer[60] ^= 1;
            answer
        }),
        ("version", &|mut answer| {
            answer[18] = b'x';
            answer
        }),
    ];
    let at = workers.given.iter().position(|task| task_core(task) == [128, 0]).unwrap();
    for (expected, change) in changes {
        let wrong = |n, answer| if n == at { change(answer) } else { answer };
        match encode_by(&pixels, &options, &mut Elsewhere::new(1, &wrong)) {
            Err(Error::Parameter { parameter: Parameter::Answer, problem }) => {
                assert!(problem.contains(place), "{problem}");
                assert!(problem.contains(expected) || expected == "cut" && problem.contains("checksum"), "{problem}");
            }
            other => panic!("{expected}: {:?}", other.map(|bytes| bytes.len())),
        }
    }
}

/// Returns the start of a task's contents, after the line with the version.
fn contents(task: &[u8]) -> usize {
    task.iter().position(|&b| b == b'\n').unwrap() + 1
}

/// Returns the corner of a task's tile.
fn task_core(task: &[u8]) -> [u32; 2] {
    let number = |at: usize| u32::from_le_bytes(task[at..at + 4].try_into().unwrap());
    let start = contents(task);
    let at = start + 4 + number(start) as usize;
    [number(at), number(at + 4)]
}

/// Returns the bytes with a correct checksum.
fn signed(mut bytes: Vec<u8>) -> Vec<u8> {
    let end = bytes.len() - 4;
    let checksum = crc32fast::hash(&bytes[..end]);
    bytes[end..].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

#[test]
fn invalid_tasks_and_answers_are_refused_without_a_panic() {
    let pixels = picture(150, 30, Channels::Grey);
    let mut options = options(Target::Bytes(300), Some(128));
    options.effort = 1;
    let mut workers = Elsewhere::new(1, &|_, answer| answer);
    encode_by(&pixels, &options, &mut workers).unwrap();
    // The tasks of one tile: separate fit, joint fit, weighting, sweeps and measurement.
    let tasks: Vec<&Vec<u8>> = workers.given.iter().filter(|task| task_core(task) == [0, 0]).collect();
    let samples = 150 * 30;
    for task in tasks.iter().take(2).chain(&tasks[tasks.len() - 3..]) {
        let stopped = |task: &[u8]| {
            ssplat::work_on_tile(task, &mut |p| {
                if p.done > 0.0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            })
        };
        let is_refused = |bytes: &[u8], what: &str| match stopped(bytes) {
            Err(Error::Parameter { parameter: Parameter::Task, .. }) => {}
            other => panic!("{what}: {:?}", other.map(|bytes| bytes.len())),
        };
        // All lengths of the header: fuzzing once missed the case of a truncated version line.
        for end in (0..contents(task) + 9).chain((0..task.len() - 4).step_by(997)).chain(task.len() - 9..task.len() - 4)
        {
            is_refused(&task[..end], "a cut task");
            is_refused(&signed([&task[..end], &[0; 4]].concat()), "a cut task with a checksum");
        }
        is_refused(&signed([&task[..], &[0; 9]].concat()), "more than a task");
        let start = contents(task);
        // All fields, and some of the samples and primitives between them.
        let some = (start..task.len() - 4).filter(|at| {
            let before = start + 200;
            let after = task.len().saturating_sub(120);
            *at < before || *at > after || at % 4999 == 0 || (*at > before + samples && at % 31 == 0)
        });
        for (i, at) in some.enumerate() {
            let mut wrong = task.to_vec();
            wrong[at] ^= [1, 0x80, 0xff, 0x40][i % 4];
            is_refused(&wrong, "a changed task");
            // With a correct checksum, it is a task of another picture, or invalid.
            match stopped(&signed(wrong)) {
                Ok(_) | Err(Error::Cancelled | Error::Parameter { parameter: Parameter::Task, .. }) => {}
                Err(other) => panic!("byte {at}: {other}"),
            }
        }
    }
    // The same for results: each is signed, and belongs to the submitted task.
    let at = workers.given.iter().position(|task| task_core(task) == [0, 0]).unwrap();
    let last = workers.given.iter().rposition(|task| task_core(task) == [0, 0]).unwrap();
    for (k, i) in [at, last - 4].into_iter().flat_map(|k| (0..10).map(move |i| (k, i))) {
        let wrong = |n, mut answer: Vec<u8>| {
            if n == k {
                let start = contents(&answer) + 4;
                let at = start + (i * 19) % (answer.len() - start - 4);
                answer[at] ^= [0x80, 1, 0xff, 0x40][i % 4];
                answer = signed(answer);
            }
            answer
        };
        match encode_by(&pixels, &options, &mut Elsewhere::new(1, &wrong)) {
            Ok(bytes) => assert!(bytes.len() <= 300),
            Err(Error::Parameter { parameter: Parameter::Answer, .. }) => {}
            Err(other) => panic!("answer {k}, {i}: {other}"),
        }
    }
}

/// Replaces the numbers of a result by extreme floats: each field separately, in all primitives.
#[test]
fn answers_with_extreme_numbers_are_refused_or_give_a_file() {
    let pixels = picture(150, 24, Channels::Grey);
    let mut options = options(Target::Bytes(300), Some(128));
    options.effort = 1;
    let (mut files, mut refused) = (0, 0);
    // `None` is the error; then the cost, and the nine numbers of a primitive of floats.
    for field in (0..10).map(Some).chain([None]) {
        for value in [f32::INFINITY, f32::NEG_INFINITY, 2_097_152.0, -2_097_152.0, f32::NAN, 0.0] {
            let extreme = |mut answer: Vec<u8>| {
                let start = contents(&answer) + 4;
                match field {
                    None => answer[start..start + 8].copy_from_slice(&(f64::from(value) * 1e200).to_le_bytes()),
                    Some(field) => {
                        let end = answer.len() - 4;
                        for record in answer[start + 16..end].chunks_exact_mut(40) {
                            record[4 * field..4 * field + 4].copy_from_slice(&value.to_le_bytes());
                        }
                    }
                }
                signed(answer)
            };
            let change = |n, answer| if n == 0 { extreme(answer) } else { answer };
            match encode_by(&pixels, &options, &mut Elsewhere::new(1, &change)) {
                Ok(bytes) => {
                    assert!(bytes.len() <= 300);
                    files += 1;
                }
                Err(Error::Parameter { parameter: Parameter::Answer, .. }) => refused += 1,
                Err(other) => panic!("{field:?}, {value}: {other}"),
            }
        }
    }
    assert!(files >= 10 && refused >= 25, "{files} files, {refused} refused");
}

#[test]
fn a_picture_no_larger_than_a_tile_is_fitted_as_a_whole() {
    let pixels = picture(128, 100, Channels::Rgb);
    let bytes = |tiles| ssplat::unstable::encode(&pixels, &options(Target::Ratio(50.0), tiles)).unwrap().bytes;
    assert!(bytes(Some(128)) == bytes(None));
}

#[test]
fn pictures_of_the_image_crate_are_read_in_parts_as_their_pixels() {
    let rgb = image::RgbImage::from_fn(200, 150, |x, y| image::Rgb([x as u8, y as u8, (x * y / 100) as u8]));
    let rgb = image::DynamicImage::from(rgb);
    for picture in [image::DynamicImage::from(rgb.to_luma_alpha16()), rgb] {
        let pixels = Pixels::try_from(&picture).unwrap();
        let encoder = Encoder::new().detail(Detail::Off).tiles(128).bytes(300).effort(1);
        let [ours, theirs] = [encoder.encode(&pixels), encoder.encode(&picture)].map(|encoded| encoded.unwrap().bytes);
        assert!(ours == theirs, "{:?}", picture.color());
    }
}

#[test]
fn options_that_exclude_tiles_are_parameter_errors() {
    let pixels = picture(300, 200, Channels::Grey);
    let refused = |name: &str, change: &dyn Fn(&mut EncodeOptions)| {
        let mut options = options(Target::Ratio(50.0), Some(128));
        change(&mut options);
        match ssplat::unstable::encode(&pixels, &options) {
            Err(Error::Parameter { parameter: found, .. }) if found.name() == name => {}
            other => panic!("{name}: {:?}", other.map(|e| e.bytes.len())),
        }
    };
    refused("tiles", &|o| o.tiles = Some(0));
    refused("tiles", &|o| o.tiles = Some(100));
    let small = ssplat::unstable::encode(&pixels, &options(Target::Bytes(3), Some(128)));
    assert!(matches!(small, Err(Error::TooSmall { allowed: 3, .. })), "{small:?}");
}

#[test]
fn a_psnr_is_met_in_tiles_by_a_file_that_is_not_much_too_large() {
    for ([width, height], channels, wanted) in
        [([170, 100], Channels::Rgb, 36.0), ([200, 140], Channels::GreyAlpha, 30.0)]
    {
        let pixels = picture(width, height, channels);
        let encoded = ssplat::unstable::encode(&pixels, &options(Target::Psnr(wanted), Some(128))).unwrap();
        let decoded = ssplat::unstable::decode(&encoded.bytes, &DecodeOptions::default()).unwrap().pixels;
        let found = ssplat::unstable::metrics::compare(&pixels, &decoded).unwrap().psnr;
        // The report renders the tiles, in which single samples are rounded in the other direction.
        assert!((found - encoded.report.psnr).abs() < 1e-3, "{channels:?}: {found}, not {}", encoded.report.psnr);
        assert!(encoded.report.psnr >= wanted, "{channels:?} {wanted}: {}", encoded.report.psnr);
        assert!(encoded.report.psnr < wanted + 0.5, "{channels:?} {wanted}: {}", encoded.report.psnr);
    }
    let pixels = picture(140, 20, Channels::Grey);
    let mut options = options(Target::Psnr(150.0), Some(128));
    options.detail = Detail::Off;
    let unreachable = ssplat::unstable::encode(&pixels, &options);
    assert!(matches!(unreachable, Err(Error::Parameter { parameter: Parameter::Psnr, .. })), "{unreachable:?}");
}

#[test]
fn a_file_is_written_in_tiles_however_little_time_there_is() {
    let pixels = picture(300, 200, Channels::Rgb);
    for target in [Target::Ratio(20.0), Target::Psnr(60.0)] {
        let mut options = options(target, Some(128));
        (options.time, options.effort) = (Some(std::time::Duration::from_millis(1)), 9);
        let encoded = ssplat::unstable::encode(&pixels, &options).unwrap();
        let most = match target {
            Target::Ratio(ratio) => (300.0 * 200.0 * 3.0 / ratio) as u64,
            _ => u64::MAX,
        };
        assert!(encoded.bytes.len() as u64 <= most, "{} of {most}", encoded.bytes.len());
        ssplat::unstable::decode(&encoded.bytes, &DecodeOptions::default()).unwrap();
        // The workers are told as well.
        let mut workers = Elsewhere::new(2, &|_, answer| answer);
        let there = encode_by(&pixels, &options, &mut workers).unwrap();
        assert!(there.len() as u64 <= most, "{} of {most}", there.len());
    }
}

#[test]
fn progress_of_tiles_increases_and_the_callback_can_cancel() {
    let pixels = picture(200, 140, Channels::Grey);
    let options = options(Target::Ratio(60.0), Some(128));
    let mut shown: Vec<(&str, f32)> = Vec::new();
    ssplat::unstable::encode_with_progress(&pixels, &options, &mut |p| {
        shown.push((p.stage, p.done));
        ControlFlow::Continue(())
    })
    .unwrap();
    let mut stages: Vec<&str> = shown.iter().map(|s| s.0).collect();
    stages.dedup();
    assert_eq!(stages, ["survey", "fit", "join", "finish", "measure"]);
    assert!(shown.windows(2).all(|p| p[0].0 != p[1].0 || p[0].1 <= p[1].1), "{shown:?}");
    assert!(shown.iter().all(|s| (0.0..=1.0).contains(&s.1)));
    for stop in stages {
        let stopped = ssplat::unstable::encode_with_progress(&pixels, &options, &mut |p| {
            if p.stage == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        assert!(matches!(stopped, Err(Error::Cancelled)), "{stop}");
    }
}
