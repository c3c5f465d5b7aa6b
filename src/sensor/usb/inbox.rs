//! Where landed transfers wait to be polled: a bounded ring in which the newest wins.

use crate::capacity::{LANDED_TRANSFERS as INBOX, PACKETS};
use crate::sensor::device::Stream;
use crate::sensor::packet::LONGEST;

/// One landed transfer, copied.
pub(super) struct Landed {
    pub(super) stream: Stream,
    /// Length of each packet; `None` if the bus reported an error.
    pub(super) lengths: [Option<u16>; PACKETS],
    pub(super) bytes: Box<[u8]>,
}

/// What the callback writes and [`UsbKinect`] reads.
pub(super) struct Inbox {
    pub(super) ring: Vec<Landed>,
    pub(super) oldest: usize,
    pub(super) filled: usize,
    /// Transfers that libusb holds, by stream.
    pub(super) flying: [usize; 2],
    pub(super) stopping: [bool; 2],
    pub(super) gone: bool,
    pub(super) overruns: u64,
}

impl Inbox {
    pub(super) fn new() -> Self {
        let landed = || Landed {
            stream: Stream::Depth,
            lengths: [None; PACKETS],
            bytes: vec![0; PACKETS * LONGEST].into_boxed_slice(),
        };
        Self {
            ring: core::iter::repeat_with(landed).take(INBOX).collect(),
            oldest: 0,
            filled: 0,
            flying: [0; 2],
            stopping: [false; 2],
            gone: false,
            overruns: 0,
        }
    }

    /// Where the next transfer goes; overwrites the oldest when full.
    pub(super) fn next(&mut self) -> &mut Landed {
        if self.filled == 0 {
            // Memory that has never been needed is not touched.
            self.oldest = 0;
        }
        let slot = (self.oldest + self.filled) % INBOX;
        if self.filled == INBOX {
            self.oldest = (self.oldest + 1) % INBOX;
            self.overruns += 1;
        } else {
            self.filled += 1;
        }
        &mut self.ring[slot]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inbox_keeps_the_newest() {
        let mut inbox = Inbox::new();
        for number in 0..INBOX + 5 {
            inbox.next().lengths[0] = Some(number as u16);
        }
        assert_eq!((inbox.filled, inbox.overruns), (INBOX, 5));
        assert_eq!(inbox.ring[inbox.oldest].lengths[0], Some(5));
        inbox.oldest = (inbox.oldest + 1) % INBOX;
        inbox.filled -= 1;
        inbox.next().lengths[0] = Some(7777);
        assert_eq!((inbox.filled, inbox.overruns), (INBOX, 5));
        let newest = (inbox.oldest + INBOX - 1) % INBOX;
        assert_eq!(inbox.ring[newest].lengths[0], Some(7777));
    }
}
