//! `mien-studio preview`: a live page with an animated head, units, curves, pose and state.
//!
//! ```text
//! OSC │ serial │ CSV │ recording, sensor + pipeline ─► hub ─► server-sent events ─► page (WebGL 2, morphs on the GPU)
//!
//! feeds                        samples from OSC, a serial line or a CSV, by the parsers of mien_outputs
//! sensor                       samples of a sensor that this program tracks itself
//! sample                       one user at one frame, as JSON
//! hub                          between one source and any number of pages
//! http                         requests and answers of a page
//! commands, forward, gains     actions of a page on box or pipeline, on other receivers, on a configuration
//! ```
//! One source, any number of pages. The page is built in ([`PAGE`], nothing is fetched from elsewhere) and by default
//! served on the loopback interface. Images of the sensor are shown only if this process reads them itself, and only
//! to pages on this machine. Times in seconds of the stream. Memory: see [`hub`]; the standard head is baked at the
//! start, in about a second of processor time.

pub mod commands;
mod feeds;
pub mod forward;
mod gains;
pub mod http;
pub mod hub;
pub mod sample;
pub mod sensor;

use std::net::{SocketAddr, UdpSocket};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use clap::ValueEnum as _;
use serde_json::{Value, json};

use commands::CommandTarget;
use forward::{ForwardAction, Forwarder};
use http::{Answer, Request, Site};
use hub::Hub;
use mien_appliance::pipeline::Pipeline;
use mien_appliance::service;
use mien_appliance::source;
use mien_baking::bake::glb::Glb;
use mien_baking::bake::recipe::{Recipe, SHIPPED};
use mien_baking::heads::default_head;
use mien_baking::heads::hero::Hero;
use mien_outputs::Command;
use mien_outputs::gesture::Gestures;
use mien_outputs::received::Receive as _;
use mien_sensors::turned::upright;
use mien_stages::turn::Turn;
use mien_workbench::fault::Fault;
use mien_workbench::text_files::{self, display_name};

/// Default address of the page.
pub const PAGE_ADDRESS: &str = "127.0.0.1:9180";
/// Default address for OSC, to which `mien` sends.
pub const OSC_ADDRESS: &str = "127.0.0.1:9130";
/// Most commands queued for the pipeline.
const COMMANDS: usize = 16;
/// Interval of sending counts, which also detects disconnected pages.
const COUNTS_EVERY: Duration = Duration::from_millis(500);

/// Style shared with the box's own page and the player of `inspect`.
pub const LOOK: &str = include_str!("../../outputs/web/page/look.css");
/// Rows of units, shared with the box's page.
pub const UNITS: &str = include_str!("../../outputs/web/page/units.js");
/// Set-up of gestures, shared with the box's page.
const SETUP: &str = include_str!("../../outputs/web/page/setup.js");
/// Curves and faces, shared with the player.
pub const DRAWING: &str = include_str!("page/drawing.js");

/// The files of the page: path and text.
pub const PAGE: [(&str, &str); 14] = [
    ("/", include_str!("page/index.html")),
    ("/look.css", LOOK),
    ("/units.js", UNITS),
    ("/setup.js", SETUP),
    ("/drawing.js", DRAWING),
    ("/style.css", include_str!("page/style.css")),
    ("/main.js", include_str!("page/main.js")),
    ("/stream.js", include_str!("page/stream.js")),
    ("/head.js", include_str!("page/head.js")),
    ("/glb.js", include_str!("page/glb.js")),
    ("/matrix.js", include_str!("page/matrix.js")),
    ("/panels.js", include_str!("page/panels.js")),
    ("/picture.js", include_str!("page/picture.js")),
    ("/control.js", include_str!("page/control.js")),
];

/// What to show and where.
#[derive(clap::Args)]
pub struct Args {
    /// PORT or ADDRESS:PORT to receive OSC at; 0.0.0.0:9130 for a mien elsewhere
    #[arg(long, group = "feed", default_value = OSC_ADDRESS, value_parser = address)]
    osc: SocketAddr,
    /// A serial port or tcp:host:port, any style
    #[arg(long, group = "feed")]
    serial: Option<String>,
    /// Baud rate of the serial port
    #[arg(long, default_value_t = 115_200)]
    baud: u32,
    /// Value of a weight of 1, serial.full of the sender
    #[arg(long, default_value_t = 100)]
    full: u32,
    /// CSV written by mien run --csv, to play, pause and scrub; - for standard input
    #[arg(long, group = "feed")]
    csv: Option<PathBuf>,
    /// A source named as in `mien run` (auto, kinect, camera, simulated, a recording, …): tracked by this program, with pictures
    #[arg(long, group = "feed")]
    source: Option<String>,
    /// Face model, with --source [default: the built-in one]
    #[arg(long)]
    model: Option<PathBuf>,
    /// Configuration file in which to save gains tried on the page
    #[arg(long)]
    config: Option<PathBuf>,
    /// ADDRESS:PORT at which the box receives commands (its osc.listen) [default: the host that sends, port 9131]
    #[arg(long = "box", value_parser = address)]
    commands: Option<SocketAddr>,
    /// Heads with named morph targets (.glb) [default: the built-in head]
    #[arg(long, num_args = 1..)]
    mesh: Vec<PathBuf>,
    /// PORT or ADDRESS:PORT of the page; 0 takes a free port
    #[arg(long, default_value = PAGE_ADDRESS, value_parser = address)]
    port: SocketAddr,
}

