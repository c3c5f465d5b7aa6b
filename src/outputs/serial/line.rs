//! A fixed buffer of bytes to send: lines with checksums, or binary frames.

use core::fmt::Write;

/// Capacity, bytes: twice the need of 60 units in the longest style.
pub(super) const LARGEST: usize = 2048;

/// Checksum of a sentence: the XOR of the bytes between `$` and `*`.
pub(super) fn checksum(body: &[u8]) -> u8 {
    body.iter().fold(0, |sum, byte| sum ^ byte)
}

/// Bytes waiting to be sent.
#[derive(Clone, Default)]
pub struct Line(heapless::Vec<u8, LARGEST>);

impl Line {
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// The bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    /// Appends bytes.
    ///
    /// # Errors
    /// If there is no room for all of them.
    pub(super) fn put(&mut self, bytes: &[u8]) -> core::fmt::Result {
        let put = self.0.extend_from_slice(bytes);
        put.map_err(|_| core::fmt::Error)
    }

    /// Appends the output of `write`, or nothing if it fails; returns whether it succeeded.
    pub(super) fn all_or_nothing(
        &mut self,
        write: impl FnOnce(&mut Self) -> core::fmt::Result,
    ) -> bool {
        let start = self.0.len();
        let written = write(self).is_ok();
        if !written {
            self.0.truncate(start);
        }
        written
    }

    /// Appends `$`, the output of `write`, `*`, the checksum and CR LF; appends nothing and returns `false` if there is no room.
    pub(super) fn sentence(&mut self, write: impl FnOnce(&mut Self) -> core::fmt::Result) -> bool {
        let start = self.0.len();
        self.all_or_nothing(|line| {
            line.put(b"$")?;
            write(line)?;
            let checksum = checksum(&line.0[start + 1..]);
            write!(line, "*{checksum:02X}\r\n")
        })
    }
}

impl Write for Line {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        self.put(text.as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reference_sentence_has_its_checksum() {
        let mut line = Line::default();
        assert!(line.sentence(|line| line.write_str("AU,1,33,2,78,0,50,100")));
        assert_eq!(line.bytes(), b"$AU,1,33,2,78,0,50,100*30\r\n");
    }

    #[test]
    fn a_sentence_that_does_not_fit_leaves_no_trace() {
        let mut line = Line::default();
        assert!(line.sentence(|line| line.write_str("AUH")));
        let before = line.bytes().to_vec();
        for length in [LARGEST - before.len() - 5, LARGEST] {
            assert!(!line.sentence(|line| (0..length).try_for_each(|_| line.write_str("x"))));
            assert_eq!(line.bytes(), before);
        }
    }
}
