//! Lists the pictures of a folder, for examples that measure all of them.

use std::path::{Path, PathBuf};
use std::{fs, io};

/// Returns the pictures in `folder`, sorted by name. If `only` is not empty, only those that it names.
pub fn pictures(folder: &Path, only: &[String]) -> io::Result<Vec<PathBuf>> {
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)?.map(|e| Ok(e?.path())).collect::<io::Result<_>>()?;
    paths.retain(|p| {
        let name = p.file_name().unwrap_or_default().to_string_lossy();
        image::ImageFormat::from_path(p).is_ok() && (only.is_empty() || only.contains(&name.into_owned()))
    });
    paths.sort();
    Ok(paths)
}
