//! OSCQuery (the HTTP part of the proposal): the tree of addresses that `[osc]` sends and receives, as JSON, with types,
//! access, ranges, descriptions and the newest values. `GET /` returns the whole tree, `GET /face/0/pose` a subtree,
//! `GET /face/0/pose?VALUE` one attribute, `GET /?HOST_INFO` information about the box. Limits: no LISTEN over WebSocket;
//! values come over OSC itself, or over `[websocket]`.
//!
//! One file: every node with its types, ranges and values.
//!
//! | status | when |
//! | --- | --- |
//! | 200 | the node or attribute exists |
//! | 204 | the node has no such attribute |
//! | 400 | unknown attribute |
//! | 404 | no such node |

use std::fmt::{Result as Written, Write as _};
use std::net::SocketAddr;

use super::server::{Service, address, serve};
use crate::base::capacity::USERS;
use crate::base::json::Quoted;
use crate::output::board::{Board, Front, Shot, Weight};
use crate::output::features::ServerSettings;
use crate::output::osc::{self, Style};
use crate::output::{OutputError, SCHEMA_VERSION, identity};

/// Size of the whole tree with four users and the longest names, bytes.
const TREE: usize = 96 * 1024;
/// Bytes of the longest address.
const PATH: usize = 160;
/// Parts of the longest address.
const DEPTH: usize = 24;

/// Attributes a node may be asked for.
const ATTRIBUTES: [&str; 7] = [
    "FULL_PATH",
    "CONTENTS",
    "TYPE",
    "ACCESS",
    "VALUE",
    "RANGE",
    "DESCRIPTION",
];

/// A node of the tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Node {
    /// This many parts of the prefix down; the last of them contains everything.
    Prefix(usize),
    Alive,
    Schema,
    Commands,
    /// Index among [`COMMANDS`].
    Command(usize),
    User(usize),
    Frame(usize),
    Units(usize),
    Unit(usize, usize),
    Pose(usize),
    Present(usize),
}

/// Name, types, description.
const COMMANDS: [(&str, &str, &str); 4] = [
    (
        "forget",
        "i",
        "forgets what was learned about the user in a slot",
    ),
    (
        "freeze",
        "ii",
        "stops (1) or resumes (0) learning for the user in a slot",
    ),
    (
        "neutral",
        "i",
        "takes the current face of the user in a slot as neutral",
    ),
    ("schema", "", "sends the schema now"),
];

struct Tree {
    name: String,
    /// Parts of the prefix.
    prefix: Box<[String]>,
    units: Box<[String]>,
    /// The vector's types.
    floats: String,
    style: Style,
    /// The command port, if open.
    listens: Option<SocketAddr>,
}

impl Tree {
    /// Calls `each` with every child and its name.
    fn children(&self, node: Node, each: &mut dyn FnMut(&str, Node)) {
        match node {
            Node::Prefix(depth) if depth < self.prefix.len() => {
                each(&self.prefix[depth], Node::Prefix(depth + 1))
            }
            Node::Prefix(_) => {
                each("alive", Node::Alive);
                each("schema", Node::Schema);
                if self.listens.is_some() {
                    each("cmd", Node::Commands);
                }
                for (slot, name) in ["0", "1", "2", "3"].iter().enumerate().take(USERS) {
                    each(name, Node::User(slot));
                }
            }
            Node::Commands => {
                for (i, (name, ..)) in COMMANDS.iter().enumerate() {
                    each(name, Node::Command(i));
                }
            }
            Node::User(slot) => {
                each("frame", Node::Frame(slot));
                each("au", Node::Units(slot));
                each("pose", Node::Pose(slot));
                each("present", Node::Present(slot));
            }
            Node::Units(slot) if self.style != Style::Vector => {
                for (i, name) in self.units.iter().enumerate() {
                    each(name, Node::Unit(slot, i));
                }
            }
            _ => {}
        }
    }

    /// The node at a path.
    fn find(&self, path: &str) -> Option<Node> {
        let mut node = Node::Prefix(0);
        for part in path.split('/').filter(|part| !part.is_empty()).take(DEPTH) {
            let mut found = None;
            self.children(node, &mut |name, child| {
                if name == part {
                    found = Some(child);
                }
            });
            node = found?;
        }
        Some(node)
    }

