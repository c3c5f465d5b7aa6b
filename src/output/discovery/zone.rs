//! The box's names and records, what is answered with them, and whether somebody else uses a name.

use std::net::Ipv4Addr;

use super::message::{A, ANY, IN, Message, PTR, REPLY, SRV, Section, TXT, UNIQUE, Writer};

/// Time to live of records, seconds: of names, and of records that may change (RFC 6762, 10).
const KEEP: u32 = 4500;
const KEEP_ADDRESS: u32 = 120;
/// Name under which all kinds of services are listed (RFC 6763, 9).
const KINDS: [&str; 4] = ["_services", "_dns-sd", "_udp", "local"];

/// A service to announce.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Service {
    /// `_osc`, without the dot.
    pub kind: &'static str,
    /// `_udp` or `_tcp`.
    pub transport: &'static str,
    /// Where it is served.
    pub port: u16,
    /// A `key=value`, or empty.
    pub text: &'static str,
}

/// A record of a service.
#[derive(Clone, Copy)]
enum Of {
    /// That there is such a kind of service.
    Kind,
    /// That there is this one.
    Pointer,
    Place,
    Text,
}

/// The box's names and services.
pub(super) struct Zone {
    /// The name wanted; a number is appended if others have the same.
    wanted: String,
    pub(super) instance: String,
    pub(super) host: String,
    services: Box<[Service]>,
}

impl Zone {
    pub(super) fn new(name: &str, services: Vec<Service>) -> Self {
        let mut zone = Self {
            wanted: name.chars().take(48).collect(),
            instance: String::new(),
            host: String::new(),
            services: services.into(),
        };
        zone.call(1);
        zone
    }

    /// Takes the name of this number; 1 is the configured one.
    pub(super) fn call(&mut self, number: u32) {
        let wanted = &self.wanted;
        let name = match number {
            1 => wanted.clone(),
            _ => format!("{wanted}-{number}"),
        };
        (self.instance, self.host) = (format!("mien {name}"), format!("mien-{name}"));
    }

    fn kind(service: &Service) -> [&'static str; 3] {
        [service.kind, service.transport, "local"]
    }

    fn full<'a>(&'a self, service: &Service) -> [&'a str; 4] {
        [&self.instance, service.kind, service.transport, "local"]
    }

    fn host(&self) -> [&str; 2] {
        [&self.host, "local"]
    }

    fn put(&self, out: &mut Writer, section: Section, service: &Service, what: Of) {
        let (kind, full) = (Self::kind(service), self.full(service));
        match what {
            Of::Kind => out.record(section, &KINDS, PTR, KEEP, |out| out.name(&kind)),
            Of::Pointer => out.record(section, &kind, PTR, KEEP, |out| out.name(&full)),
            Of::Place => out.record(section, &full, SRV, KEEP_ADDRESS, |out| {
                out.words(&[0, 0, service.port]);
                out.name(&self.host());
            }),
            Of::Text => out.record(section, &full, TXT, KEEP, |out| out.text(service.text)),
        }
    }

    fn put_address(&self, out: &mut Writer, section: Section, address: Ipv4Addr) {
        out.record(section, &self.host(), A, KEEP_ADDRESS, |out| {
            out.put(&address.octets());
        });
    }

    /// All records.
    pub(super) fn announce(&self, address: Ipv4Addr, out: &mut Writer) {
        for service in &self.services {
            for what in [Of::Pointer, Of::Place, Of::Text] {
                self.put(out, Section::Answers, service, what);
            }
        }
        self.put_address(out, Section::Answers, address);
    }

    /// Probe: asks whether anybody has our names, with the records we propose.
    pub(super) fn probe(&self, address: Ipv4Addr, out: &mut Writer) {
        out.unique = IN;
        for service in &self.services {
            out.question(&self.full(service), ANY, IN | UNIQUE);
        }
        out.question(&self.host(), ANY, IN | UNIQUE);
        for service in &self.services {
            self.put(out, Section::Authority, service, Of::Place);
        }
        self.put_address(out, Section::Authority, address);
    }

    /// Whether an answer shows that somebody else has one of our names, at another address or port.
    pub(super) fn is_taken(&self, heard: &Message, own: impl Fn(Ipv4Addr) -> bool) -> bool {
        heard.records.iter().any(|record| match record.kind {
            A if heard.is(record.name, &self.host()) => {
                let address = heard.bytes[record.data..].first_chunk::<4>();
                address.is_some_and(|&octets| !own(octets.into()))
            }
            SRV => self.services.iter().any(|service| {
                let same = heard.word(record.data + 4) == Some(service.port)
                    && heard.is(record.data + 6, &self.host());
                heard.is(record.name, &self.full(service)) && !same
            }),
            _ => false,
        })
    }

    /// Answers a query. `address` is ours on the querier's network; `legacy` queriers are not mDNS responders and need their
    /// question repeated.
    pub(super) fn answer(&self, query: &Message, address: Ipv4Addr, legacy: bool) -> Writer {
        let mut out = Writer::new(query.word(0).filter(|_| legacy).unwrap_or(0), REPLY);
        if legacy {
            (out.unique, out.keep) = (IN, 10);
            // Who asks so asks one thing.
            if let Some(question) = query.questions.first() {
                out.repeat(&query.bytes[question.whole.clone()]);
            }
        }
        // What else will be asked for, told at once: places and texts, and the address.
        let mut more = heapless::Vec::<(Service, Of), 16>::new();
        let mut wants_address = false;
        for question in &query.questions {
            let asks = |kind: u16, name: &[&str]| {
                [kind, ANY].contains(&question.kind) && query.is(question.whole.start, name)
            };
            for service in &self.services {
                let full = self.full(service);
                if asks(PTR, &KINDS) {
                    self.put(&mut out, Section::Answers, service, Of::Kind);
                }
                if asks(PTR, &Self::kind(service)) && !self.is_known(query, service) {
                    self.put(&mut out, Section::Answers, service, Of::Pointer);
                    let _ = more.extend_from_slice(&[(*service, Of::Place), (*service, Of::Text)]);
                    wants_address = true;
                }
                if asks(SRV, &full) {
                    self.put(&mut out, Section::Answers, service, Of::Place);
                    wants_address = true;
                }
                if asks(TXT, &full) {
                    self.put(&mut out, Section::Answers, service, Of::Text);
                }
            }
            if asks(A, &self.host()) {
                self.put_address(&mut out, Section::Answers, address);
            }
        }
        for (service, what) in &more {
            self.put(&mut out, Section::Additional, service, *what);
        }
        if wants_address {
            self.put_address(&mut out, Section::Additional, address);
        }
        out
    }

    /// Whether the query lists our pointer as a known answer, with at least half of its time to live.
    fn is_known(&self, query: &Message, service: &Service) -> bool {
        query.records.iter().take(query.answers).any(|record| {
            record.kind == PTR
                && record.keep >= KEEP / 2
                && query.is(record.name, &Self::kind(service))
                && query.is(record.data, &self.full(service))
        })
    }
}
