//! Codes symbols by their frequency with the range coder of ssplat, instead of the one in
//! `compress_matrix_flatten_categorical` of GaussianImage's program, and with the table that its `analysis` counts.

use ssplat::unstable::bitstream::coder::range::{Coder, Cumulative, Encoder};

/// Bytes of the table for each symbol that occurs: 64 bits for the frequency, and the symbol itself.
const ENTRY_BYTES: u64 = 9;
/// Maximum sum of the frequencies.
const MAX_SUM: u64 = 1 << 16;

/// Cumulative frequencies of the symbols.
#[derive(Debug)]
struct Shares {
    /// The sum below each symbol, and the total.
    below: Vec<u32>,
}

impl Shares {
    fn new(codes: &[u8]) -> Self {
        let mut times = [0u64; 256];
        codes.iter().for_each(|&c| times[usize::from(c)] += 1);
        let all = codes.len() as u64;
        let mut below = vec![0];
        for times in times {
            // Large frequencies are scaled; symbols that occur keep a frequency of at least 1.
            let share = if all > MAX_SUM / 2 { (times * (MAX_SUM / 2) / all).max(times.min(1)) } else { times };
            below.push(below.last().copied().unwrap_or(0) + share as u32);
        }
        Shares { below }
    }
}

impl Cumulative for Shares {
    fn below(&self, value: i32) -> u32 {
        self.below[value as usize]
    }

    fn total(&self) -> u32 {
        self.below[256]
    }

    fn find(&self, target: u32) -> (i32, [u32; 2]) {
        let value = self.below.partition_point(|&b| b <= target) - 1;
        (value as i32, [self.below[value], self.below[value + 1]])
    }
}

/// Returns the coded string.
fn coded(codes: &[u8], shares: &Shares) -> Vec<u8> {
    let mut encoder = Encoder::default();
    for &code in codes {
        encoder.choose(shares, code.into());
    }
    encoder.finish()
}

/// Returns the size of `codes` in bytes, including their table.
pub(super) fn bytes(codes: &[u8]) -> u64 {
    let shares = Shares::new(codes);
    let present = shares.below.windows(2).filter(|b| b[0] < b[1]).count() as u64;
    coded(codes, &shares).len() as u64 + ENTRY_BYTES * present
}

#[cfg(test)]
mod tests {
    use super::*;
    use ssplat::unstable::bitstream::coder::range::Decoder;

    #[test]
    fn codes_come_back_and_take_their_entropy_and_the_table() {
        for count in [1usize, 900, 200_000] {
            // Half of them are 7, an eighth is each of four others.
            let codes: Vec<u8> = (0..count).map(|i| if i % 2 == 0 { 7 } else { [0, 63, 20, 255][i / 2 % 4] }).collect();
            let shares = Shares::new(&codes);
            let string = coded(&codes, &shares);
            let mut decoder = Decoder::new(&string).unwrap();
            let decoded: Vec<u8> = codes.iter().map(|_| decoder.choose(&shares, 0) as u8).collect();
            decoder.finish().unwrap();
            assert!(decoded == codes, "{count}");
            let entropy = count as f64 * if count == 1 { 0.0 } else { 2.0 / 8.0 };
            assert!((string.len() as f64 - entropy).abs() < 4.0 + 1e-3 * entropy, "{count}: {}", string.len());
            assert_eq!(bytes(&codes), string.len() as u64 + 9 * if count == 1 { 1 } else { 5 });
        }
    }
}
