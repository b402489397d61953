//! Bit fields packed into bytes, least significant bit first (spec §6.2).

/// Packs fields into bytes.
#[derive(Debug, Default)]
pub(crate) struct BitWriter {
    pending: u64,
    count: u32,
}

impl BitWriter {
    /// Appends the low `width ≤ 32` bits of `value`.
    pub(crate) fn put(&mut self, value: u32, width: u32, out: &mut Vec<u8>) {
        debug_assert!(width <= 32 && u64::from(value) >> width == 0);
        self.pending |= u64::from(value) << self.count;
        self.count += width;
        while self.count >= 8 {
            out.push(self.pending as u8);
            self.pending >>= 8;
            self.count -= 8;
        }
    }

    /// Fills the last byte with zeros.
    pub(crate) fn align(&mut self, out: &mut Vec<u8>) {
        if self.count > 0 {
            out.push(self.pending as u8);
        }
        *self = BitWriter::default();
    }
}

/// Unpacks fields from bytes.
#[derive(Debug)]
pub(crate) struct BitReader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> BitReader<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        BitReader { bytes, at: 0 }
    }

    /// Returns the next `width ≤ 32` bits. Bits past the end are 0, so callers check the length first.
    pub(crate) fn get(&mut self, width: u32) -> u32 {
        let (byte, shift) = (self.at / 8, self.at % 8);
        let window = (0..5).fold(0u64, |w, i| w | u64::from(self.bytes.get(byte + i).copied().unwrap_or(0)) << (8 * i));
        self.at += width as usize;
        ((window >> shift) & ((1u64 << width) - 1)) as u32
    }
}

/// Returns the number of bits of a field with values `0..=max`.
pub(crate) fn width_of(max: u32) -> u32 {
    32 - max.leading_zeros()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_round_trip() {
        let fields = [(5, 3), (0, 0), (1023, 11), (u32::MAX, 32), (1, 1), (0x1234_5678, 31)];
        let (mut writer, mut bytes) = (BitWriter::default(), Vec::new());
        for (value, width) in fields {
            writer.put(value, width, &mut bytes);
        }
        writer.align(&mut bytes);
        assert_eq!(bytes.len(), (3usize + 11 + 32 + 1 + 31).div_ceil(8));
        let mut reader = BitReader::new(&bytes);
        for (value, width) in fields {
            assert_eq!(reader.get(width), value);
        }
        assert_eq!(reader.get(32) >> 6, 0);
    }
}
