//! Named arrays in one file: NumPy's `.npz`, a ZIP archive of `.npy` files.

use std::collections::BTreeMap;
use std::io::{BufReader, Cursor, Write};

use ssplat::Limits;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use super::npy::{self, Array};
use super::problem::Problem;

/// Memory that the arrays of any archive may take, and the memory per byte of the archive above that: numbers in single
/// precision take twice their length, and compressed ones of real pictures up to ten times.
const FREE: u64 = 64 << 20;
const MOST_UNPACKED: u64 = 64;

/// Writes an archive of `.npy` files.
pub fn write(arrays: &[(&str, Vec<u8>)]) -> Result<Vec<u8>, String> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    for (name, array) in arrays {
        zip.start_file(format!("{name}.npy"), options).map_err(|e| e.to_string())?;
        zip.write_all(array).map_err(|e| e.to_string())?;
    }
    Ok(zip.finish().map_err(|e| e.to_string())?.into_inner())
}

/// Returns the arrays of an archive that have one of the names. They are checked against `limits` before memory is
/// allocated, because an archive may unpack to a thousand times its length.
pub fn read(bytes: &[u8], names: &[&str], limits: &Limits) -> Result<BTreeMap<String, Array>, Problem> {
    let mut zip = ZipArchive::new(Cursor::new(bytes)).map_err(|e| format!("not an .npz archive: {e}"))?;
    let mut arrays = BTreeMap::new();
    let mut left = limits.alloc.min((bytes.len() as u64).saturating_mul(MOST_UNPACKED).max(FREE));
    for &name in names {
        let Some(index) = zip.index_for_name(&format!("{name}.npy")) else { continue };
        let entry = zip.by_index(index).map_err(|e| format!("array {name}: {e}"))?;
        let array = npy::read(BufReader::new(entry), limits.gaussians, &mut left).map_err(|e| e.of(name))?;
        arrays.insert(name.to_owned(), array);
    }
    Ok(arrays)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_archive_that_unpacks_to_a_thousand_times_its_length_is_refused() {
        // 32 MiB of zeros, which would need eight times as much memory.
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
        zip.start_file("means.npy", options).unwrap();
        let shape = "{'descr': '|u1', 'fortran_order': False, 'shape': (16777216, 2), }";
        zip.write_all(b"\x93NUMPY\x01\x00\x76\x00").unwrap();
        zip.write_all(format!("{shape:<117}\n").as_bytes()).unwrap();
        zip.write_all(&vec![0; 32 << 20]).unwrap();
        let bytes = zip.finish().unwrap().into_inner();
        assert!(bytes.len() < 100_000, "{}", bytes.len());
        match read(&bytes, &["means"], &Limits::default()) {
            Err(Problem::TooMuch { requested, allowed, .. }) => assert_eq!((requested, allowed), (256 << 20, FREE)),
            other => panic!("{other:?}"),
        }
        assert!(read(&bytes, &["means"], &Limits::default()).is_err_and(|p| p.to_string().contains("array means")));
    }
}
