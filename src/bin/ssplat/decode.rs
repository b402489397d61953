//! `ssplat decode`: a file, or a part of it at any size, to a picture, band by band.

use std::path::Path;
use std::time::Instant;

use serde_json::json;
use ssplat::bitstream::Missing;
use ssplat::bitstream::splats::Metadata;
use ssplat::raster::{Renderer, SamplesMut, View};
use ssplat::{Backend, Damage, Depth, Limits, Opening, Picture, Pixels};

use crate::failure::Failure;
use crate::progress::Bar;
use crate::rows::{Format, RowWriter, Shape};
use crate::sink::{Sink, say};
use crate::source::{self, Source};
use crate::{args, encode};

/// Bytes of output that are drawn before they are written, unless one band takes more.
const BATCH: usize = 8 << 20;

pub fn run(args: &args::Decode) -> Result<(), Failure> {
    let start = Instant::now();
    let format = match &args.format {
        Some(extension) => Format::from_extension(extension)?,
        None if args.output == Path::new("-") => Format::Png,
        None => Format::of_path(&args.output)?,
    };
    let bytes = source::read_all(&args.input)?;
    let failed = |e| Failure::library(&args.input, &e);
    let limits = Limits::default();
    let opening = Opening::new(&bytes, &limits).map_err(failed)?;
    let of = opening.header().primitives;
    let view = view(args, opening.view()).map_err(failed)?;
    let damage = if args.partial { Damage::Accept } else { Damage::Refuse };
    let opened = opening.read_for(&view, damage).map_err(failed)?;
    drop(bytes);
    let (depth, missing) = (opened.splats().depth, opened.missing());
    report_loss(&args.input, opened.metadata(), missing, of);
    let sink;
    let mut device = String::from("CPU");
    if args.backend == Backend::Gpu {
        let pixels;
        (pixels, device) = on_gpu(&opened.splats().to_picture(), &view, depth, &limits).map_err(failed)?;
        sink = Sink::create(&args.output, &[&args.input])?;
        let metadata = opened.into_metadata();
        let source = Source { pixels, icc: metadata.icc, exif: metadata.exif };
        encode::write_pixels(source, format, &sink, &args.output)?;
    } else {
        let renderer = opened.renderer(&view).map_err(failed)?;
        let metadata = opened.into_metadata();
        sink = Sink::create(&args.output, &[&args.input])?;
        draw(&renderer, depth, &metadata, format, &sink, &args.output)?;
    }
    sink.finish()?;
    let seconds = start.elapsed().as_secs_f64();
    if args.json && args.output != Path::new("-") {
        let loss = json!({ "primitives": missing.primitives, "of": of });
        let (width, height) = (view.width(), view.height());
        let result = json!({ "width": width, "height": height, "missing": loss, "seconds": seconds, "device": device });
        say(&format!("{result}\n"))?;
    }
    Ok(())
}

/// Says on standard error what a damaged file has lost.
fn report_loss(path: &Path, metadata: &Metadata, missing: Missing, of: u32) {
    for name in &metadata.damaged {
        eprintln!("ssplat: {}: section {} is damaged and left out", path.display(), String::from_utf8_lossy(name));
    }
    if missing != Missing::default() {
        let Missing { primitives, groups, of_groups, .. } = missing;
        eprintln!(
            "ssplat: {}: {primitives} of {of} primitives in {groups} of {of_groups} groups are missing",
            path.display()
        );
    }
}

/// Draws on a GPU, the whole view at once; also the GPU's name.
#[cfg(feature = "gpu")]
fn on_gpu(picture: &Picture, view: &View, depth: Depth, limits: &Limits) -> ssplat::Result<(Pixels, String)> {
    use ssplat::gpu::{Adapters, Device, Renderer};
    let device = Device::open(Adapters::Any)?;
    let pixels = Renderer::new(&device, picture, limits)?.render(view, depth)?;
    Ok((pixels, device.name().to_owned()))
}

#[cfg(not(feature = "gpu"))]
fn on_gpu(_: &Picture, _: &View, _: Depth, _: &Limits) -> ssplat::Result<(Pixels, String)> {
    Err(ssplat::GpuError::NotBuilt.into())
}

/// What `--region` and the size options ask for of the `whole` picture.
fn view(args: &args::Decode, whole: View) -> ssplat::Result<View> {
    let mut view = whole;
    if let Some([x, y, width, height]) = args.region {
        view = view.crop(x, y, width, height)?;
    }
    let [width, height] = [view.width(), view.height()].map(f64::from);
    let [wide, tall] = match (args.width, args.height, args.scale) {
        (Some(w), Some(h), _) => [f64::from(w), f64::from(h)],
        (Some(w), None, _) => [f64::from(w), height * f64::from(w) / width],
        (None, Some(h), _) => [width * f64::from(h) / height, f64::from(h)],
        (None, None, Some(scale)) => [width * scale, height * scale],
        (None, None, None) => return Ok(view),
    };
    // A side that would vanish keeps one pixel; one that is too long is left for `resized` to refuse.
    view.resized(wide.round().max(1.0) as u32, tall.round().max(1.0) as u32)
}

/// Draws and writes everything, a few bands at a time.
pub fn draw(
    renderer: &Renderer,
    depth: Depth,
    metadata: &Metadata,
    format: Format,
    sink: &Sink,
    path: &Path,
) -> Result<(), Failure> {
    let io = |e| Failure::io(path, &e);
    let shape = Shape {
        width: renderer.view().width(),
        height: renderer.view().height(),
        channels: renderer.channels(),
        depth,
    };
    let mut rows = RowWriter::new(sink, format, shape, metadata).map_err(io)?;
    let bar = Bar::new();
    let (mut bytes, mut words) = (Vec::new(), Vec::new());
    let mut first = 0;
    while first < renderer.bands() {
        let mut last = first + 1;
        let samples = |last| {
            let rows = renderer.band_rows(last - 1).end - renderer.band_rows(first).start;
            rows as usize * renderer.row_len()
        };
        while last < renderer.bands() && samples(last + 1) * depth.bytes() <= BATCH {
            last += 1;
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
        bar.show(first as f32 / renderer.bands() as f32, "drawing");
    }
    rows.finish(path)
}
