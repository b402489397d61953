//! `ssplat export`: the Gaussians of a file, in formats of other programs.

use std::path::Path;

use image::metadata::Orientation;
use ssplat::{Limits, Reader};

use crate::exchange::format::ExportFormat;
use crate::exchange::parameters::Parameters;
use crate::exchange::{csv, ply, svg};
use crate::failure::{Failure, Kind};
use crate::sink::{Sink, tell};
use crate::{args, input, source};

pub fn run(args: &args::Export) -> Result<(), Failure> {
    let format = match args.format {
        Some(format) => format,
        None => ExportFormat::of_path(&args.output)?,
    };
    let bytes = input::read_splats(&args.input)?;
    let refused = |e| Failure::library(&args.input, &e);
    let image = Reader::new(&bytes, &Limits::default()).and_then(|r| r.read()).map_err(refused)?;
    if image.splats().detail.is_some() {
        tell(&format!("{}: the detail layer is not exported, only the Gaussians", Failure::input(&args.input)));
    }
    if source::orientation_in(image.metadata().exif.as_deref()) != Orientation::NoTransforms {
        tell(&format!(
            "{}: the orientation is not exported, so other programs show the picture turned; \
             `ssplat encode --auto-orient` turns the pixels",
            Failure::input(&args.input)
        ));
    }
    let parameters = Parameters::of(&image).map_err(refused)?;
    let file = match format {
        ExportFormat::Npz => parameters.to_npz().map_err(|e| failed(&args.output, &e))?,
        ExportFormat::Csv => csv::write(&parameters).into_bytes(),
        ExportFormat::Ply => ply::write(&parameters),
        ExportFormat::Svg => svg::write(&parameters.picture).into_bytes(),
    };
    Sink::create(&args.output, &[&args.input])?.finish_with(&file)
}

fn failed(path: &Path, message: &str) -> Failure {
    Failure { kind: Kind::Other, message: format!("{}: {message}", path.display()) }
}