    /// Types of its arguments, if it is a message.
    fn types(&self, node: Node) -> Option<&str> {
        Some(match node {
            Node::Alive => "isf",
            Node::Schema => return None,
            Node::Command(i) => COMMANDS[i].1,
            Node::Frame(_) => "iiiff",
            Node::Units(_) if self.style != Style::Scalar => &self.floats,
            Node::Unit(..) => "f",
            Node::Pose(_) => "fffffff",
            Node::Present(_) => "i",
            _ => return None,
        })
    }

    fn description(node: Node) -> &'static str {
        match node {
            Node::Prefix(_) => "faces in front of the sensor",
            Node::Alive => "every second: number, version, seconds since the start",
            Node::Schema => "version and names of the units, every 5 s",
            Node::Commands => "commands",
            Node::Command(i) => COMMANDS[i].2,
            Node::User(_) => "the user in a slot",
            Node::Frame(_) => {
                "number, time in ms, state (0 absent, 1 warming, 2 tracking, 3 held, 4 lost, 5 posed), confidence, latency in ms"
            }
            Node::Units(_) => "weights of all units in schema order",
            Node::Unit(..) => "weight of a FACS action unit: 0 at rest, 1 fully expressed",
            Node::Pose(_) => {
                "head pose, sensor frame: x right, y down, z forward in metres, rotation x y z w"
            }
            Node::Present(_) => "whether somebody is there",
        }
    }

    /// Writes an attribute; `None` if the node has none.
    fn attribute(
        &self,
        node: Node,
        path: &str,
        which: &str,
        board: &Board,
        out: &mut String,
    ) -> Option<Written> {
        let types = self.types(node);
        let message = types.is_some() || node == Node::Schema;
        Some(match which {
            "FULL_PATH" => write!(out, "{}", Quoted(if path.is_empty() { "/" } else { path })),
            "DESCRIPTION" => write!(out, "{}", Quoted(Self::description(node))),
            "ACCESS" => {
                let access = if matches!(node, Node::Command(_)) {
                    2
                } else {
                    u8::from(message)
                };
                write!(out, "{access}")
            }
            "TYPE" if node == Node::Schema => {
                let names = self.units.iter().map(|_| 's');
                out.extend("\"i".chars().chain(names).chain(['"']));
                Ok(())
            }
            "TYPE" => write!(out, "\"{}\"", types?),
            "RANGE" => return self.range(node, out),
            "VALUE" => return self.value(node, board, out),
            "CONTENTS" => {
                let mut any = false;
                let mut done = Ok(());
                self.children(node, &mut |name, child| {
                    let start = if std::mem::replace(&mut any, true) {
                        ","
                    } else {
                        "{"
                    };
                    let mut longer = heapless::String::<PATH>::new();
                    // Names and prefix are limited, and fit.
                    let _ = write!(longer, "{path}/{name}");
                    let written = write!(out, "{start}{}:", Quoted(name));
                    let written = written.and_then(|()| self.write(child, &longer, board, out));
                    done = done.and(written);
                });
                if !any {
                    return None;
                }
                done.and_then(|()| out.write_char('}'))
            }
            _ => return None,
        })
    }

    fn range(&self, node: Node, out: &mut String) -> Option<Written> {
        const SHARE: &str = "{\"MIN\":0,\"MAX\":1}";
        const SLOT: &str = "{\"MIN\":0,\"MAX\":3}";
        Some(match node {
            Node::Unit(..) => write!(out, "[{SHARE}]"),
            Node::Present(_) => write!(out, "[{{\"VALS\":[0,1]}}]"),
            Node::Frame(_) => write!(
                out,
                "[null,null,{{\"MIN\":0,\"MAX\":5}},{SHARE},{{\"MIN\":0}}]"
            ),
            Node::Units(_) if self.style != Style::Scalar => {
                let mut done = Ok(());
                for i in 0..self.units.len() {
                    let start = if i == 0 { '[' } else { ',' };
                    done = done.and_then(|()| write!(out, "{start}{SHARE}"));
                }
                done.and_then(|()| out.write_char(']'))
            }
            Node::Command(0 | 2) => write!(out, "[{SLOT}]"),
            Node::Command(1) => write!(out, "[{SLOT},{{\"VALS\":[0,1]}}]"),
            _ => return None,
        })
    }

    fn value(&self, node: Node, board: &Board, out: &mut String) -> Option<Written> {
        let newest = || {
            board
                .users
                .iter()
                .chain([&board.nobody])
                .map(|shot| shot.at_us)
                .max()
        };
        Some(match node {
            Node::Schema => {
                let mut done = write!(out, "[{SCHEMA_VERSION}");
                for name in &self.units {
                    done = done.and_then(|()| write!(out, ",{}", Quoted(name)));
                }
                done.and_then(|()| out.write_char(']'))
            }
            Node::Alive => {
                let seconds = newest().unwrap_or_default() as f64 * 1e-6;
                write!(
                    out,
                    "[{},{},{seconds:.3}]",
                    seconds as u64,
                    Quoted(env!("CARGO_PKG_VERSION"))
                )
            }
            Node::Frame(slot) => {
                let shot = &board.users[slot];
                write!(
                    out,
                    "[{},{},{},{},{:.3}]",
                    shot.count,
                    shot.at_us / 1000,
                    shot.state.code(),
                    Weight(shot.confidence),
                    f64::from(shot.latency_us) * 1e-3
                )
            }
            Node::Units(slot) if self.style != Style::Scalar => {
                let mut done = out.write_char('[');
                for i in 0..self.units.len() {
                    let comma = if i > 0 { "," } else { "" };
                    done = done.and_then(|()| {
                        write!(out, "{comma}{}", Weight(weight(&board.users[slot], i)))
                    });
                }
                done.and_then(|()| out.write_char(']'))
            }
            Node::Unit(slot, i) => write!(out, "[{}]", Weight(weight(&board.users[slot], i))),
            Node::Pose(slot) => {
                let [x, y, z, a, b, c, d] = board.users[slot].pose?;
                write!(out, "[{x:.5},{y:.5},{z:.5},{a:.6},{b:.6},{c:.6},{d:.6}]")
            }
            Node::Present(slot) => {
                write!(out, "[{}]", u8::from(board.users[slot].state.is_present()))
            }
            _ => return None,
        })
    }

    /// Writes a node with all below it.
    fn write(&self, node: Node, path: &str, board: &Board, out: &mut String) -> Written {
        out.write_char('{')?;
        let mut first = true;
        for which in ATTRIBUTES {
            let start = out.len();
            let comma = if first { "" } else { "," };
            write!(out, "{comma}\"{which}\":")?;
            match self.attribute(node, path, which, board, out) {
                Some(done) => {
                    done?;
                    first = false;
                }
                None => out.truncate(start),
            }
        }
        out.write_char('}')
    }

    fn host_info(&self, out: &mut String) -> Written {
        write!(
            out,
            "{{\"NAME\":{},\"OSC_TRANSPORT\":\"UDP\"",
            Quoted(&self.name)
        )?;
        if let Some(address) = self.listens {
            // Without an address the client takes the one that it asked.
            if !address.ip().is_unspecified() {
                write!(out, ",\"OSC_IP\":\"{}\"", address.ip())?;
            }
            write!(out, ",\"OSC_PORT\":{}", address.port())?;
        }
        out.write_str(
            ",\"EXTENSIONS\":{\"ACCESS\":true,\"VALUE\":true,\"RANGE\":true,\"DESCRIPTION\":true,\"TAGS\":false,\"EXTENDED_TYPE\":false,\"UNIT\":false,\"CRITICAL\":false,\"CLIPMODE\":false,\"LISTEN\":false,\"PATH_CHANGED\":false}}",
        )
    }
}

