//! `ssplat decode`: renders a file, or a region of it at any size, to a picture, band by band.

use std::path::Path;
use std::time::Instant;

use image::DynamicImage;
use image::metadata::Orientation;
use serde_json::json;
use ssplat::unstable::bitstream::MissingParts;
use ssplat::unstable::bitstream::header::Header;
use ssplat::unstable::bitstream::splats::Metadata;
use ssplat::{Backend, Channels, Damage, Depth, Limits, Pixels, Reader, Rect, Samples, SsplatImage};
use ssplat::{Renderer, SamplesMut, View};

use crate::batch::{self, Command, Done, Fate, Report, Show};
use crate::failure::Failure;
use crate::inputs::Task;
use crate::kept_times::KeptTimes;
use crate::progress::{Bar, OutputMode};
use crate::rows::{Format, RowWriter, Shape};
use crate::sink::{self, Sink, say, tell};
use crate::source::{self, Source};
use crate::written::{misfit, write_pixels};
use crate::{args, input};

/// Bytes of output that are rendered before they are written, unless two bands take more; and the same per thread,
/// because small buffers are reused instead of allocated again.
const BATCH: usize = 8 << 20;
const MIN_BYTES_PER_THREAD: usize = 1 << 20;

/// Longest side of an output in pixels.
const LONGEST: u32 = 1 << 20;

pub fn run(args: &args::Decode) -> Result<(), Failure> {
    let output_mode = OutputMode::new(args.json, args.quiet);
    let named = args.format.as_deref().map(Format::from_extension).transpose()?;
    if let Some(folder) = &args.many.out_dir {
        let format = named.unwrap_or(Format::Png);
        let command = Command {
            takes: &|path| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ssplat::EXTENSION)),
            extension: args.format.as_deref().unwrap_or("png"),
            pixels: &pixels,
            run: &|task, show| one(args, task, format, (show, &|_| Ok(()))),
        };
        return batch::run(&args.paths, folder, &args.many, output_mode, &command);
    }
    let (input, output) = args::pair(&args.paths, args.output.as_deref())?;
    let format = match named {
        Some(format) => format,
        None if output == Path::new("-") => Format::Png,
        None => Format::of_path(output)?,
    };
    let bar = Bar::of(output_mode);
    let task = Task::new(input.into(), output.into());
    // A report that cannot be written is a failure, which leaves no output.
    let report = |done: &Done| {
        let mut outcome = Ok(());
        bar.aside(|| {
            if output_mode != OutputMode::Quiet {
                done.notes.iter().for_each(|note| tell(&format!("{}: {note}", Failure::input(input))));
            }
            if args.json && output != Path::new("-") {
                outcome = say(&format!("{}\n", done.result));
            }
        });
        outcome
    };
    one(args, &task, format, (&|share, stage| bar.show(share, stage), &report))?;
    Ok(())
}

/// Returns width times height of the picture in the file at `path`, or 0 if they are unknown.
fn pixels(path: &Path) -> u64 {
    if !input::is_file(path) {
        return 0;
    }
    let mut reader = std::fs::File::open(path).map(std::io::BufReader::new);
    let header = reader.as_mut().ok().and_then(|r| Header::read(r, &Limits::default()).ok());
    header.map_or(0, |h| u64::from(h.width) * u64::from(h.height))
}

