//! Texts from other programs: with or without a byte order mark, in UTF-8 or, as from some Windows programs, UTF-16.
//!
//! Line ends are left to [`str::lines`], which accepts both kinds. Invalid characters are replaced.

use std::io;
use std::path::{Path, PathBuf};

use mien_stages::base::bounded_read;

/// Largest file that is read whole, bytes.
pub const MAX_BYTES: usize = 1 << 30;

/// Decodes text, without a byte order mark.
pub fn decoded(bytes: &[u8]) -> String {
    let wide = |bytes: &[u8], unit: fn([u8; 2]) -> u16| {
        let units = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]]));
        char::decode_utf16(units)
            .map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER))
            .collect()
    };
    match bytes {
        [0xff, 0xfe, rest @ ..] => wide(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => wide(rest, u16::from_be_bytes),
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8_lossy(rest).into_owned(),
        _ => String::from_utf8_lossy(bytes).into_owned(),
    }
}

/// Last component of a path, for messages.
pub fn display_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or(path.as_os_str());
    name.to_string_lossy().into_owned()
}

/// Entries of a folder, sorted by name.
///
/// # Errors
/// If it cannot be read.
pub fn listed(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder)?.flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    Ok(paths)
}

/// Reads a text file.
///
/// # Errors
/// If it cannot be read or exceeds [`MAX_BYTES`].
pub fn read(path: &Path) -> io::Result<String> {
    Ok(decoded(&bounded_read::read(path, MAX_BYTES)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_encodings_give_one_text() {
        let text = "v 0 0 0\r\n# Kopf \u{e4} \u{1f642}\r\n";
        let mark = format!("\u{feff}{text}");
        let little: Vec<u8> = mark.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = mark.encode_utf16().flat_map(u16::to_be_bytes).collect();
        for bytes in [text.as_bytes(), mark.as_bytes(), &little, &big] {
            assert_eq!(decoded(bytes), text);
        }
        // Half a pair, and none at all.
        assert_eq!(
            decoded(&[0xff, 0xfe, b'a', 0, 0x3d, 0xd8, b'b']),
            "a\u{fffd}"
        );
        assert_eq!(decoded(b""), "");
    }
}