/// Source of frames.
enum Feed<'a> {
    Osc(SocketAddr),
    Serial(feeds::Port),
    /// The CSV of a run.
    Csv(&'a Path),
    /// A source tracked by this process, named as in `mien run --source`.
    Sensor(&'a str),
}

impl Args {
    fn feed(&self) -> Feed<'_> {
        if let Some(name) = &self.serial {
            return Feed::Serial(feeds::Port {
                name: name.clone(),
                baud: self.baud,
                full: self.full.max(1) as f32,
            });
        }
        match (&self.csv, &self.source) {
            (Some(csv), _) => Feed::Csv(csv),
            (None, Some(name)) => Feed::Sensor(name),
            (None, None) => Feed::Osc(self.osc),
        }
    }
}

/// `PORT` or `ADDRESS:PORT`; a port alone is one of the loopback interface.
fn address(text: &str) -> Result<SocketAddr, &'static str> {
    let port = text.parse::<u16>();
    port.map(|port| SocketAddr::from(([127, 0, 0, 1], port)))
        .or_else(|_| text.parse())
        .map_err(|_| "it is not a port or an address:port")
}

/// The warning for a page that other machines can open.
fn warning(page: SocketAddr) -> Option<String> {
    (!page.ip().is_loopback()).then(|| {
        format!(
            "warning: {page} has no password, so everybody who can reach this machine can see weights and heads (but no \
             pictures) and use Set neutral, Freeze and Forget; use --port {} to serve this machine only",
            page.port()
        )
    })
}

/// State from which requests are answered.
struct Preview {
    hub: Arc<Hub>,
    command_target: CommandTarget,
    forwarder: Forwarder,
    /// The configuration file for saved gains.
    gains: Option<PathBuf>,
    /// The default head, baked on the first request.
    own: OnceLock<Option<Arc<[u8]>>>,
    /// Heads shown instead.
    given: Vec<Arc<[u8]>>,
    /// Recording from which images are shown, and the turn of its sensor.
    recording: Option<(PathBuf, Option<Turn>)>,
    /// Units by names of targets, for heads without them.
    units: Value,
}

impl Preview {
    fn picture(&self, request: &Request) -> Answer {
        if !request.is_local() || request.elsewhere {
            return Answer::Refused(
                403,
                "sensor pictures are served on this machine and to this page only\n",
            );
        }
        let wants_depth = request.parameter("view") == "depth";
        let found = || {
            if let Some((directory, turn)) = &self.recording {
                let number = request.parameter("n").parse().ok()?;
                return Some((
                    number,
                    sensor::recorded(directory, *turn, number, wants_depth)?,
                ));
            }
            let (number, seen) = self.hub.picture()?;
            Some((number, sensor::picture(&seen, wants_depth)?))
        };
        let Some((number, (of_depth, jpeg))) = found() else {
            return Answer::Refused(404, "there is no picture of this frame\n");
        };
        let view = if of_depth { "depth" } else { "colour" };
        let headers = format!("X-Frame: {number}\r\nX-View: {view}\r\n");
        Answer::Marked("image/jpeg", headers, jpeg.into())
    }

    /// Executes a POST of the page; `None` for an unknown path.
    fn change(&self, request: &Request) -> Option<Result<String, String>> {
        let parameter = |name| request.parameter(name);
        Some(match request.path {
            "/command" => {
                let on = Some(parameter("on")).filter(|on| !on.is_empty());
                let words = [parameter("user")].into_iter().chain(on);
                Command::from_words(parameter("what"), words)
                    .ok_or_else(|| "unknown command".to_owned())
                    .and_then(|command| self.command_target.execute(command, self.hub.sender()))
            }
            // Only this machine may choose where packets go.
            "/receiver" if !request.is_local() => Err(
                "receivers can be connected only on the machine that serves the page; put the lines below into the box's configuration instead".into(),
            ),
            "/receiver" => {
                // Colons of IPv6 may be percent-encoded.
                let host = parameter("host").replace("%3A", ":");
                ForwardAction::from_str(parameter("do"), false)
                    .map_err(|_| "expected connect, test or stop".to_owned())
                    .and_then(|action| self.forwarder.ask(parameter("id"), &host, parameter("port"), action))
            }
            "/gains" if !request.is_local() => {
                Err("gains can be saved only on the machine that serves the page".into())
            }
            "/gains" => match &self.gains {
                Some(path) => gains::save(path, request.query),
                None => Err("start mien-studio preview with --config to save gains".into()),
            },
            _ => return None,
        })
    }

