//! The box's own page, for a phone: state and weights, and the commands neutral, freeze and forget.
//!
//! | request | answer |
//! | --- | --- |
//! | `GET /` | the page in one document |
//! | `GET /box.json` | name, slots, units by region with plain names and what they need to be seen, destinations of the weights |
//! | `GET /events` | an event stream: users and their weights, at most every [`SHORTEST_PERIOD`], at least every [`LONGEST_PERIOD`] |
//! | `POST /neutral/0`, `/freeze/0/1`, `/forget/0` | a command for the user in a slot, with the header `X-Mien: 1` |
//! | `POST /level/0/85`, `/hold/0/40` | the level at which the first gesture goes on and its hold time, in hundredths |
//! | `POST /teach/0/1`, `/teach/0/0` | finds both from five repetitions, or stops that |
//! | `POST /undo/0` | returns to the level and hold time before |
//!
//! Access: with a password (HTTP Basic, any user name) only requests that have it; without one only local networks. A request must
//! address the box by IP address, `localhost` or its name, and must not come from another site's page, so that such a page can
//! neither read nor command through a visitor's browser. Limitation: HTTP is not encrypted, so the password is only as secret as
//! the network.

use std::fmt::Write as _;
use std::net::IpAddr;
use std::time::{Duration, Instant};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::{Value, json};

use super::http::Request;
use super::server::{Answer, PLAIN, Service, serve};
use crate::features::{PageSettings, password};
use crate::gesture::Gesture;
use crate::limits::{Listening, is_local};
use crate::mailbox::{Mailbox, ThreadedOutput, Weight};
use crate::{Command, OutputError, UnitView, View, identity};
use mien_stages::base::capacity::USERS;
use mien_stages::expression::unit_words;

/// The page in one document, so that a phone needs one request. `look.css`, `units.js` and `setup.js` are shared with other pages of mien.
const PAGE: &str = concat!(
    include_str!("page/box.html"),
    "<style>\n",
    include_str!("page/look.css"),
    include_str!("page/box.css"),
    "</style>\n<script type=\"module\">\n",
    include_str!("page/units.js"),
    include_str!("page/setup.js"),
    include_str!("page/box.js"),
    "</script>\n</html>\n"
);
/// Headers of the page.
const HTML: &str = "Content-Type: text/html; charset=utf-8\r\nContent-Security-Policy: default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\nX-Content-Type-Options: nosniff\r\n";
/// Bytes of a reply's header or of a message with four users and all gestures.
const MESSAGE: usize = 8192;
/// Shortest time between two messages.
const SHORTEST_PERIOD: Duration = Duration::from_millis(60);
/// Longest time between two messages.
const LONGEST_PERIOD: Duration = Duration::from_secs(1);
/// Longest password, bytes.
const PASSWORD_MAX: usize = 64;
/// Weight of the newest frame in the smoothed frame rate.
const RATE_SMOOTHING: f32 = 0.1;

struct Page {
    name: String,
    /// Required password, if one is set.
    password: Option<String>,
    /// `box.json`, constant.
    about: String,
    last: Instant,
    /// Number, capture time (µs) and arrival of the newest frame.
    newest: (u64, u64, Option<Instant>),
    rate: f32,
}

/// Whether a password is 8 to 64 printable ASCII characters, which every keyboard has.
fn is_password(word: &str) -> bool {
    (8..=PASSWORD_MAX).contains(&word.len()) && word.bytes().all(|c| (32..127).contains(&c))
}

/// Compares passwords in constant time.
fn is_equal(given: &[u8], known: &[u8]) -> bool {
    let at = |bytes: &[u8], i: usize| bytes.get(i).copied().unwrap_or_default();
    let differ = (0..PASSWORD_MAX).fold(0, |all, i| all | at(given, i) ^ at(known, i));
    std::hint::black_box(differ) == 0 && given.len() == known.len()
}

