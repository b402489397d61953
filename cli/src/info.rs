//! `ssplat info`: the header, the bytes of each part, and the bits per Gaussian and field.

use std::path::Path;

use serde_json::{Value, json};
use ssplat::unstable::bitstream::header::VERSION;
use ssplat::unstable::bitstream::report::Report;
use ssplat::unstable::bitstream::sections::{SectionFate, SectionInfo};
use ssplat::unstable::bitstream::splats::PackedSplats;
use ssplat::{Channels, Limits};

use crate::failure::Failure;
use crate::input;
use crate::names::{blend_name, layout_name};
use crate::sink::{say, tell};
use crate::{args, left_out};

pub fn run(args: &args::Info) -> Result<(), Failure> {
    let [input] = &args.inputs[..] else { return several(args) };
    let (splats, report) = inspected(input)?;
    say(&if args.json { format!("{:#}\n", as_json(&splats, &report)) } else { as_text(&splats, &report) })
}

/// Prints the facts about each file. A failure is reported, does not stop the other files, and is returned at the end.
fn several(args: &args::Info) -> Result<(), Failure> {
    let mut failed = None;
    for (i, input) in args.inputs.iter().enumerate() {
        let (splats, report) = match inspected(input) {
            Ok(found) => found,
            Err(failure) => {
                if let Some(Failure { message, .. }) = failed.replace(failure) {
                    tell(&message);
                }
                continue;
            }
        };
        let name = Failure::input(input);
        if args.json {
            let mut value = as_json(&splats, &report);
            value["file"] = name.into();
            say(&format!("{value}\n"))?;
        } else {
            let between = if i > 0 { "\n" } else { "" };
            say(&format!("{between}{name}:\n{}", as_text(&splats, &report)))?;
        }
    }
    failed.map_or(Ok(()), Err)
}

fn inspected(input: &Path) -> Result<(PackedSplats, Report), Failure> {
    let bytes = input::read_splats(input)?;
    ssplat::unstable::bitstream::inspect(&bytes, &Limits::default()).map_err(|e| Failure::library(input, &e))
}

fn as_json(splats: &PackedSplats, report: &Report) -> Value {
    let h = &report.header;
    let parts: Vec<Value> = report.parts.iter().map(|p| json!({ "name": p.name, "bytes": p.bytes })).collect();
    let sections: Vec<Value> = report
        .sections
        .iter()
        .map(|s| json!({ "name": section_name(s), "bytes": s.bytes, "fate": fate(s.fate) }))
        .collect();
    let fields: Vec<Value> = report
        .fields
        .iter()
        .map(|f| json!({ "name": f.name, "bits": f.bits, "bits_per_gaussian": per_gaussian(f.bits, splats) }))
        .collect();
    let left_out: Vec<Value> =
        left_out::of_file(splats, report).iter().map(|a| json!({ "what": a.what, "bytes_saved": a.saved })).collect();
    json!({
        "version": VERSION,
        "width": h.width,
        "height": h.height,
        "channels": channels(h.channels),
        "depth": 8 * h.depth.bytes(),
        "blend": blend_name(h.blend),
        "layout": layout_name(h.layout),
        "steps": {
            "scale": h.steps.scale,
            "angle": h.steps.angle,
            "position": h.steps.position,
            "coarsest": h.steps.coarsest,
            "range": h.steps.range,
            "luma": h.steps.luma,
            "chroma": h.steps.chroma,
        },
        "gaussians": h.gaussians,
        "levels": report.levels,
        "groups": report.groups,
        "codebook": splats.codebook.as_ref().map(Vec::len),
        "cicp": splats.metadata.cicp.map(|cicp| json!({ "bytes": cicp.to_bytes(), "name": cicp.to_string() })),
        "icc_bytes": splats.metadata.icc.as_ref().map(Vec::len),
        "exif_bytes": splats.metadata.exif.as_ref().map(Vec::len),
        "thumbnail_bytes": splats.metadata.thumbnail.as_ref().map(Vec::len),
        "detail": detail(splats, report),
        "exact": exact(splats, report),
        "bytes": report.bytes,
        "ratio": ratio(report),
        "bits_per_gaussian": per_gaussian(8.0 * report.bytes as f64, splats),
        "parts": parts,
        "sections": sections,
        "fields": fields,
        "left_out": left_out,
    })
}

/// Returns the facts about the detail layer, if there is one.
fn detail(splats: &PackedSplats, report: &Report) -> Option<Value> {
    let layer = splats.detail.as_ref()?;
    let head = &layer.head;
    Some(json!({
        "bytes": report.layer_bytes(),
        "bits": report.layer_bits,
        "levels": layer.levels(),
        "bits_per_level": (layer.levels() > 0).then(|| report.layer_bits / layer.levels() as f64),
        "tiles": layer.tiles(),
        "of_tiles": layer.of_tiles(),
        "step": f64::from(head.step) / 64.0,
        "classes": head.classes,
        "alpha": head.alpha,
    }))
}