/// Decodes one file.
fn one(args: &args::Decode, task: &Task, format: Format, (show, report): (&Show, &Report)) -> Result<Done, Failure> {
    let (input, output) = (task.input.as_path(), task.output.as_path());
    let start = Instant::now();
    let times = KeptTimes::of(args.keep_times, task)?;
    let bytes = input::read_splats(input)?;
    if let Some(side) = args.thumbnail {
        return thumbnail(args, (input, output), format, (&bytes, side), (times, report));
    }
    let failed = |e| Failure::library(input, &e);
    let limits = Limits::default();
    let opening = Reader::new(&bytes, &limits).map_err(failed)?;
    let of = opening.header().gaussians;
    let view = view(args, input, opening.view().layers(args.layers))?;
    let damage = if args.partial { Damage::Accept } else { Damage::Refuse };
    let opened = opening.damage(damage).read_for(&view).map_err(failed)?;
    drop(bytes);
    let (depth, missing, channels) = (opened.splats().depth, opened.missing(), opened.splats().channels);
    let mut notes = losses(opened.metadata(), missing, of);
    notes.extend(format.losses(depth, opened.metadata()));
    let orientation = orientation(args, opened.metadata());
    let background = background(args, channels, format, &mut notes);
    let written = channels_over(channels, background);
    format.check(&sink::named(output), [view.width(), view.height()], written)?;
    let misfit = misfit(opened.metadata(), format, written);
    let own = |mut metadata: Metadata| {
        metadata.icc = metadata.icc.filter(|_| misfit.is_none());
        metadata
    };
    let mut shape = (view.width(), view.height());
    let mut device = String::from("CPU");
    let sink;
    let on_the_gpu = args.backend == Backend::Gpu;
    if on_the_gpu || orientation.is_some() || background.is_some() {
        // Rotation and compositing need the whole picture in memory.
        let pixels = if on_the_gpu {
            let pixels;
            (pixels, device) = on_gpu(&opened, &view).map_err(failed)?;
            pixels
        } else {
            opened.render(&view).map_err(failed)?
        };
        let source = shown(pixels, own(opened.into_metadata()), background, orientation).map_err(failed)?;
        shape = (source.pixels.width(), source.pixels.height());
        sink = args.many.sink(output, &[input])?;
        write_pixels(source, format, &sink, &sink::named(output))?;
    } else {
        let renderer = opened.renderer(&view).map_err(failed)?;
        let metadata = own(opened.into_metadata());
        sink = args.many.sink(output, &[input])?;
        let mut rows = start_rows(&renderer, depth, &metadata, format, &sink)?;
        draw(&renderer, depth, &mut rows, output, show)?;
        rows.finish(&sink::named(output))?;
    }
    let seconds = start.elapsed().as_secs_f64();
    let mut loss = json!({ "gaussians": missing.gaussians, "of": of });
    if missing.of_tiles > 0 {
        (loss["tiles"], loss["of_tiles"]) = (missing.tiles.into(), missing.of_tiles.into());
    }
    if missing.of_exact_tiles > 0 {
        (loss["exact_tiles"], loss["of_exact_tiles"]) = (missing.exact_tiles.into(), missing.of_exact_tiles.into());
    }
    let (width, height) = shape;
    let result = json!({ "width": width, "height": height, "missing": loss, "seconds": seconds, "device": device });
    notes.extend(misfit);
    let done = Done { text: String::new(), result, notes, fate: Fate::Written };
    report(&done)?;
    times.finish(sink)?;
    Ok(done)
}

/// Renders the file `bytes` so that it fits into a square, from its thumbnail if that is large enough.
fn thumbnail(
    args: &args::Decode,
    (input, output): (&Path, &Path),
    format: Format,
    (bytes, side): (&[u8], u32),
    (times, report): (KeptTimes, &Report),
) -> Result<Done, Failure> {
    let start = Instant::now();
    let failed = |e| Failure::library(input, &e);
    let damage = if args.partial { Damage::Accept } else { Damage::Refuse };
    let opening = Reader::new(bytes, &Limits::default()).map_err(failed)?;
    let gaussians = opening.gaussian_count();
    let ssplat::Decoded { pixels, mut metadata, missing, .. } =
        opening.damage(damage).thumbnail([side; 2]).map_err(failed)?;
    let mut notes = losses(&metadata, missing, gaussians);
    notes.extend(format.losses(pixels.depth(), &metadata));
    let orientation = orientation(args, &metadata);
    let background = background(args, pixels.channels(), format, &mut notes);
    let written = channels_over(pixels.channels(), background);
    format.check(&sink::named(output), [pixels.width(), pixels.height()], written)?;
    if let Some(note) = misfit(&metadata, format, written) {
        metadata.icc = None;
        notes.push(note);
    }
    let source = shown(pixels, metadata, background, orientation).map_err(failed)?;
    let (width, height) = (source.pixels.width(), source.pixels.height());
    let sink = args.many.sink(output, &[input])?;
    write_pixels(source, format, &sink, &sink::named(output))?;
    let (seconds, loss) = (start.elapsed().as_secs_f64(), json!({ "gaussians": 0 }));
    let result = json!({ "width": width, "height": height, "missing": loss, "seconds": seconds, "device": "CPU" });
    let done = Done { text: String::new(), result, notes, fate: Fate::Written };
    report(&done)?;
    times.finish(sink)?;
    Ok(done)
}

