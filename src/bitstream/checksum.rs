//! CRC-32 of a file and of its parts (spec §2), by a library, or in WebAssembly by code that needs no table of 16 KiB.

#[cfg(not(target_family = "wasm"))]
pub(crate) use crc32fast::{Hasher, hash};
#[cfg(target_family = "wasm")]
pub(crate) use small::{Hasher, hash};

#[cfg(any(test, target_family = "wasm"))]
mod small {
    /// CRC remainders of the sixteen 4-bit values.
    const STEPS: [u32; 16] = {
        let mut steps = [0; 16];
        let mut i = 0;
        while i < 16 {
            let (mut crc, mut bit) = (i as u32, 0);
            while bit < 4 {
                crc = crc >> 1 ^ 0xEDB8_8320 * (crc & 1);
                bit += 1;
            }
            steps[i] = crc;
            i += 1;
        }
        steps
    };

    /// An incremental checksum.
    #[derive(Debug, Clone)]
    pub(crate) struct Hasher(u32);

    impl Hasher {
        pub fn new() -> Self {
            Hasher(!0)
        }

        pub fn update(&mut self, bytes: &[u8]) {
            for byte in bytes {
                let crc = self.0 ^ u32::from(*byte);
                let crc = crc >> 4 ^ STEPS[(crc & 15) as usize];
                self.0 = crc >> 4 ^ STEPS[(crc & 15) as usize];
            }
        }

        pub fn finalize(self) -> u32 {
            !self.0
        }
    }

    /// Returns the checksum of `bytes`.
    pub(crate) fn hash(bytes: &[u8]) -> u32 {
        let mut hasher = Hasher::new();
        hasher.update(bytes);
        hasher.finalize()
    }
}

#[cfg(test)]
mod tests {
    use super::{hash, small};

    #[test]
    fn both_checksum_implementations_agree() {
        let bytes: Vec<u8> = (0..1000u32).map(|i| (i * i >> 3) as u8).collect();
        for end in [0, 1, 2, 15, 16, 17, 255, 1000] {
            assert_eq!(small::hash(&bytes[..end]), hash(&bytes[..end]));
        }
    }
}
