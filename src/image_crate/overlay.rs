//! A reader in which single bytes are replaced, so that a decoder passes over parts of a file.

use std::io::{self, BufRead, Read, Seek, SeekFrom};

/// Bytes to replace: offset in the file and new value, in ascending order of their offsets.
pub type Replacements = Vec<(u64, u8)>;

/// A reader that returns the bytes of another one, except for some that are replaced.
pub struct Overlay<R> {
    inner: R,
    position: u64,
    replacements: Replacements,
}

impl<R: BufRead + Seek> Overlay<R> {
    /// Returns a reader of `inner` from its start.
    ///
    /// # Errors
    /// Those of `inner`, which is rewound.
    pub fn new(mut inner: R, replacements: Replacements) -> io::Result<Overlay<R>> {
        debug_assert!(replacements.is_sorted_by_key(|&(offset, _)| offset));
        inner.rewind()?;
        Ok(Overlay { inner, position: 0, replacements })
    }
}

impl<R: BufRead> BufRead for Overlay<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        let bytes = self.inner.fill_buf()?;
        let next = self.replacements.partition_point(|&(offset, _)| offset < self.position);
        match self.replacements.get(next) {
            Some((offset, value)) if *offset == self.position && !bytes.is_empty() => Ok(std::slice::from_ref(value)),
            Some((offset, _)) => {
                let before = usize::try_from(offset - self.position).unwrap_or(usize::MAX);
                Ok(&bytes[..bytes.len().min(before)])
            }
            None => Ok(bytes),
        }
    }

    fn consume(&mut self, amount: usize) {
        self.inner.consume(amount);
        self.position += amount as u64;
    }
}

impl<R: BufRead> Read for Overlay<R> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let mut bytes = self.fill_buf()?;
        let count = bytes.read(buf)?;
        self.consume(count);
        Ok(count)
    }
}

impl<R: Seek> Seek for Overlay<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.position = self.inner.seek(to)?;
        Ok(self.position)
    }

    fn seek_relative(&mut self, offset: i64) -> io::Result<()> {
        self.inner.seek_relative(offset)?;
        self.position = self.position.wrapping_add_signed(offset);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::{BufReader, Cursor};

    use super::*;

    #[test]
    fn only_the_given_bytes_are_replaced() {
        let bytes: Vec<u8> = (0..=255).collect();
        let replacements = vec![(0, 90), (7, 91), (8, 92), (63, 93), (255, 94), (300, 95)];
        let mut expected = bytes.clone();
        for &(offset, value) in &replacements[..5] {
            expected[offset as usize] = value;
        }
        for capacity in [1, 8, 300] {
            let inner = BufReader::with_capacity(capacity, Cursor::new(&bytes));
            let mut overlay = Overlay::new(inner, replacements.clone()).unwrap();
            let mut read = Vec::new();
            overlay.read_to_end(&mut read).unwrap();
            assert_eq!(read, expected);
            overlay.seek(SeekFrom::Start(6)).unwrap();
            overlay.seek_relative(1).unwrap();
            let mut part = [0; 3];
            overlay.read_exact(&mut part).unwrap();
            assert_eq!(part, [91, 92, 9]);
        }
    }
}
