//! Named arrays in one file: NumPy's `.npz`, a ZIP archive of `.npy` files.

use std::collections::BTreeMap;
use std::io::{BufReader, Cursor, Write};

use ssplat::Limits;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use super::npy::{self, Array};
use super::problem::Problem;

/// The archive of `.npy` files.
pub fn write(arrays: &[(&str, Vec<u8>)]) -> Result<Vec<u8>, String> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    for (name, array) in arrays {
        zip.start_file(format!("{name}.npy"), options).map_err(|e| e.to_string())?;
        zip.write_all(array).map_err(|e| e.to_string())?;
    }
    Ok(zip.finish().map_err(|e| e.to_string())?.into_inner())
}

/// Those arrays of an archive that have one of the names. They are held to `limits` before memory is taken: an archive may
/// unpack to far more than it is long.
pub fn read(bytes: &[u8], names: &[&str], limits: &Limits) -> Result<BTreeMap<String, Array>, Problem> {
    let mut zip = ZipArchive::new(Cursor::new(bytes)).map_err(|e| format!("not an .npz archive: {e}"))?;
    let mut arrays = BTreeMap::new();
    let mut left = limits.alloc;
    for &name in names {
        let Some(index) = zip.index_for_name(&format!("{name}.npy")) else { continue };
        let entry = zip.by_index(index).map_err(|e| format!("array {name}: {e}"))?;
        let array = npy::read(BufReader::new(entry), limits.primitives, &mut left).map_err(|e| e.of(name))?;
        arrays.insert(name.to_owned(), array);
    }
    Ok(arrays)
}
