//! Formats of `export` and `import`, and their file name extensions.

use std::path::Path;

use clap::ValueEnum;

use crate::failure::Failure;

/// File formats of `export`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// NumPy archive of arrays
    Npz,
    /// Text table
    Csv,
    /// Points for viewers of 3D Gaussian Splatting
    Ply,
    /// Ellipses for figures
    Svg,
}

/// File formats of `import`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ImportFormat {
    /// NumPy archive of arrays
    Npz,
    /// Text table
    Csv,
    /// Points of 3D Gaussian Splatting, flat in z
    Ply,
}

impl ExportFormat {
    /// Returns the format of the extension of `path`.
    pub fn of_path(path: &Path) -> Result<Self, Failure> {
        of_path(path, "npz, csv, ply or svg")
    }
}

impl ImportFormat {
    /// Returns the format of the extension of `path`.
    pub fn of_path(path: &Path) -> Result<Self, Failure> {
        of_path(path, "npz, csv or ply")
    }
}

fn of_path<F: ValueEnum>(path: &Path, known: &str) -> Result<F, Failure> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    F::from_str(extension, true).map_err(|_| {
        Failure::usage(format!(
            "{}: unknown extension; give --format {known}, or a name with one of these extensions",
            path.display()
        ))
    })
}