/// Whether the value of the header `Authorization` has this password.
fn has_password(header: &str, password: &str) -> bool {
    let is_basic = |(scheme, _): &(&str, _)| scheme.eq_ignore_ascii_case("basic");
    let coded = header.split_once(' ').filter(is_basic);
    let mut room = [0; 3 * PASSWORD_MAX];
    let length = coded.and_then(|(_, coded)| STANDARD.decode_slice(coded.trim(), &mut room).ok());
    let given = &room[..length.unwrap_or_default()];
    let mut parts = given.splitn(2, |&byte| byte == b':').skip(1);
    is_equal(parts.next().unwrap_or_default(), password.as_bytes())
}

impl Page {
    /// Checks access.
    ///
    /// # Errors
    /// The HTTP status with which to refuse the request.
    fn admits(&self, request: &Request, peer: IpAddr) -> Result<(), u16> {
        if self.password.is_none() && !is_local(peer) {
            return Err(403);
        }
        if request.is_from_elsewhere(&self.name)? {
            return Err(403);
        }
        // A login that is not UTF-8 is refused as wrong.
        let login = request.header("authorization").ok().flatten();
        let is_known = |password: &String| login.is_some_and(|given| has_password(given, password));
        let admitted = self.password.as_ref().is_none_or(is_known);
        admitted.then_some(()).ok_or(401)
    }
}

/// The command of a POST to `path`; `None` if it is not one.
fn parse_command(path: &str) -> Option<Command> {
    let (what, rest) = path.strip_prefix('/')?.split_once('/')?;
    Command::from_words(what, rest.split('/'))
}

impl Service for Page {
    const BUFFER: usize = PAGE.len() + MESSAGE;

    fn answer(&self, request: &Request, peer: IpAddr, body: &mut String) -> Result<Answer, u16> {
        self.admits(request, peer)?;
        let (document, headers) = match (request.is_post, request.path) {
            (true, path) => return parse_command(path).map(Answer::Command).ok_or(404),
            (false, "/events") => return Ok(Answer::Stream),
            (false, "/box.json") => (self.about.as_str(), PLAIN),
            (false, "/") => (PAGE, HTML),
            _ => return Err(404),
        };
        body.push_str(document);
        Ok(Answer::Document(headers))
    }

    fn next_message(&mut self, mailbox: &mut Mailbox, message: &mut String) -> bool {
        let snapshots = || mailbox.users.iter().chain([&mailbox.nobody]);
        let fresh = || snapshots().filter(|snapshot| snapshot.fresh);
        let newest = fresh().max_by_key(|snapshot| snapshot.frame);
        if let Some(newest) = newest.filter(|newest| newest.frame != self.newest.0) {
            let frames = newest.frame.saturating_sub(self.newest.0) as f32;
            let seconds = newest.at_us.saturating_sub(self.newest.1) as f32 * 1e-6;
            if seconds > 0.0 && self.newest.2.is_some() {
                let rate = (frames / seconds).min(999.0);
                self.rate += RATE_SMOOTHING * (rate - self.rate);
            }
            self.newest = (newest.frame, newest.at_us, Some(Instant::now()));
        }
        let passed = self.last.elapsed();
        let is_waiting = fresh().next().is_none() && passed < LONGEST_PERIOD;
        if passed < SHORTEST_PERIOD || is_waiting {
            return false;
        }
        self.last = Instant::now();
        // A string takes everything.
        let _ = self.write(mailbox, message);
        let all = mailbox.users.iter_mut().chain([&mut mailbox.nobody]);
        all.for_each(|snapshot| snapshot.fresh = false);
        mailbox.set_ups = Default::default();
        true
    }
}

