//! Arrays in NumPy's `.npy` format, as far as parameters need it: little-endian numbers in C order, and short strings.
//!
//! The layout is that of `numpy.lib.format`: a magic, a version, the length of a header, and the header as a Python
//! dictionary of three keys. Crates that support all of it contain a parser of Python literals.

use std::io::Read;

use super::problem::{Problem, shown};

/// Magic of a `.npy` file.
const MAGIC: &[u8] = b"\x93NUMPY";

/// Longest header that is read; usual ones take 118 bytes.
const MAX_HEADER: usize = 4096;

/// Longest string that is read.
const MAX_CHARS: u64 = 64;

/// Number of elements that are read at a time.
const CHUNK: usize = 1 << 14;

/// An array with its shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    pub shape: Vec<usize>,
    pub values: Values,
}

/// The elements of an array.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    Numbers(Vec<f64>),
    /// A string.
    Text(String),
}

/// Returns a file with `values` as 32-bit floats.
pub fn floats(shape: &[usize], values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    let mut out = header("<f4", shape);
    out.extend(values.into_iter().flat_map(f32::to_le_bytes));
    out
}

/// Returns a file with `values` as 32-bit integers.
pub fn integers(values: &[i32]) -> Vec<u8> {
    let mut out = header("<i4", &[values.len()]);
    out.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    out
}

/// Returns a file with a string, as `numpy.array(text)` is stored.
pub fn text(text: &str) -> Vec<u8> {
    let mut out = header(&format!("<U{}", text.chars().count()), &[]);
    out.extend(text.chars().flat_map(|c| u32::from(c).to_le_bytes()));
    out
}

fn header(descr: &str, shape: &[usize]) -> Vec<u8> {
    // A Python tuple with one element ends with a comma.
    let comma = if shape.len() == 1 { "," } else { "" };
    let shape: Vec<String> = shape.iter().map(usize::to_string).collect();
    let shape = shape.join(", ");
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}{comma}), }}");
    // The data starts at a multiple of 64 bytes.
    while !(MAGIC.len() + 4 + text.len() + 1).is_multiple_of(64) {
        text.push(' ');
    }
    text.push('\n');
    let mut out = MAGIC.to_vec();
    out.extend([1, 0]);
    out.extend((text.len() as u16).to_le_bytes());
    out.extend(text.as_bytes());
    out
}

/// Reads a `.npy` file of at most `rows` rows. Subtracts the memory of its elements from `left`, and fails if that is
/// not enough.
pub fn read(mut file: impl Read, rows: u64, left: &mut u64) -> Result<Array, Problem> {
    let mut start = [0; 8];
    fill(&mut file, &mut start)?;
    if !start.starts_with(MAGIC) {
        return Err("is not a .npy array".into());
    }
    let length = match start[6] {
        1 => {
            let mut length = [0; 2];
            fill(&mut file, &mut length)?;
            usize::from(u16::from_le_bytes(length))
        }
        2 | 3 => {
            let mut length = [0; 4];
            fill(&mut file, &mut length)?;
            u32::from_le_bytes(length) as usize
        }
        version => return Err(format!("has the unknown version {version} of .npy").into()),
    };
    Problem::limit("header of bytes", length as u64, MAX_HEADER as u64)?;
    let mut header = vec![0; length];
    fill(&mut file, &mut header)?;
    let header = std::str::from_utf8(&header).map_err(|e| format!("has a header that is not text: {e}"))?;
    let descr = field(header, "descr")?.trim_matches(['\'', '"']);
    if field(header, "fortran_order")? != "False" {
        return Err("is in Fortran order; convert it with numpy.ascontiguousarray".into());
    }
    let shape = shape(field(header, "shape")?)?;
    let count = shape.iter().try_fold(1u64, |n, &side| n.checked_mul(side as u64)).unwrap_or(u64::MAX);
    if let Some(chars) = descr.strip_prefix("<U") {
        let chars: u64 = chars.parse().map_err(|_| format!("has elements of type {}", shown(descr)))?;
        Problem::limit("texts", count, 1)?;
        Problem::limit("characters", chars, MAX_CHARS)?;
        let mut data = vec![0; 4 * chars as usize * count as usize];
        fill(&mut file, &mut data)?;
        end(&mut file)?;
        let code = |c: &[u8]| char::from_u32(u32::from_le_bytes([c[0], c[1], c[2], c[3]]));
        let text: Option<String> = data.chunks_exact(4).map(code).collect();
        let text = text.ok_or("has text that is not valid Unicode")?.trim_end_matches('\0').to_owned();
        return Ok(Array { shape, values: Values::Text(text) });
    }
    Problem::limit("rows", shape.first().map_or(1, |&side| side as u64), rows)?;
    let bytes = count.saturating_mul(size_of::<f64>() as u64);
    Problem::limit("bytes of memory", bytes, *left)?;
    *left -= bytes;
    let numbers = match descr {
        "<f4" => numbers(file, count, f32::from_le_bytes, f64::from),
        "<f8" => numbers(file, count, f64::from_le_bytes, |v| v),
        "<i4" => numbers(file, count, i32::from_le_bytes, f64::from),
        "<i8" => numbers(file, count, i64::from_le_bytes, |v| v as f64),
        "<u4" => numbers(file, count, u32::from_le_bytes, f64::from),
        "|u1" => numbers(file, count, u8::from_le_bytes, f64::from),
        _ => return Err(format!("has elements of type {}; f4, f8, i4, i8, u4 and u1 are read", shown(descr)).into()),
    };
    Ok(Array { shape, values: Values::Numbers(numbers?) })
}

