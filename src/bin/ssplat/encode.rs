//! `ssplat encode`: a picture to a file, with progress, and what it measured.

use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use serde_json::{Value, json};
use ssplat::bitstream::splats::Metadata;
use ssplat::metrics::Comparison;
use ssplat::raster::SamplesMut;
use ssplat::{EncodeReport, Limits, Pixels, Samples};

use crate::failure::Failure;
use crate::progress::Bar;
use crate::rows::{Format, RowWriter, Shape};
use crate::sink::{Sink, say};
use crate::source::{self, Source};
use crate::{args, compare, left_out};

pub fn run(args: &args::Encode) -> Result<(), Failure> {
    if args.json && args.output == Path::new("-") {
        return Err(Failure::usage("--json and the file cannot both go to standard output"));
    }
    if args.preview.as_ref() == Some(&args.output) {
        return Err(Failure::usage(format!("{}: cannot hold both the file and its preview", args.output.display())));
    }
    let Source { pixels, icc, exif } = source::open(&args.input)?;
    let mut options = args.options();
    (options.icc, options.exif) = (icc, exif);
    // That a file cannot be written is found out before the work is done, not after.
    let sink = Sink::create(&args.output, &[&args.input])?;
    let preview = args.preview.as_deref().map(|path| Preview::prepare(path, &args.input)).transpose()?;
    let bar = Bar::new();
    let encoded = ssplat::encode_with_progress(&pixels, &options, &mut |p| {
        bar.show(p.done, p.stage);
        ControlFlow::Continue(())
    })
    .map_err(|e| Failure::library(&args.input, &e))?;
    drop(bar);
    sink.finish_with(&encoded.bytes)?;

    let mut result = summary(&pixels, encoded.bytes.len(), &encoded.report);
    let mut text = format!(
        "{}: {} bytes, ratio {:.1}, {} primitives, PSNR {:.2} dB, encoded in {:.2} s\n",
        args.output.display(),
        encoded.bytes.len(),
        ratio(&pixels, encoded.bytes.len()),
        encoded.report.primitives,
        encoded.report.psnr,
        encoded.report.seconds
    );
    // Where there is a choice, it is told.
    if cfg!(feature = "gpu") {
        text += &format!("fitted on {}\n", encoded.report.chosen);
    }
    if let Some(preview) = preview {
        let path = preview.path;
        let (found, seconds) = preview.finish(&encoded.bytes, &pixels)?;
        text += &format!("{}: {}, decoded in {seconds:.3} s\n", path.display(), compare::as_text(&found));
        result["preview"] = compare::as_json(&found);
        result["preview"]["seconds"] = seconds.into();
    }
    if args.explain {
        text += &explain(&encoded.report);
        let (splats, report) = ssplat::bitstream::inspect(&encoded.bytes, &Limits::default())
            .map_err(|e| Failure::library(&args.output, &e))?;
        text += "not in the file:\n";
        text += &left_out::as_text(&left_out::of_file(&splats, &report));
    }
    if args.output == Path::new("-") {
        eprint!("{text}");
        return Ok(());
    }
    say(&if args.json { format!("{result:#}\n") } else { text })
}

/// Bytes of the samples with 8 bits each over bytes of the file.
fn ratio(pixels: &Pixels, bytes: usize) -> f64 {
    f64::from(pixels.width()) * f64::from(pixels.height()) * pixels.channels().count() as f64 / bytes as f64
}

/// The picture that `--preview` asks for.
struct Preview<'a> {
    path: &'a Path,
    format: Format,
    sink: Sink,
}

impl<'a> Preview<'a> {
    fn prepare(path: &'a Path, input: &Path) -> Result<Self, Failure> {
        Ok(Preview { path, format: Format::of_path(path)?, sink: Sink::create(path, &[input])? })
    }

    /// Decodes `bytes`, writes the pixels and compares them with `original`; also the seconds that decoding took.
    fn finish(self, bytes: &[u8], original: &Pixels) -> Result<(Comparison, f64), Failure> {
        let start = Instant::now();
        let decoded = source::decode(self.path, bytes)?;
        let seconds = start.elapsed().as_secs_f64();
        let found = compare::measure(original, &decoded.pixels).map_err(|e| Failure::library(self.path, &e))?;
        write_pixels(decoded, self.format, &self.sink, self.path)?;
        self.sink.finish()?;
        Ok((found, seconds))
    }
}

/// Writes a whole picture.
pub fn write_pixels(source: Source, format: Format, sink: &Sink, path: &Path) -> Result<(), Failure> {
    let Source { pixels, icc, exif } = source;
    let shape =
        Shape { width: pixels.width(), height: pixels.height(), channels: pixels.channels(), depth: pixels.depth() };
    let mut metadata = Metadata::default();
    (metadata.icc, metadata.exif) = (icc, exif);
    let io = |e| Failure::io(path, &e);
    let mut rows = RowWriter::new(sink, format, shape, &metadata).map_err(io)?;
    match &mut pixels.into_samples() {
        Samples::U8(samples) => rows.write(SamplesMut::U8(samples)).map_err(io)?,
        Samples::U16(samples) => rows.write(SamplesMut::U16(samples)).map_err(io)?,
    }
    rows.finish(path)
}

/// The result for programs.
fn summary(pixels: &Pixels, bytes: usize, report: &EncodeReport) -> Value {
    let stages: Vec<Value> = report.stages.iter().map(|(name, s)| json!({ "name": name, "seconds": s })).collect();
    let left_out: Vec<Value> = report
        .left_out
        .iter()
        .map(|l| json!({ "what": l.what.to_string(), "bytes_saved": l.bytes, "seconds_saved": l.seconds }))
        .collect();
    json!({
        "width": pixels.width(),
        "height": pixels.height(),
        "bytes": bytes,
        "ratio": ratio(pixels, bytes),
        "primitives": report.primitives,
        "float_psnr": report.float_psnr.min(compare::IDENTICAL),
        "psnr": report.psnr.min(compare::IDENTICAL),
        "seconds": report.seconds,
        "stages": stages,
        "left_out": left_out,
        "device": report.chosen.device,
        "device_reason": report.chosen.reason,
    })
}

/// Where the time and the bytes went.
fn explain(report: &EncodeReport) -> String {
    let mut text = String::from("stages:\n");
    for (name, seconds) in &report.stages {
        text += &format!("  {name:<24} {seconds:8.2} s\n");
    }
    if !report.left_out.is_empty() {
        text += "left out:\n";
    }
    for l in &report.left_out {
        let bytes = if l.bytes > 0 { format!(" {} bytes", l.bytes) } else { String::new() };
        let seconds = if l.seconds > 0.0 { format!(" {:.2} s", l.seconds) } else { String::new() };
        let saved = [bytes, seconds].concat();
        text += &format!("  {}{}{saved}\n", l.what, if saved.is_empty() { "" } else { ": saves" });
    }
    text
}
