//! Atomic file replacement: files are written under a temporary name and renamed.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Makes the temporary names within a process unique.
static COUNT: AtomicU64 = AtomicU64::new(0);

/// Writes `bytes` to `path` atomically: if writing fails, the old file is kept. Devices and pipes are written
/// directly.
///
/// # Errors
/// Errors of the file system; no temporary file is left behind.
pub(super) fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let found = fs::metadata(path);
    let target = match &found {
        // Devices and pipes cannot be renamed over.
        Ok(found) if !found.is_file() => return fs::write(path, bytes),
        // The file behind a link is replaced, not the link.
        Ok(_) => fs::canonicalize(path)?,
        // A dangling link: writing directly lets the system follow it.
        Err(_) if fs::symlink_metadata(path).is_ok() => return fs::write(path, bytes),
        Err(_) => path.to_path_buf(),
    };
    let Some(name) = target.file_name() else { return Err(io::ErrorKind::InvalidInput.into()) };
    let count = COUNT.fetch_add(1, Ordering::Relaxed);
    let temporary = target.with_file_name(format!(".{}.{}-{count}", name.to_string_lossy(), std::process::id()));
    let mut file = File::create_new(&temporary)?;
    // The new file gets the permissions of the old one.
    let rights = found.map_or(Ok(()), |found| file.set_permissions(found.permissions()));
    let written = rights.and_then(|()| file.write_all(bytes)).and_then(|()| fs::rename(&temporary, &target));
    if written.is_err() {
        let _ = fs::remove_file(&temporary);
    }
    written
}
