//! Checksums of files and serial frames, by the crate `crc`.

use crc::{CRC_16_MCRF4XX, CRC_32_ISO_HDLC, Crc, NoTable};

static FILES: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);
/// Without a table (0.5 kB), because frames are short.
static FRAMES: Crc<u16, NoTable> = Crc::<u16, NoTable>::new(&CRC_16_MCRF4XX);

/// CRC-32 as in zlib and PNG, for files.
///
/// ```
/// assert_eq!(mien_stages::base::checksum::crc32(b"123456789"), 0xCBF4_3926);
/// ```
pub fn crc32(bytes: &[u8]) -> u32 {
    FILES.checksum(bytes)
}

/// CRC-16/MCRF4XX, for serial frames; `_crc_ccitt_update` of avr-libc.
///
/// ```
/// assert_eq!(mien_stages::base::checksum::crc16(b"123456789"), 0x6F91);
/// ```
pub fn crc16(bytes: &[u8]) -> u16 {
    FRAMES.checksum(bytes)
}