    /// A head by its number.
    fn mesh(&self, number: &str) -> Option<Answer> {
        let number: usize = number.parse().ok()?;
        let head = if self.given.is_empty() && number == 0 {
            let bake = || default_head::glb(&Hero::shipped()).ok().map(Into::into);
            self.own.get_or_init(bake).as_ref()
        } else {
            self.given.get(number)
        };
        Some(Answer::File("model/gltf-binary", Arc::clone(head?)))
    }
}

impl Site for Preview {
    fn answer(&self, request: &Request) -> Answer {
        if request.post {
            let Some(done) = self.change(request) else {
                self.refused();
                return Answer::Refused(404, "no such command\n");
            };
            let (ok, said) = done.map_or_else(|why| (false, why), |said| (true, said));
            return Answer::json(&json!({"ok": ok, "said": said}));
        }
        if let Some(file) = Answer::page_file(&PAGE, request.path) {
            return file;
        }
        match request.path {
            "/events" if request.elsewhere => {
                Answer::Refused(403, "events are served to this page only\n")
            }
            "/events" => Answer::Events,
            "/units.json" => Answer::json(&self.units),
            "/words.json" => Answer::json(&json!({"receivers": *forward::RECEIVERS})),
            "/picture" => self.picture(request),
            path => {
                let Some(number) = path.strip_prefix("/mesh/") else {
                    self.refused();
                    return Answer::Refused(404, "no such file; the page is at /\n");
                };
                let head = self.mesh(number);
                head.unwrap_or(Answer::Refused(404, "no such head\n"))
            }
        }
    }

    fn events(&self, send: &mut dyn FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()> {
        let (facts, mut next) = self.hub.start();
        for fact in facts {
            send(fact.as_bytes())?;
        }
        let mut counts_sent: Option<Instant> = None;
        loop {
            let (lines, after) = self.hub.read(next, COUNTS_EVERY);
            next = after;
            let mut text = lines.concat();
            if counts_sent.is_none_or(|counts_sent| counts_sent.elapsed() >= COUNTS_EVERY) {
                counts_sent = Some(Instant::now());
                text += &self.hub.counts_event();
            }
            send(text.as_bytes())?;
        }
    }

    fn refused(&self) {
        self.hub.count(0, 1);
    }
}

fn read_mesh(path: &Path) -> Result<Arc<[u8]>, Fault> {
    let bytes = mien_stages::base::bounded_read::read(path, text_files::MAX_BYTES)
        .map_err(|error| Fault::within(path)(format!("cannot be read: {error}")))?;
    Glb::parse(&bytes).map_err(Fault::within(path))?;
    Ok(bytes.into())
}

/// Kind and name of a feed, for the page.
fn named(feed: &Feed) -> (&'static str, String) {
    match feed {
        Feed::Osc(address) => ("osc", format!("OSC at {address}")),
        Feed::Serial(port) => ("serial", port.name.clone()),
        Feed::Csv(path) => ("csv", path.display().to_string()),
        Feed::Sensor(name) => ("sensor", (*name).to_owned()),
    }
}

impl Preview {
    /// With nothing received yet; commands for this process's own pipeline go to `orders`.
    fn new(args: &Args, feed: &Feed, orders: SyncSender<Command>) -> Result<Self, Fault> {
        let given = args.mesh.iter().map(|path| read_mesh(path));
        let given: Vec<_> = given.collect::<Result<_, _>>()?;
        let mut recording = None;
        if let Feed::Sensor(name) = *feed
            && !source::is_live(name)
        {
            let settings = service::settings(args.config.as_deref())?;
            recording = Some((name.into(), settings.sensor.turned));
        }
        let session = recording.is_some() || matches!(feed, Feed::Csv(_));
        let hub = Arc::new(Hub::new(session));
        let units = Recipe::read(SHIPPED).map(|recipe| recipe.units());
        let units = units.unwrap_or_default().into_iter();
        let units = units.map(|(name, unit)| (name, Value::from(unit)));
        Ok(Self {
            forwarder: Forwarder::start(Arc::clone(&hub)),
            hub,
            command_target: match feed {
                Feed::Osc(_) => CommandTarget::Box(args.commands),
                Feed::Sensor(_) if recording.is_none() => CommandTarget::Here(Mutex::new(orders)),
                _ => CommandTarget::Nobody,
            },
            gains: args.config.clone(),
            own: OnceLock::new(),
            given,
            recording,
            units: units.collect(),
        })
    }

