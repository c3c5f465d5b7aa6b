//! Sentences with checksums in a fixed buffer.

use std::fmt::Write;

/// Bytes there is room for: twice the longest line with 60 units, its pose, and some.
pub(super) const LARGEST: usize = 1024;

/// Sentences waiting to be sent. A sentence that does not fit leaves no trace.
#[derive(Clone)]
pub(super) struct Line {
    bytes: [u8; LARGEST],
    length: usize,
}

impl Line {
    pub(super) const fn new() -> Self {
        Self {
            bytes: [0; LARGEST],
            length: 0,
        }
    }

    pub(super) fn clear(&mut self) {
        self.length = 0;
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }

    /// Appends `$`, what `write` writes, `*`, the checksum and the line's end; `false` if there is no room.
    pub(super) fn sentence(&mut self, write: impl FnOnce(&mut Self) -> std::fmt::Result) -> bool {
        let start = self.length;
        let written = self
            .write_str("$")
            .and_then(|()| write(self))
            .and_then(|()| {
                let checksum = self.bytes[start + 1..self.length]
                    .iter()
                    .fold(0, |sum, byte| sum ^ byte);
                write!(self, "*{checksum:02X}\r\n")
            });
        if written.is_err() {
            self.length = start;
        }
        written.is_ok()
    }
}

impl Write for Line {
    fn write_str(&mut self, text: &str) -> std::fmt::Result {
        let end = self.length + text.len();
        let room = self
            .bytes
            .get_mut(self.length..end)
            .ok_or(std::fmt::Error)?;
        room.copy_from_slice(text.as_bytes());
        self.length = end;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reference_sentence_has_its_checksum() {
        let mut line = Line::new();
        assert!(line.sentence(|line| line.write_str("AU,1,33,2,78,0,50,100")));
        assert_eq!(line.bytes(), b"$AU,1,33,2,78,0,50,100*30\r\n");
    }

    #[test]
    fn a_sentence_that_does_not_fit_leaves_no_trace() {
        let mut line = Line::new();
        assert!(line.sentence(|line| line.write_str("AUH")));
        let before = line.bytes().to_vec();
        for length in [LARGEST - before.len() - 5, LARGEST] {
            assert!(!line.sentence(|line| (0..length).try_for_each(|_| line.write_str("x"))));
            assert_eq!(line.bytes(), before);
        }
    }
}