/// Returns the facts about the exact layer, if there is one.
fn exact(splats: &PackedSplats, report: &Report) -> Option<Value> {
    let layer = splats.exact.as_ref()?;
    let covered = layer.covered([splats.width, splats.height]);
    Some(json!({
        "bytes": report.exact_bytes(),
        "covered_pixels": covered,
        "bits_per_covered_pixel": (covered > 0).then(|| 8.0 * report.exact_bytes() as f64 / covered as f64),
        "tile_side": layer.tile_side(),
    }))
}

fn as_text(splats: &PackedSplats, report: &Report) -> String {
    let h = &report.header;
    let mut text = format!(
        "picture     {} x {} pixels, {}, {} bits\n\
         file        {} bytes, ratio {:.1}, version {VERSION}, {} layout\n\
         Gaussians   {}, {} blend, {:.1} bits each over the whole file\n",
        h.width,
        h.height,
        channels(h.channels),
        8 * h.depth.bytes(),
        report.bytes,
        ratio(report),
        layout_name(h.layout),
        h.gaussians,
        blend_name(h.blend),
        per_gaussian(8.0 * report.bytes as f64, splats).unwrap_or(0.0),
    );
    if let Some(cicp) = splats.metadata.cicp {
        text += &format!("colours     {cicp}\n");
    }
    if let Some(codebook) = &splats.codebook {
        text += &format!("codebook    {} colours\n", codebook.len());
    }
    if report.levels.len() > 1 {
        text += &format!("levels      {:?} Gaussians, coarse to fine\n", report.levels);
    }
    if report.groups > 1 {
        text += &format!("groups      {}\n", report.groups);
    }
    if let Some(layer) = &splats.detail {
        text += &format!(
            "detail      {} bytes, {} levels in {} of {} tiles, {:.2} bits a level\n",
            report.layer_bytes(),
            layer.levels(),
            layer.tiles(),
            layer.of_tiles(),
            report.layer_bits / layer.levels().max(1) as f64,
        );
    }
    if let Some(layer) = &splats.exact {
        let covered = layer.covered([splats.width, splats.height]);
        let pixels = f64::from(splats.width) * f64::from(splats.height);
        text += &format!(
            "exact       {} bytes, {:.1} % of the pixels, {:.3} bits each, in tiles of {}\n",
            report.exact_bytes(),
            100.0 * covered as f64 / pixels,
            8.0 * report.exact_bytes() as f64 / covered.max(1) as f64,
            layer.tile_side(),
        );
    }
    text += "parts\n";
    for part in &report.parts {
        text += &format!("  {:<20} {:>10} bytes\n", part.name, part.bytes);
    }
    for section in &report.sections {
        text +=
            &format!("  section {:<12} {:>10} bytes, {}\n", section_name(section), section.bytes, fate(section.fate));
    }
    text += "fields\n";
    for field in &report.fields {
        let each = per_gaussian(field.bits, splats).unwrap_or(0.0);
        text += &format!("  {:<20} {each:>10.2} bits a Gaussian\n", field.name);
    }
    text += "left out\n";
    text += &left_out::as_text(&left_out::of_file(splats, report));
    // A file does not record how it was encoded.
    text += "  what the fit left out: `ssplat encode --explain` tells when it is made\n";
    text
}

/// Returns width × height × channels over the bytes of the file.
fn ratio(report: &Report) -> f64 {
    let h = &report.header;
    f64::from(h.width) * f64::from(h.height) * h.channels.count() as f64 / report.bytes as f64
}

/// Returns bits per Gaussian; `None` without Gaussians.
fn per_gaussian(bits: f64, splats: &PackedSplats) -> Option<f64> {
    let count = splats.gaussians.len();
    (count > 0).then(|| bits / count as f64)
}

fn section_name(section: &SectionInfo) -> String {
    String::from_utf8_lossy(&section.name).into_owned()
}

fn fate(fate: SectionFate) -> &'static str {
    match fate {
        SectionFate::Kept => "kept",
        SectionFate::Skipped => "unknown, skipped",
        SectionFate::Damaged => "damaged, dropped",
    }
}

fn channels(channels: Channels) -> &'static str {
    match channels {
        Channels::Grey => "grey",
        Channels::GreyAlpha => "grey+alpha",
        Channels::Rgb => "rgb",
        Channels::Rgba => "rgba",
    }
}