    /// Description of the source for pages.
    fn source(&self, args: &Args, feed: &Feed) -> Value {
        let (kind, name) = named(feed);
        let mut meshes: Vec<String> = args.mesh.iter().map(|path| display_name(path)).collect();
        if meshes.is_empty() {
            meshes.push("head".into());
        }
        json!({
            "kind": kind,
            "name": name,
            "session": self.hub.is_session(),
            "pictures": matches!(feed, Feed::Sensor(_)),
            "meshes": meshes,
            "commands": !matches!(self.command_target, CommandTarget::Nobody),
            "configuration": self.gains.as_ref().map(|path| path.display().to_string()),
            "version": env!("CARGO_PKG_VERSION"),
        })
    }
}

/// Serves the page until the process ends; `say` gets a line once it can be opened.
///
/// # Errors
/// If an address is taken, or the source, the model or a mesh cannot be read.
pub fn run(args: &Args, say: &mut dyn FnMut(&str)) -> Result<(), Fault> {
    let (feed, (orders, obeyed)) = (args.feed(), sync_channel(COMMANDS));
    let preview = Arc::new(Preview::new(args, &feed, orders)?);
    let (listener, page) = http::listen(args.port)?;
    let (_, name) = named(&feed);
    let source = preview.source(args, &feed).to_string();
    let feeding = args.feeding(feed, Arc::clone(&preview), obeyed)?;
    preview.hub.fact("source", "source", &source);
    let early = Arc::clone(&preview);
    std::thread::spawn(move || drop(early.mesh("0")));
    std::thread::spawn(feeding);
    if let Some(warning) = warning(page) {
        say(&warning);
    }
    say(&format!("open http://{page}/ (shows {name}; Ctrl-C ends)"));
    http::serve(&listener, &preview);
    Ok(())
}

impl Args {
    /// A function that feeds the hub on a thread of its own; everything that can fail at the start is done here.
    fn feeding(
        &self,
        feed: Feed,
        preview: Arc<Preview>,
        commands: Receiver<Command>,
    ) -> Result<Box<dyn FnOnce() + Send>, Fault> {
        Ok(match feed {
            Feed::Osc(address) => {
                let socket = UdpSocket::bind(address).map_err(|error| {
                    Fault::new(format!(
                        "cannot receive OSC at {address}: {error}; another program may be using the port: choose another with --osc, and set the same in mien's osc.target"
                    ))
                })?;
                Box::new(move || feeds::receive_datagrams(&socket, &preview.hub))
            }
            Feed::Serial(port) => Box::new(move || feeds::receive_line(&port, &preview.hub)),
            Feed::Csv(path) => {
                let (table, reader) = feeds::open_table(path)?;
                let units: Vec<String> = table.units().map(str::to_owned).collect();
                preview.hub.schema(&units);
                Box::new(move || feeds::play_table(table, reader, &preview.hub))
            }
            Feed::Sensor(name) => {
                let settings = service::settings(self.config.as_deref())?;
                let model = service::model(self.model.as_deref())?;
                let (source, _) = source::open(name, false, &settings.sensor.device)?;
                let mut source = upright(source, settings.sensor.turned);
                let mut pipeline = Pipeline::new(&settings.stages, source.camera(), &model)?;
                let gestures = &settings.outputs.gestures;
                let mut gestures = Gestures::new(gestures, &pipeline.unit_names());
                Box::new(move || {
                    let tracker = (&mut pipeline, &mut gestures);
                    sensor::follow(&mut *source, tracker, &preview.hub, &commands);
                })
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_small_and_fetches_nothing_from_elsewhere() {
        let bytes: usize = PAGE.iter().map(|(_, text)| text.len()).sum();
        assert!(bytes < 1 << 20, "{bytes}");
        for (path, text) in PAGE {
            // Names of XML vocabularies are never fetched.
            assert!(
                !text.contains("http://") && !text.contains("https://"),
                "{path}"
            );
        }
    }

    #[test]
    fn a_port_alone_is_on_this_machine_only() {
        assert!(address("9130").unwrap().ip().is_loopback());
        assert!(!address("0.0.0.0:9130").unwrap().ip().is_loopback());
        assert!(address("host:9130").is_err());
    }

    #[test]
    fn a_page_open_to_other_machines_causes_a_warning() {
        for (address, warned) in [
            ("127.0.0.1:9180", false),
            ("[::1]:9180", false),
            ("0.0.0.0:9180", true),
            ("[::]:9180", true),
            ("192.168.1.20:9180", true),
        ] {
            let warning = warning(address.parse().unwrap());
            assert_eq!(warning.is_some(), warned, "{address}: {warning:?}");
        }
    }
}