impl Page {
    fn write(&self, mailbox: &Mailbox, message: &mut String) -> std::fmt::Result {
        let ((frame, _, at), rate) = (self.newest, self.rate);
        let silent = at.map_or(u128::MAX, |at| at.elapsed().as_millis());
        let silent = silent.min(u128::from(u32::MAX));
        write!(
            message,
            "{{\"frame\":{frame},\"silent_ms\":{silent},\"rate\":{rate:.1}"
        )?;
        message.write_str(",\"users\":[")?;
        let users = mailbox.users.iter().enumerate();
        let known = users.filter(|(_, snapshot)| snapshot.count > 0);
        for (i, (slot, snapshot)) in known.enumerate() {
            let comma = if i > 0 { "," } else { "" };
            let gestures = snapshot.gestures;
            write!(
                message,
                "{comma}{{\"slot\":{slot},{snapshot},\"gestures\":{gestures}"
            )?;
            message.write_str(",\"weights\":[")?;
            for (i, weight) in snapshot.weights.iter().enumerate() {
                let comma = if i > 0 { "," } else { "" };
                write!(message, "{comma}{}", Weight(*weight))?;
            }
            message.write_str("]}")?;
        }
        message.write_str("],\"set_ups\":[")?;
        for (i, facts) in mailbox.set_ups.iter().flatten().enumerate() {
            let comma = if i > 0 { "," } else { "" };
            write!(message, "{comma}{{{facts}}}")?;
        }
        message.write_str("]}")
    }
}

/// `box.json`. `sends` names the destinations of the weights.
fn about(name: &str, units: &[&str], sends: &str, gestures: &[Gesture]) -> String {
    let gestures = gestures.iter().map(|gesture| {
        let levels = [gesture.on, gesture.off].map(f64::from);
        let [on, off] = levels.map(|level| (level * 1e6).round() / 1e6);
        json!({"name": gesture.name, "sums": gesture.indexed(units), "on": on, "off": off})
    });
    let gestures: Vec<Value> = gestures.collect();
    let regions = unit_words::regions_json(units);
    json!({"name": name, "slots": USERS, "sends": sends, "gestures": gestures, "regions": regions})
        .to_string()
}

/// The page's password; `None` if no file is configured.
///
/// # Errors
/// If the file cannot be read or its password is unsuitable.
pub fn read_password(settings: &PageSettings) -> Result<Option<String>, OutputError> {
    let password = password(&settings.password_file)?;
    if password.as_ref().is_some_and(|word| !is_password(word)) {
        let problem = "its first line is not 8 to 64 printable ASCII characters";
        let problem = std::io::Error::other(problem);
        let path = settings.password_file.clone();
        return Err(OutputError::Password(path, problem));
    }
    Ok(password)
}

