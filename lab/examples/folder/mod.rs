//! The pictures of a folder, for examples that measure them all.

use std::path::{Path, PathBuf};
use std::{fs, io};

/// The pictures in `folder`, by name; only those that `only` names, if it names any.
pub fn pictures(folder: &Path, only: &[String]) -> io::Result<Vec<PathBuf>> {
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)?.map(|e| Ok(e?.path())).collect::<io::Result<_>>()?;
    paths.retain(|p| {
        let name = p.file_name().unwrap_or_default().to_string_lossy();
        image::ImageFormat::from_path(p).is_ok() && (only.is_empty() || only.contains(&name.into_owned()))
    });
    paths.sort();
    Ok(paths)
}
