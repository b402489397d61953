//! A bounds-checked cursor over bytes, and the variable-length integers (spec §2.1).

use byteorder::{ByteOrder, LittleEndian};

use crate::error::{FormatError, Result};

/// Reads forward through `data`. Offsets in errors count from the start of the file.
#[derive(Debug, Clone)]
pub(crate) struct Bytes<'a> {
    data: &'a [u8],
    at: usize,
    /// Position of `data` in the file.
    base: u64,
}

impl<'a> Bytes<'a> {
    pub(crate) fn new(data: &'a [u8], base: u64) -> Self {
        Bytes { data, at: 0, base }
    }

    /// Returns the position of the next byte in the file.
    pub(crate) fn offset(&self) -> u64 {
        self.base + self.at as u64
    }

    pub(crate) fn left(&self) -> usize {
        self.data.len() - self.at
    }

    /// Returns the bytes that have been read.
    pub(crate) fn taken(&self) -> &'a [u8] {
        &self.data[..self.at]
    }

    pub(crate) fn take(&mut self, count: u64, what: &'static str) -> Result<&'a [u8]> {
        if count > self.left() as u64 {
            return Err(FormatError::Truncated { what, offset: self.base + self.data.len() as u64 }.into());
        }
        let start = self.at;
        self.at += count as usize;
        Ok(&self.data[start..self.at])
    }

    pub(crate) fn array<const K: usize>(&mut self, what: &'static str) -> Result<[u8; K]> {
        let bytes = self.take(K as u64, what)?;
        Ok(std::array::from_fn(|i| bytes[i]))
    }

    pub(crate) fn u16(&mut self, what: &'static str) -> Result<u16> {
        self.take(2, what).map(LittleEndian::read_u16)
    }

    pub(crate) fn u32(&mut self, what: &'static str) -> Result<u32> {
        self.take(4, what).map(LittleEndian::read_u32)
    }

    pub(crate) fn f32(&mut self, what: &'static str) -> Result<f32> {
        self.take(4, what).map(LittleEndian::read_f32)
    }

    pub(crate) fn f64(&mut self, what: &'static str) -> Result<f64> {
        self.take(8, what).map(LittleEndian::read_f64)
    }

    pub(crate) fn varint(&mut self, what: &'static str) -> Result<u64> {
        varint(what, || Ok(self.array::<1>(what)?[0]))
    }

    /// Returns a cursor over the next `count` bytes.
    pub(crate) fn part(&mut self, count: u64, what: &'static str) -> Result<Bytes<'a>> {
        let base = self.offset();
        Ok(Bytes::new(self.take(count, what)?, base))
    }

    /// Returns all remaining bytes.
    pub(crate) fn rest(&mut self) -> &'a [u8] {
        let start = self.at;
        self.at = self.data.len();
        &self.data[start..]
    }

    /// Fails unless all bytes have been read.
    pub(crate) fn finish(&self) -> Result<()> {
        match self.left() {
            0 => Ok(()),
            count => Err(FormatError::TrailingBytes { count: count as u64 }.into()),
        }
    }
}

/// Decodes a canonical LEB128 integer below 2⁶³ from the bytes that `next` returns.
///
/// # Errors
/// [`FormatError::BadValue`] if the encoding is longer than necessary or the value has more than 63 bits, and errors
/// of `next`.
pub(crate) fn varint(field: &'static str, mut next: impl FnMut() -> Result<u8>) -> Result<u64> {
    let mut value = 0u64;
    for shift in (0..63).step_by(7) {
        let byte = next()?;
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            if byte == 0 && shift > 0 {
                break;
            }
            return Ok(value);
        }
    }
    Err(FormatError::BadValue { field, value }.into())
}

/// Appends `value`, which must be below 2⁶³, as LEB128.
pub(crate) fn put_varint(mut value: u64, out: &mut Vec<u8>) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Maps signed integers of small magnitude to small unsigned ones: `−1 → 1, 1 → 2, …`.
pub(crate) fn zigzag(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)) as u64
}

/// Inverse of [`zigzag`].
pub(crate) fn unzigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn varints_round_trip_and_are_canonical() {
        for value in (0..63).flat_map(|b| [(1u64 << b) - 1, 1 << b]).chain([u64::MAX >> 1]) {
            let mut bytes = Vec::new();
            put_varint(value, &mut bytes);
            let mut cursor = Bytes::new(&bytes, 0);
            assert_eq!(cursor.varint("value").unwrap(), value);
            cursor.finish().unwrap();
            *bytes.last_mut().unwrap() |= 0x80;
            bytes.push(0);
            assert!(Bytes::new(&bytes, 0).varint("value").is_err(), "{value} in a long form was accepted");
        }
    }

    #[test]
    fn zigzag_round_trips() {
        for value in [0, -1, 1, -2, 32767, -32768, i64::MAX >> 1, i64::MIN >> 1] {
            assert_eq!(unzigzag(zigzag(value)), value);
        }
    }
}
