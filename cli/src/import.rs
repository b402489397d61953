//! `ssplat import`: Gaussians that were fitted elsewhere, to an .ssplat file.

use std::path::Path;

use ssplat::unstable::{EncodeOptions, Outside, Precision};
use ssplat::{Encoder, Error, Limits, Parameter, Target};

use crate::exchange::format::ImportFormat;
use crate::exchange::parameters::{self, Given, Parameters};
use crate::exchange::problem::Problem;
use crate::exchange::{csv, foreign, npz, ply};
use crate::failure::{Failure, Kind};
use crate::sink::{Sink, tell};
use crate::{args, input};

pub fn run(args: &args::Import) -> Result<(), Failure> {
    let format = match args.format {
        Some(format) => format,
        None => ImportFormat::of_path(&args.input)?,
    };
    let limits = Limits::default();
    let bytes = input::read_at_most(&args.input, limits.alloc)?;
    let failed = |problem: Problem| broken(&args.input, problem.kind(), &problem.to_string());
    let given = Given { size: args.size, blend: args.blend };
    let parameters = match format {
        ImportFormat::Csv => {
            let text = std::str::from_utf8(&bytes).map_err(|e| failed(format!("no text: {e}").into()))?;
            csv::read(text, given, &limits).map_err(failed)?
        }
        ImportFormat::Ply => {
            let (parameters, caveat) = ply::read(&bytes, given, &limits).map_err(failed)?;
            if let Some(caveat) = caveat {
                tell(&format!("{}: {caveat}", Failure::input(&args.input)));
            }
            parameters
        }
        ImportFormat::Npz => {
            let names = [&parameters::ARRAYS[..], &foreign::ARRAYS[..]].concat();
            let arrays = npz::read(&bytes, &names, &limits).map_err(failed)?;
            if foreign::is_known(&arrays) {
                let (parameters, caveat) = foreign::read(&arrays, given).map_err(failed)?;
                tell(&format!("{}: {caveat}", Failure::input(&args.input)));
                parameters
            } else {
                Parameters::from_arrays(&arrays, given).map_err(failed)?
            }
        }
    };
    drop(bytes);
    let encoder = Encoder::from(options(args, &parameters));
    let encoded = encoder.encode_gaussians(&parameters.picture).map_err(|e| match e {
        // All parameters except the size come from the input.
        Error::Parameter { parameter, .. } if parameter != Parameter::Bytes => {
            broken(&args.input, Kind::Format, &e.to_string())
        }
        e => Failure::library(&args.input, &e),
    })?;
    let left_out = parameters.picture.list.len() - encoded.report.gaussians;
    if left_out > 0 {
        tell(&format!(
            "{}: {left_out} Gaussians do not reach the picture and are left out",
            Failure::input(&args.input)
        ));
    }
    Sink::create(&args.output, &[&args.input])?.finish_with(&encoded.bytes)
}

/// Returns the options: those of the arguments, else those that the Gaussians were stored with, else the defaults.
fn options(args: &args::Import, parameters: &Parameters) -> EncodeOptions {
    let mut options = EncodeOptions::default();
    options.outside = Outside::Crop;
    if let Some((layout, steps)) = parameters.stored {
        options.layout = layout;
        options.precision = Some(Precision::Steps(steps));
    }
    if let Some(layout) = args.layout {
        // Steps depend on the layout.
        if layout != options.layout {
            options.precision = None;
        }
        options.layout = layout;
    }
    match (args.precision, args.bytes) {
        (Some(level), _) => options.precision = Some(Precision::Level(level)),
        (None, Some(bytes)) => (options.precision, options.target) = (None, Target::Bytes(bytes)),
        (None, None) => {}
    }
    options
}

fn broken(path: &Path, kind: Kind, message: &str) -> Failure {
    Failure { kind, message: format!("{}: {message}", Failure::input(path)) }
}
