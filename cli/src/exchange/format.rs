//! Which formats go out and come in, by the names of files.

use std::path::Path;

use clap::ValueEnum;

use crate::failure::Failure;

/// File formats that export writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// NumPy's archive of arrays
    Npz,
    /// A table of text
    Csv,
    /// Points for viewers of 3D Gaussian Splatting
    Ply,
    /// Ellipses for figures
    Svg,
}

/// File formats that import reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ImportFormat {
    /// NumPy's archive of arrays
    Npz,
    /// A table of text
    Csv,
}

impl ExportFormat {
    /// The format that the name of `path` ends with.
    pub fn of_path(path: &Path) -> Result<Self, Failure> {
        of_path(path, "npz, csv, ply or svg")
    }
}

impl ImportFormat {
    /// The format that the name of `path` ends with.
    pub fn of_path(path: &Path) -> Result<Self, Failure> {
        of_path(path, "npz or csv")
    }
}

fn of_path<F: ValueEnum>(path: &Path, known: &str) -> Result<F, Failure> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    F::from_str(extension, true)
        .map_err(|_| Failure::usage(format!("{}: give --format {known}, or a name that ends so", path.display())))
}
