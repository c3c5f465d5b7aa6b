//! DNS messages as mDNS uses them (RFC 1035, 4.1; RFC 6762, 18): written whole and uncompressed, read with compressed names.

use std::ops::Range;

/// Longest datagram, bytes.
pub(super) const LARGEST: usize = 1472;

pub(super) const A: u16 = 1;
pub(super) const PTR: u16 = 12;
pub(super) const TXT: u16 = 16;
pub(super) const SRV: u16 = 33;
pub(super) const ANY: u16 = 255;
/// Class IN; with the top bit, cache flush (answers) or unicast reply wanted (questions).
pub(super) const IN: u16 = 1;
pub(super) const UNIQUE: u16 = 0x8000;
/// Flags of a reply: it is one, and authoritative.
pub(super) const REPLY: u16 = 0x8400;

/// A section of a message, by the place of its count in the header.
#[derive(Clone, Copy)]
pub(super) enum Section {
    Questions = 4,
    Answers = 6,
    Authority = 8,
    Additional = 10,
}

/// A message being written.
pub(super) struct Writer {
    bytes: heapless::Vec<u8, LARGEST>,
    /// Class of records that only we have.
    pub(super) unique: u16,
    /// Longest time to live, seconds; 0 withdraws.
    pub(super) keep: u32,
}

impl Writer {
    /// The counts of the header are filled in as sections grow.
    pub(super) fn new(id: u16, flags: u16) -> Self {
        let mut writer = Self {
            bytes: heapless::Vec::new(),
            unique: IN | UNIQUE,
            keep: u32::MAX,
        };
        writer.words(&[id, flags, 0, 0, 0, 0]);
        writer
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    pub(super) fn count(&self, section: Section) -> u16 {
        word(&self.bytes, section as usize).unwrap_or(0)
    }

    /// Appends; what does not fit a datagram is cut off.
    pub(super) fn put(&mut self, part: &[u8]) {
        let room = self.bytes.capacity() - self.bytes.len();
        let _ = self.bytes.extend_from_slice(&part[..part.len().min(room)]);
    }

    pub(super) fn words(&mut self, words: &[u16]) {
        words.iter().for_each(|word| self.put(&word.to_be_bytes()));
    }

    pub(super) fn name(&mut self, labels: &[&str]) {
        for label in labels {
            self.text(label);
        }
        self.put(&[0]);
    }

    /// A text behind its length.
    pub(super) fn text(&mut self, text: &str) {
        self.put(&[text.len() as u8]);
        self.put(text.as_bytes());
    }

    /// Adds one to the count of a section.
    fn counted(&mut self, section: Section) {
        let count = self.count(section) + 1;
        self.bytes[section as usize..][..2].copy_from_slice(&count.to_be_bytes());
    }

    /// A question as it stands in another message.
    pub(super) fn repeat(&mut self, question: &[u8]) {
        self.put(question);
        self.counted(Section::Questions);
    }

    pub(super) fn question(&mut self, name: &[&str], kind: u16, class: u16) {
        self.name(name);
        self.words(&[kind, class]);
        self.counted(Section::Questions);
    }

    /// A record whose data `data` writes. What does not fit is left out; the asker asks again for it.
    pub(super) fn record(
        &mut self,
        section: Section,
        name: &[&str],
        kind: u16,
        keep: u32,
        data: impl FnOnce(&mut Self),
    ) {
        let start = self.bytes.len();
        self.name(name);
        self.words(&[kind, if kind == PTR { IN } else { self.unique }]);
        self.put(&keep.min(self.keep).to_be_bytes());
        let at = self.bytes.len();
        self.words(&[0]);
        data(self);
        if self.bytes.is_full() {
            self.bytes.truncate(start);
            return;
        }
        let length = (self.bytes.len() - at - 2) as u16;
        self.bytes[at..at + 2].copy_from_slice(&length.to_be_bytes());
        self.counted(section);
    }
}

/// A message that came: where its parts stand in its bytes.
pub(super) struct Message<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) questions: heapless::Vec<Question, 32>,
    pub(super) records: heapless::Vec<Record, 64>,
    /// How many of the records are answers.
    pub(super) answers: usize,
}

pub(super) struct Question {
    /// Name, kind and class.
    pub(super) whole: Range<usize>,
    pub(super) kind: u16,
}

pub(super) struct Record {
    /// Where its name begins.
    pub(super) name: usize,
    pub(super) kind: u16,
    /// Time to live, seconds.
    pub(super) keep: u32,
    /// Where its data begins.
    pub(super) data: usize,
}

impl<'a> Message<'a> {
    /// `None` if it is malformed. Of very many questions or records the last are not looked at.
    pub(super) fn read(bytes: &'a [u8]) -> Option<Self> {
        let counted = |section: Section| word(bytes, section as usize);
        let mut message = Self {
            bytes,
            questions: heapless::Vec::new(),
            records: heapless::Vec::new(),
            answers: counted(Section::Answers)?.into(),
        };
        let mut at = 12;
        for _ in 0..counted(Section::Questions)? {
            let end = message.is_name(at, &[])?.1 + 4;
            let (kind, whole) = (word(bytes, end - 4)?, at..end);
            bytes.get(whole.clone())?;
            let _ = message.questions.push(Question { whole, kind });
            at = end;
        }
        let rest = [Section::Answers, Section::Authority, Section::Additional];
        let rest: u32 = rest
            .iter()
            .map(|&of| counted(of).map(u32::from))
            .sum::<Option<u32>>()?;
        for _ in 0..rest {
            let (name, after) = (at, message.is_name(at, &[])?.1);
            let keep = [after + 4, after + 6].map(|at| word(bytes, at).map(u32::from));
            let data = after + 10;
            at = data + usize::from(word(bytes, after + 8)?);
            bytes.get(data..at)?;
            let _ = message.records.push(Record {
                name,
                kind: word(bytes, after)?,
                keep: keep[0]? << 16 | keep[1]?,
                data,
            });
        }
        Some(message)
    }

    /// A big-endian number.
    pub(super) fn word(&self, at: usize) -> Option<u16> {
        word(self.bytes, at)
    }

    pub(super) fn is(&self, at: usize, name: &[&str]) -> bool {
        self.is_name(at, name).is_some_and(|(same, _)| same)
    }

    /// Whether the name at `at` is `name`, ignoring case, and the offset after it; `None` if it is not a name.
    fn is_name(&self, mut at: usize, name: &[&str]) -> Option<(bool, usize)> {
        let (mut after, mut same, mut left) = (None, true, name.iter());
        // More labels than a name has room for are a circle.
        for _ in 0..128 {
            let length = usize::from(*self.bytes.get(at)?);
            match length >> 6 {
                0 if length == 0 => {
                    return Some((same && left.next().is_none(), after.unwrap_or(at + 1)));
                }
                0 => {
                    let label = self.bytes.get(at + 1..at + 1 + length)?;
                    let expected = left.next();
                    same &= expected.is_some_and(|own| own.as_bytes().eq_ignore_ascii_case(label));
                    at += 1 + length;
                }
                // Only back, so that it ends.
                3 => {
                    let to = usize::from(self.word(at)? & 0x3fff);
                    after.get_or_insert(at + 2);
                    at = Some(to).filter(|&to| to < at)?;
                }
                _ => return None,
            }
        }
        None
    }
}

fn word(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes(*bytes.get(at..)?.first_chunk()?))
}