/// Starts serving the page. `units` are the names in the order of the weights, `name` is the name of the box, `sends` names the
/// destinations of the weights.
///
/// # Errors
/// If the password cannot be read, the address is unusable or no thread can be started; not if the address is taken.
pub fn open(
    settings: &PageSettings,
    unit_views: &[UnitView],
    name: &str,
    sends: &str,
    units: &[&str],
    gestures: &[Gesture],
) -> Result<ThreadedOutput, OutputError> {
    let listener = Listening::new(&settings.listen)?;
    let password = read_password(settings)?;
    let name = identity::name(name);
    let page = Page {
        about: about(&name, units, sends, gestures),
        name,
        password,
        last: Instant::now(),
        newest: (0, 0, None),
        rate: 30.0,
    };
    let work = move |shared, waker| serve(page, listener, shared, waker);
    let view = View {
        units: unit_views.to_vec(),
        ..View::default()
    };
    ThreadedOutput::start("page", units, &view, work)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gesture::SetUpFacts;
    use crate::{Output, Report};
    use mien_stages::base::capacity::GESTURES;
    use std::net::SocketAddr;

    fn page(password: Option<&str>) -> Page {
        Page {
            name: "stage-left".into(),
            password: password.map(str::to_owned),
            about: about(
                "stage-left",
                &["AU26", "AU12L", "AU1R"],
                "OSC to 10.0.0.2:9130",
                &[Gesture::named("smile")],
            ),
            last: Instant::now(),
            newest: (0, 0, None),
            rate: 30.0,
        }
    }

    fn admits(page: &Page, headers: &str, is_post: bool, peer: &str) -> Result<(), u16> {
        let method = if is_post { "POST" } else { "GET" };
        let text = format!("{method} / HTTP/1.1\r\n{headers}\r\n\r\n");
        let request = Request::read(text.as_bytes(), 2048).unwrap().unwrap();
        page.admits(&request, peer.parse().unwrap())
    }

    #[test]
    fn only_the_local_network_is_answered_without_a_password() {
        let open = page(None);
        let ask = |peer| admits(&open, "Host: 192.168.1.2:9134", false, peer);
        let near = "127.0.0.1 192.168.1.9 10.1.2.3 172.16.0.1 169.254.3.4 ::ffff:192.168.1.9";
        for near in near.split(' ').chain(["::1", "fe80::1", "fd00::2"]) {
            assert_eq!(ask(near), Ok(()), "{near}");
        }
        for far in "8.8.8.8 172.32.0.1 100.64.0.1 2001:db8::1 ::ffff:8.8.8.8".split(' ') {
            assert_eq!(ask(far), Err(403), "{far}");
        }
    }

    #[test]
    fn a_password_that_is_set_must_be_known_and_serves_from_anywhere() {
        let closed = page(Some("open sesame"));
        let ask = |login: &str, peer| {
            let headers = format!("Host: localhost\r\nAuthorization: {login}");
            admits(&closed, &headers, false, peer)
        };
        // mien:open sesame, and with another user; mien:open sesamf; mien:open sesam; open sesame without a user.
        for right in [
            "Basic bWllbjpvcGVuIHNlc2FtZQ==",
            "basic eDpvcGVuIHNlc2FtZQ==",
        ] {
            assert_eq!(ask(right, "8.8.8.8"), Ok(()), "{right}");
        }
        for wrong in [
            "Basic bWllbjpvcGVuIHNlc2FtZg==",
            "Basic bWllbjpvcGVuIHNlc2Ft",
            "Basic b3BlbiBzZXNhbWU=",
            "Basic",
            "Basic ",
            "Bearer bWllbjpvcGVuIHNlc2FtZQ==",
            "Basic \u{fc}",
        ] {
            assert_eq!(ask(wrong, "127.0.0.1"), Err(401), "{wrong}");
        }
        let without = admits(&closed, "Host: localhost\r\n", false, "127.0.0.1");
        assert_eq!(without, Err(401));
    }

    #[test]
    fn other_sites_can_neither_read_nor_command() {
        let open = page(None);
        let ask = |headers: &str, is_post| admits(&open, headers, is_post, "127.0.0.1");
        for own in [
            "Host: stage-left:9134",
            "Host: Stage-Left.local",
            "Host: [::1]:9134",
            "Host: [::1]",
            "Host: 10.0.0.7",
        ] {
            assert_eq!(ask(own, false), Ok(()), "{own}");
        }
        for other in [
            "Host: evil.example:9134",
            "Host: ",
            "X: y",
            "Host: stage-left.evil.example",
        ] {
            assert_eq!(ask(other, false), Err(421), "{other}");
        }
        assert_eq!(ask("Host: localhost\r\nHost: localhost", false), Err(400));
        let own = "Host: localhost:9134\r\nX-Mien: 1\r\n";
        let page = format!("{own}Origin: http://localhost:9134");
        assert_eq!(ask(&page, true), Ok(()));
        for more in [
            "Origin: http://evil.example",
            "Origin: null",
            "Origin: http://localhost:1",
            "Sec-Fetch-Site: cross-site",
        ] {
            assert_eq!(ask(&format!("{own}{more}"), true), Err(403), "{more}");
        }
        let form = ask("Host: localhost:9134", true);
        assert_eq!(form, Err(403), "a form has no header of its own");
    }

    #[test]
    fn orders_are_read_and_nonsense_is_none() {
        for (path, expected) in [
            ("/neutral/0", Command::Neutral(0)),
            ("/forget/3", Command::Forget(3)),
            ("/freeze/1/1", Command::Freeze(1, true)),
            ("/freeze/1/0", Command::Freeze(1, false)),
            ("/level/2/85", Command::Level(2, 85)),
            ("/hold/2/40", Command::Hold(2, 40)),
            ("/teach/15/1", Command::Teach(15, true)),
            ("/teach/0/0", Command::Teach(0, false)),
            ("/undo/0", Command::Undo(0)),
        ] {
            assert_eq!(parse_command(path), Some(expected), "{path}");
        }
        let odd = "/freeze/1 /freeze/1/2 /level/2 /level/2/-5 /teach/0 /teach/16/1 /undo/0/0 /neutral/4 /neutral/-1 /neutral/0/0 /neutral/0/ /";
        for path in odd.split(' ') {
            assert_eq!(parse_command(path), None, "{path}");
        }
    }

    #[test]
    fn units_have_plain_names_by_region() {
        let given: Value = serde_json::from_str(&page(None).about).unwrap();
        assert_eq!(
            given,
            json!({
                "name": "stage-left", "slots": 4, "sends": "OSC to 10.0.0.2:9130",
                "gestures": [{"name": "smile", "sums": [[[1, 1.0], [0, -1.0]]], "on": 0.13, "off": 0.08}],
                "regions": [
                    ["Brows", [[2, "AU1R", "Inner brow up right", "AU1R, inner brow raiser: the inner end of the brow rises (the subject's right)", ["brow_R", "eye_R"]]]],
                    ["Mouth", [[1, "AU12L", "Smile left", "AU12L, lip corner puller: the corner of the mouth moves up and out (the subject's left)", ["mouth"]]]],
                    ["Jaw", [[0, "AU26", "Jaw drop", "AU26, jaw drop: the jaw drops, the mouth opens", ["mouth"]]]],
                ],
            })
        );
        for unit in mien_stages::expression::Units::shipped().columns(false) {
            assert!(!about("", &[&unit], "", &[]).contains("Other"), "{unit}");
        }
    }

    #[test]
    fn a_message_fits_its_place() {
        let mut mailbox = Mailbox::default();
        for snapshot in &mut mailbox.users {
            (snapshot.count, snapshot.latency_us) = (1, u32::MAX);
            snapshot.seen = Some([0.5; mien_stages::base::capacity::REGIONS]);
            snapshot
                .weights
                .extend([0.5; mien_stages::base::capacity::UNITS]);
        }
        mailbox.set_ups = [Some(SetUpFacts {
            count: u32::MAX,
            tracked_s: 86_400,
            ..SetUpFacts::default()
        }); GESTURES];
        let mut message = String::new();
        page(None).write(&mailbox, &mut message).unwrap();
        assert!(message.len() + 16 < MESSAGE, "{}", message.len());
    }

    /// A served page with one user at `AU26` 0.5, and where it is.
    fn served(password: Option<&str>) -> (ThreadedOutput, SocketAddr) {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        drop(listener);
        let folder = tempfile::tempdir().unwrap();
        let file = password.map(|password| {
            let file = folder.path().join("password");
            std::fs::write(&file, format!("{password}\n")).unwrap();
            file
        });
        let settings = PageSettings {
            listen: address.to_string(),
            password_file: file
                .map_or_else(String::new, |file| file.to_string_lossy().into_owned()),
            ..PageSettings::default()
        };
        let mut page = open(&settings, &[], "stage-left", "", &["AU26"], &[]).unwrap();
        let report = Report {
            frame: 7,
            user: Some(0),
            state: crate::TrackingState::Tracking,
            confidence: 1.0,
            weights: &[0.5],
            ..Report::default()
        };
        page.send(&report).unwrap();
        while !page.tally().connected {
            std::thread::sleep(Duration::from_millis(5));
        }
        (page, address)
    }

    /// What is answered, up to `until` or the end.
    fn asked(address: SocketAddr, what: &str, headers: &str, until: &str) -> String {
        use std::io::{Read, Write};
        let mut stream = std::net::TcpStream::connect(address).unwrap();
        let text = format!("{what} HTTP/1.1\r\nHost: {address}\r\n{headers}\r\n");
        stream.write_all(text.as_bytes()).unwrap();
        let (mut all, mut some) = (Vec::new(), [0; 4096]);
        while let Ok(read @ 1..) = stream.read(&mut some) {
            all.extend_from_slice(&some[..read]);
            if !until.is_empty() && String::from_utf8_lossy(&all).contains(until) {
                break;
            }
        }
        String::from_utf8(all).unwrap()
    }

    #[test]
    fn the_page_its_stream_and_its_commands_are_served() {
        let (mut page, address) = served(None);
        let text = asked(address, "GET /", "", "");
        assert!(
            text.starts_with("HTTP/1.1 200 ") && text.ends_with(PAGE),
            "{text}"
        );
        assert!(text.contains("text/html") && !text.contains("Allow-Origin"));
        let live = asked(address, "GET /events", "", "]}\n");
        assert!(live.contains("data: {\"frame\":7,"), "{live}");
        assert!(
            live.contains("\"state\":\"tracking\"") && live.contains("[0.5000]"),
            "{live}"
        );
        for (what, headers, expected) in [
            ("POST /neutral/0", "X-Mien: 1\r\n", "204"),
            ("POST /neutral/0", "", "403"),
            ("POST /neutral/9", "X-Mien: 1\r\n", "404"),
            ("GET /neutral/0", "X-Mien: 1\r\n", "404"),
            ("OPTIONS /neutral/0", "", "405"),
            ("GET /", "Origin: http://evil.example\r\n", "403"),
        ] {
            let status = asked(address, what, headers, "");
            assert_eq!(status.split(' ').nth(1), Some(expected), "{what} {headers}");
        }
        assert_eq!(page.next_command(), Some(Command::Neutral(0)));
        assert_eq!(page.next_command(), None, "what was refused is not done");
        assert_eq!(page.tally().commands[0], 1);
        // 403, 404, 404, 405, 403.
        assert_eq!(page.tally().commands[1], 5);
    }

    #[test]
    fn a_password_file_without_a_password_opens_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("password");
        let settings = PageSettings {
            listen: "127.0.0.1:0".into(),
            password_file: file.to_string_lossy().into_owned(),
            ..PageSettings::default()
        };
        let problem = || {
            open(&settings, &[], "", "", &[], &[])
                .err()
                .map(|problem| problem.to_string())
        };
        assert!(problem().is_some_and(|problem| problem.contains("No such file")));
        for text in ["", "\n", "short\n", "\nopen sesame\n"] {
            std::fs::write(&file, text).unwrap();
            let problem = problem().expect(text);
            assert!(problem.contains("8 to 64 printable ASCII"), "{problem}");
        }
    }

    #[test]
    fn a_wrong_password_gets_nothing() {
        let (mut page, address) = served(Some("open sesame"));
        for what in ["GET /", "GET /box.json", "GET /events", "POST /forget/0"] {
            let own = "X-Mien: 1\r\n";
            let text = asked(address, what, own, "");
            assert!(
                text.starts_with("HTTP/1.1 401 ") && text.contains("WWW-Authenticate: Basic"),
                "{text}"
            );
            assert!(text.ends_with("\r\n\r\n"), "{text}");
        }
        assert_eq!(page.next_command(), None);
        let right = "Authorization: Basic bWllbjpvcGVuIHNlc2FtZQ==\r\n";
        assert!(asked(address, "GET /", right, "").ends_with(PAGE));
    }

    #[test]
    fn streams_leave_room_for_requests() {
        use std::io::{Read, Write};
        let (_page, address) = served(None);
        let open = || {
            let mut stream = std::net::TcpStream::connect(address).unwrap();
            let text = format!("GET /events HTTP/1.1\r\nHost: {address}\r\n\r\n");
            stream.write_all(text.as_bytes()).unwrap();
            let mut status = [0; 12];
            stream.read_exact(&mut status).unwrap();
            (String::from_utf8_lossy(&status[9..]).into_owned(), stream)
        };
        let streams: Vec<_> = (0..7).map(|_| open()).collect();
        let statuses: Vec<&str> = streams.iter().map(|(status, _)| status.as_str()).collect();
        // One peer takes four of the six streams at most.
        assert_eq!(statuses, ["200", "200", "200", "200", "503", "503", "503"]);
        assert!(asked(address, "GET /", "", "").ends_with(PAGE));
    }
}