fn weight(shot: &Shot, unit: usize) -> f32 {
    shot.weights.get(unit).copied().unwrap_or(0.0)
}

impl Service for Tree {
    const WAITING: usize = TREE;
    const STAYS: bool = false;

    fn answer(&mut self, path: &str, query: Option<&str>, board: &Board, body: &mut String) -> u16 {
        // A string takes everything.
        if query == Some("HOST_INFO") {
            let _ = self.host_info(body);
            return 200;
        }
        let path = path.trim_end_matches('/');
        let Some(node) = self.find(path) else {
            return 404;
        };
        let Some(which) = query.filter(|query| !query.is_empty()) else {
            let _ = self.write(node, path, board, body);
            return 200;
        };
        if !ATTRIBUTES.contains(&which) {
            return 400;
        }
        let _ = write!(body, "{{\"{which}\":");
        if self.attribute(node, path, which, board, body).is_none() {
            body.clear();
            return 204;
        }
        body.push('}');
        200
    }

    fn next_message(&mut self, _: &mut Board, _: &mut String) -> bool {
        false
    }
}

/// Starts serving the tree of what `osc` sends and receives. `units` are the names in the order of the weights, `name` is the
/// box's.
///
/// # Errors
/// If the address is unusable or no thread can be started; not if it is in use.
pub fn open(
    settings: &ServerSettings,
    osc: &osc::Settings,
    name: &str,
    units: &[&str],
) -> Result<Front, OutputError> {
    let address = address(&settings.listen)?;
    let listens = osc.commands.then(|| osc.listen.parse().ok()).flatten();
    let tree = Tree {
        name: format!("mien {}", identity::name(name)),
        prefix: osc
            .prefix
            .split('/')
            .filter(|part| !part.is_empty())
            .map(str::to_owned)
            .collect(),
        units: units
            .iter()
            .map(|unit| osc.view.name(unit).to_owned())
            .collect(),
        floats: "f".repeat(units.len()),
        style: osc.style,
        listens,
    };
    let work = move |shared, bell| serve(tree, address, shared, bell);
    Front::start("oscquery", units, &osc.view, osc.loss, work)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree() -> Tree {
        Tree {
            name: "mien".into(),
            prefix: Box::new(["face".into()]),
            units: Box::new(["AU26".into(), "jaw".into()]),
            floats: "ff".into(),
            style: Style::Both,
            listens: Some(SocketAddr::from(([127, 0, 0, 1], 9131))),
        }
    }

    #[test]
    fn nodes_and_attributes_are_told_apart_by_their_status() {
        let mut tree = tree();
        let mut board = Board::default();
        board.users[2].weights.extend([0.25, 1.0]);
        let mut ask = |path: &str, query: Option<&str>| {
            let mut body = String::new();
            (tree.answer(path, query, &board, &mut body), body)
        };
        assert_eq!(
            ask("/face/2/au/jaw", Some("VALUE")),
            (200, "{\"VALUE\":[1.0000]}".into())
        );
        assert_eq!(
            ask("/face/2/au", Some("VALUE")),
            (200, "{\"VALUE\":[0.2500,1.0000]}".into())
        );
        assert_eq!(
            ask("/face/2/au", Some("TYPE")),
            (200, "{\"TYPE\":\"ff\"}".into())
        );
        assert_eq!(
            ask("/face/0/present", Some("RANGE")).1,
            "{\"RANGE\":[{\"VALS\":[0,1]}]}"
        );
        assert_eq!(ask("/face/0/pose", Some("VALUE")).0, 204);
        assert_eq!(ask("/face", Some("TYPE")).0, 204);
        assert_eq!(ask("/face/4", None).0, 404);
        assert_eq!(ask("/", Some("NONSENSE")).0, 400);
        let (status, leaf) = ask("/face/cmd/freeze", None);
        assert_eq!(status, 200);
        for part in [
            "\"FULL_PATH\":\"/face/cmd/freeze\"",
            "\"TYPE\":\"ii\"",
            "\"ACCESS\":2",
        ] {
            assert!(leaf.contains(part), "{leaf}");
        }
        assert!(!leaf.contains("CONTENTS") && !leaf.contains("VALUE"));
        let (_, info) = ask("/", Some("HOST_INFO"));
        assert!(
            info.contains("\"OSC_IP\":\"127.0.0.1\",\"OSC_PORT\":9131"),
            "{info}"
        );
    }

    #[test]
    fn the_whole_tree_of_the_most_units_fits() {
        let mut tree = tree();
        tree.units = (0..crate::base::capacity::UNITS)
            .map(|i| format!("{i:024}"))
            .collect();
        tree.floats = "f".repeat(tree.units.len());
        let mut body = String::new();
        assert_eq!(tree.answer("/", None, &Board::default(), &mut body), 200);
        assert!(body.len() + 300 < TREE, "{}", body.len());
        #[cfg(feature = "studio")]
        assert!(serde_json::from_str::<serde_json::Value>(&body).is_ok());
    }
}