/// Returns the channels of a picture over its background, if it has one.
fn channels_over(channels: Channels, background: Option<[u8; 3]>) -> Channels {
    match background {
        Some(color) if channels.count() < 3 && color[1..] == [color[0]; 2] => Channels::Grey,
        Some(_) => Channels::Rgb,
        None => channels,
    }
}

/// Returns the orientation to apply, if any.
fn orientation(args: &args::Decode, metadata: &Metadata) -> Option<Orientation> {
    let orientation = source::orientation_in(metadata.exif.as_deref());
    (args.auto_orient && orientation != Orientation::NoTransforms).then_some(orientation)
}

/// Composites the picture over its background, rotates it, and returns it with its metadata.
fn shown(
    mut pixels: Pixels,
    mut metadata: Metadata,
    background: Option<[u8; 3]>,
    orientation: Option<Orientation>,
) -> ssplat::Result<Source> {
    if let Some(background) = background {
        pixels = opaque(&pixels, background)?;
    }
    if let Some(orientation) = orientation {
        let mut picture = DynamicImage::from(pixels);
        picture.apply_orientation(orientation);
        pixels = Pixels::try_from(picture)?;
        if let Some(exif) = &mut metadata.exif {
            let _ = Orientation::remove_from_exif_chunk(exif);
        }
    }
    let orientation = source::orientation_in(metadata.exif.as_deref());
    let Metadata { cicp, icc, exif, .. } = metadata;
    Ok(Source { pixels, cicp, icc, exif, orientation, is_cut_off: false, notes: Vec::new() })
}

/// Returns the background colour for a picture that loses its alpha.
fn background(args: &args::Decode, channels: Channels, format: Format, notes: &mut Vec<String>) -> Option<[u8; 3]> {
    channels.alpha()?;
    if args.background.is_none() && !format.has_alpha() {
        notes.push(
            "the output format has no alpha, so the picture is blended over white; --background sets another colour"
                .into(),
        );
        return Some([255; 3]);
    }
    args.background
}

/// Composites the picture over a background and removes alpha. A grey picture stays grey only if the background is
/// grey.
fn opaque(pixels: &Pixels, background: [u8; 3]) -> ssplat::Result<Pixels> {
    let (count, alpha) = (pixels.channels().count(), pixels.channels().count() - 1);
    let channels = channels_over(pixels.channels(), Some(background));
    let colors = channels.count();
    let most = f64::from(pixels.depth().max());
    let share = |i: usize| match pixels.samples() {
        Samples::U8(v) => f64::from(v[i]) / most,
        Samples::U16(v) => f64::from(v[i]) / most,
    };
    let value = |i: usize, k: usize| {
        let opacity = share(i * count + alpha);
        let over = share(i * count + if count < 3 { 0 } else { k });
        let under = f64::from(background[k]) / 255.0;
        ((under + opacity * (over - under)) * most).round()
    };
    let all = pixels.width() as usize * pixels.height() as usize;
    let values = (0..all).flat_map(|i| (0..colors).map(move |k| (i, k))).map(|(i, k)| value(i, k));
    let samples = match pixels.depth() {
        Depth::Eight => Samples::U8(values.map(|v| v as u8).collect()),
        Depth::Sixteen => Samples::U16(values.map(|v| v as u16).collect()),
    };
    Pixels::new(pixels.width(), pixels.height(), channels, samples)
}

/// Returns notes about the parts that are missing from a damaged file.
fn losses(metadata: &Metadata, missing: MissingParts, of: u32) -> Vec<String> {
    let section = |name| format!("section {} is damaged and left out", String::from_utf8_lossy(name));
    let mut notes: Vec<String> = metadata.damaged.iter().map(|name| section(&name[..])).collect();
    if missing != MissingParts::default() {
        let MissingParts { gaussians, groups, of_groups, tiles, of_tiles, exact_tiles, of_exact_tiles, .. } = missing;
        if groups > 0 {
            notes.push(format!("{gaussians} of {of} Gaussians in {groups} of {of_groups} groups are missing"));
        }
        let detail = ("detail", tiles - exact_tiles, of_tiles - of_exact_tiles);
        for (layer, missing, of) in [detail, ("exact", exact_tiles, of_exact_tiles)] {
            if missing > 0 {
                notes.push(format!("{missing} of {of} tiles of the {layer} layer are missing"));
            }
        }
        if groups == 0 && tiles == 0 {
            notes.push("the file is damaged or cut off, but the requested part of the picture is complete".into());
        }
    }
    notes
}

