//! Mutations of valid files, as by damage or attack, with correct checksums.

use super::seal;

/// Splitmix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }
}

/// Returns `count` mutations, the same each time.
pub fn mutations(files: &[Vec<u8>], count: usize) -> impl Iterator<Item = Vec<u8>> {
    let mut random = Random(0x5eed);
    (0..count).map(move |i| {
        let mut bytes = files[i % files.len()].clone();
        for _ in 0..1 + random.below(4) {
            let at = random.below(bytes.len() - 4);
            match random.below(8) {
                0 => bytes.insert(at, random.next() as u8),
                1 if bytes.len() > 8 => drop(bytes.remove(at)),
                2 => {
                    // A piece of another file.
                    let other = &files[random.below(files.len())];
                    let from = random.below(other.len());
                    let count = random.below(16).min(other.len() - from);
                    bytes.splice(at..at, other[from..from + count].iter().copied());
                }
                3 => bytes[at] ^= 1 << random.below(8),
                _ => bytes[at] = random.next() as u8,
            }
        }
        seal(&mut bytes);
        bytes
    })
}