/// Reads exactly `count` elements. Memory grows with the data, not with the count in the header.
fn numbers<const SIZE: usize, T>(
    mut file: impl Read,
    count: u64,
    read: impl Fn([u8; SIZE]) -> T,
    widen: impl Fn(T) -> f64,
) -> Result<Vec<f64>, Problem> {
    let mut numbers = Vec::new();
    let mut chunk = vec![0; SIZE * CHUNK];
    while (numbers.len() as u64) < count {
        let elements = (count - numbers.len() as u64).min(CHUNK as u64) as usize;
        let chunk = &mut chunk[..elements * SIZE];
        fill(&mut file, chunk).map_err(|e| format!("of {count} elements: {e}"))?;
        if numbers.capacity() - numbers.len() < elements {
            // Doubles the capacity, up to the expected count.
            let more = (numbers.len().max(elements) as u64).min(count - numbers.len() as u64);
            numbers.try_reserve_exact(more as usize).map_err(|e| format!("of {count} elements: {e}"))?;
        }
        numbers.extend(chunk.chunks_exact(SIZE).map(|c| widen(read(std::array::from_fn(|k| c[k])))));
    }
    end(&mut file)?;
    Ok(numbers)
}

fn fill(file: &mut impl Read, to: &mut [u8]) -> Result<(), Problem> {
    file.read_exact(to).map_err(|e| format!("ends too early: {e}").into())
}

/// Refuses data after the elements.
fn end(file: &mut impl Read) -> Result<(), Problem> {
    match file.read(&mut [0]) {
        Ok(0) => Ok(()),
        Ok(_) => Err("has data after its elements".into()),
        Err(e) => Err(format!("ends badly: {e}").into()),
    }
}

/// Returns the text of the value of a key of the header.
fn field<'a>(header: &'a str, key: &str) -> Result<&'a str, Problem> {
    let missing = || Problem::from(format!("has a header without '{key}'"));
    let at = header.find(&format!("'{key}':")).ok_or_else(missing)?;
    let value = header[at + key.len() + 3..].trim_start();
    let end = match value.strip_prefix('(') {
        // Including the brackets.
        Some(tuple) => tuple.find(')').map(|end| end + 2),
        None => value.find([',', '}']),
    };
    Ok(value[..end.ok_or_else(missing)?].trim())
}

fn shape(text: &str) -> Result<Vec<usize>, Problem> {
    let sides = text.trim_start_matches('(').trim_end_matches(')').split(',').map(str::trim);
    let side = |s: &str| s.parse().map_err(|_| format!("has the shape {}", shown(text)).into());
    sides.filter(|s| !s.is_empty()).map(side).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(bytes: &[u8]) -> Result<Array, Problem> {
        read(bytes, 1000, &mut 1000)
    }

    #[test]
    fn arrays_come_back_as_they_were() {
        for (shape, values) in [(vec![], vec![2.5f32]), (vec![3], vec![1.0, -2.0, 1e-30]), (vec![2, 2], vec![0.0; 4])] {
            let file = floats(&shape, values.iter().copied());
            assert_eq!((file.len() - 4 * values.len()) % 64, 0);
            let numbers = values.iter().map(|&v| f64::from(v)).collect();
            assert_eq!(parse(&file).unwrap(), Array { shape, values: Values::Numbers(numbers) });
        }
        let found = parse(&integers(&[-6, 1 << 20])).unwrap();
        assert_eq!(found, Array { shape: vec![2], values: Values::Numbers(vec![-6.0, 1_048_576.0]) });
        assert_eq!(parse(&text("sum")).unwrap().values, Values::Text("sum".into()));
    }

    /// As `numpy.save` of NumPy 2 wrote it.
    #[test]
    fn a_file_of_numpy_is_read() {
        let mut file = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (1, 2), }".to_vec();
        file.resize(127, b' ');
        file.push(b'\n');
        file.extend([0.5f64, -3.0].iter().flat_map(|v| v.to_le_bytes()));
        assert_eq!(parse(&file).unwrap(), Array { shape: vec![1, 2], values: Values::Numbers(vec![0.5, -3.0]) });
    }

    #[test]
    fn broken_arrays_are_refused_with_what_is_wrong() {
        let good = floats(&[2, 3], [0.0; 6]);
        let with = |from: &str, to: &str| {
            let text = String::from_utf8_lossy(&good[10..128]).replace(from, to);
            [&good[..10], &text.as_bytes()[..118], &good[128..]].concat()
        };
        for (file, problem) in [
            (b"PK\x03\x04 is an archive".to_vec(), "not a .npy"),
            (good[..good.len() - 1].to_vec(), "of 6 elements: ends too early"),
            (with("False", "True "), "Fortran"),
            (with("<f4", "<c8"), "<c8"),
            (with("(2, 3)", "(2,-3)"), "shape"),
            (with("'descr'", "'escrd'"), "descr"),
            (with("(2, 3), ", "(2, 9), "), "of 18 elements: ends too early"),
            (with("(2, 3), ", "(2, 2), "), "has data after"),
            (with("(2, 3), ", "(9999999999999, 9999999999999), "), "rows 9999999999999 is more than the 1000"),
            (with("(2, 3), ", "(9, 99999999999999999999), "), "shape"),
            (with("(2, 3), ", "(9, 99999999999, 9), "), "bytes of memory 64799999999352 is more than the 1000"),
            (with("(2, 3), ", "(9, 9999999999999999, 9999), "), "bytes of memory 18446744073709551615"),
            (with("<f4", "<U9"), "texts 6 is more"),
            (b"\x93NUMPY\x02\x00\xff\xff\xff\xff".to_vec(), "header of bytes 4294967295 is more"),
        ] {
            let error = parse(&file).unwrap_err().to_string();
            assert!(error.contains(problem), "{error} lacks {problem}");
        }
        // No truncated file is accepted.
        assert!((0..good.len()).all(|n| parse(&good[..n]).is_err()));
    }
}