/// Renders the whole view on a GPU. Returns the pixels and the name of the GPU.
#[cfg(feature = "gpu")]
fn on_gpu(opened: &SsplatImage, view: &View) -> ssplat::Result<(Pixels, String)> {
    use ssplat::gpu::{Adapters, Device, Renderer};
    let device = Device::open(Adapters::Any)?;
    let pixels = Renderer::of(&device, opened)?.render(view, opened.splats().depth)?;
    Ok((pixels, device.name().to_owned()))
}

#[cfg(not(feature = "gpu"))]
fn on_gpu(_: &SsplatImage, _: &View) -> ssplat::Result<(Pixels, String)> {
    Err(ssplat::GpuError::NotBuilt.into())
}

/// Returns the view of the `whole` picture that `--region` and the size options select.
fn view(args: &args::Decode, input: &Path, whole: View) -> Result<View, Failure> {
    let failed = |e| Failure::library(input, &e);
    let mut view = whole;
    if let Some([x, y, width, height]) = args.region {
        view = view.crop(Rect::new(x, y, width, height)).map_err(|_| {
            Failure::usage(format!(
                "{}: --region {x},{y},{width},{height} is not within the picture of {}×{}",
                Failure::input(input),
                whole.width(),
                whole.height()
            ))
        })?;
    }
    let [width, height] = [view.width(), view.height()].map(f64::from);
    let [wide, tall] = match (args.width, args.height, args.scale) {
        (Some(w), Some(h), _) => [f64::from(w), f64::from(h)],
        (Some(w), None, _) => [f64::from(w), height * f64::from(w) / width],
        (None, Some(h), _) => [width * f64::from(h) / height, f64::from(h)],
        (None, None, Some(scale)) => [width * scale, height * scale],
        (None, None, None) => return Ok(view),
    };
    for (name, side) in [("wide", wide), ("high", tall)] {
        if side.round() > f64::from(LONGEST) {
            let path = Failure::input(input);
            return Err(Failure::usage(format!("{path}: it would be {side:.0} pixels {name}; {LONGEST} at most")));
        }
    }
    // No side becomes shorter than one pixel.
    view.resized(wide.round().max(1.0) as u32, tall.round().max(1.0) as u32).map_err(failed)
}

/// Starts the output of `renderer`.
fn start_rows<'a>(
    renderer: &Renderer,
    depth: Depth,
    metadata: &'a Metadata,
    format: Format,
    sink: &Sink,
) -> Result<RowWriter<'a>, Failure> {
    let (width, height) = (renderer.view().width(), renderer.view().height());
    let shape = Shape { width, height, channels: renderer.channels(), depth };
    RowWriter::new(sink, format, shape, metadata).map_err(|e| Failure::io(sink.path(), &e))
}

/// Renders and writes the picture, a few bands at a time.
fn draw(renderer: &Renderer, depth: Depth, rows: &mut RowWriter, path: &Path, show: &Show) -> Result<(), Failure> {
    let io = |e| Failure::io(&sink::named(path), &e);
    let (mut bytes, mut words) = (Vec::new(), Vec::new());
    let most = (MIN_BYTES_PER_THREAD * rayon::current_num_threads()).min(BATCH);
    let mut first = 0;
    while first < renderer.bands() {
        // In pairs, because a tile of the detail layer has two bands.
        let mut last = (first + 2).min(renderer.bands());
        let samples = |last| {
            let rows = renderer.band_rows(last - 1).end - renderer.band_rows(first).start;
            rows as usize * renderer.row_len()
        };
        while last < renderer.bands() && samples((last + 2).min(renderer.bands())) * depth.bytes() <= most {
            last = (last + 2).min(renderer.bands());
        }
        match depth {
            Depth::Eight => {
                bytes.resize(samples(last), 0);
                renderer.render_bands(first..last, SamplesMut::U8(&mut bytes));
                rows.write(SamplesMut::U8(&mut bytes)).map_err(io)?;
            }
            Depth::Sixteen => {
                words.resize(samples(last), 0);
                renderer.render_bands(first..last, SamplesMut::U16(&mut words));
                rows.write(SamplesMut::U16(&mut words)).map_err(io)?;
            }
        }
        first = last;
        show(first as f32 / renderer.bands() as f32, "drawing");
    }
    Ok(())
}
