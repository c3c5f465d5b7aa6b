//! The box's name on the network, and a unique number that stays the same across restarts.

use sha1_smol::Sha1;

/// Longest name, bytes: the limit of a DNS label.
const LONGEST: usize = 63;

/// The box's name: `name`, or the host's if empty; characters other than letters, digits and `-` are replaced by `-`.
pub(super) fn name(name: &str) -> String {
    let host = name.is_empty().then(host);
    let name = host.as_deref().unwrap_or(name);
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
    let name: String = name.chars().map(plain).take(LONGEST).collect();
    let name = name.trim_matches('-');
    if name.is_empty() { "mien" } else { name }.to_owned()
}

/// The first label of the host's name.
fn host() -> String {
    let host = nix::unistd::gethostname().ok();
    let host = host.and_then(|host| host.into_string().ok());
    let host = host.unwrap_or_default();
    host.split('.').next().unwrap_or_default().to_owned()
}

/// The box's 128-bit number, a UUID of version 5 (RFC 9562), from its name and the machine ID, if there is one.
pub(super) fn uuid(name: &str) -> [u8; 16] {
    let machine = std::fs::read("/etc/machine-id").unwrap_or_default();
    let mut hash = Sha1::from(machine);
    hash.update(name.as_bytes());
    hash.update(b"live-link");
    let mut uuid = [0; 16];
    uuid.copy_from_slice(&hash.digest().bytes()[..16]);
    uuid[6] = uuid[6] & 0x0f | 0x50;
    uuid[8] = uuid[8] & 0x3f | 0x80;
    uuid
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_labels() {
        assert_eq!(name("hall 3.left"), "hall-3-left");
        assert_eq!(name("--"), "mien");
        assert_eq!(name(&"x".repeat(99)).len(), LONGEST);
        assert!(!name("").is_empty());
    }

    #[test]
    fn a_box_keeps_its_number_and_shares_it_with_none() {
        assert_eq!(uuid("a"), uuid("a"));
        assert_ne!(uuid("a"), uuid("b"));
        let one = uuid("a");
        assert_eq!((one[6] >> 4, one[8] >> 6), (5, 2));
    }
}
