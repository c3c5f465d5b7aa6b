//! The reply to a WebSocket key (RFC 6455, 4.2.2): SHA-1 of the key and a fixed text, in base 64.
//! Not used for security: the protocol uses it to tell WebSocket servers from others.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use sha1_smol::Sha1;

const GUID: &[u8] = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11";
/// Bytes of a key: 16 in base 64.
pub(super) const KEY: usize = 24;

/// The answer to a key.
pub(super) fn answer(key: &[u8; KEY]) -> [u8; 28] {
    let mut hash = Sha1::from(key);
    hash.update(GUID);
    let mut text = [0; 28];
    let length = STANDARD.encode_slice(hash.digest().bytes(), &mut text);
    debug_assert_eq!(length, Ok(text.len()));
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_answer_is_that_of_the_standard() {
        let key = b"dGhlIHNhbXBsZSBub25jZQ==";
        assert_eq!(&answer(key), b"s3pPLMBiTxaQ9kYGzzhZRbK+xOo=");
    }
}
