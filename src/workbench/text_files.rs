//! Texts from other programs: with a mark before them, in UTF-8 or, as some of Windows write, UTF-16.
//!
//! Ends of lines are left to [`str::lines`], which takes both kinds. What is no character is replaced.

use std::io;
use std::path::{Path, PathBuf};

use mien_stages::base::bounded_read;

/// Bytes of the largest file that is read whole.
pub const MOST: usize = 1 << 30;

/// The text of some bytes, without a byte order mark.
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

/// Last part of a path, to be read.
pub fn name_of(path: &Path) -> String {
    let name = path.file_name().unwrap_or(path.as_os_str());
    name.to_string_lossy().into_owned()
}

/// What is in a folder, in the order of the names.
///
/// # Errors
/// If it cannot be read.
pub fn listed(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder)?.flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    Ok(paths)
}

/// The text of a file.
///
/// # Errors
/// If it cannot be read, or is larger than any of its kind.
pub fn read(path: &Path) -> io::Result<String> {
    Ok(decoded(&bounded_read::read(path, MOST)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_text_whatever_way_it_is_written() {
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
