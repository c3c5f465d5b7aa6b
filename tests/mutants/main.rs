//! Draws places, compiles a copy of the workspace in which each is changed while `MUTANT` is its number, and runs the tests on
//! one after the other. What does not compile is left out.

mod places;

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader, Write};
use std::ops::Range;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};
use std::{env, fs};

/// Where mutants are drawn, how many, and the tests of whole programs that are about it.
struct Room {
    package: &'static str,
    folder: &'static str,
    mutants: usize,
    promises: &'static [&'static str],
}

#[rustfmt::skip]
const ROOMS: [Room; 8] = [
    Room { package: "stages", folder: "pose", mutants: 76, promises: &["tracks_a_head", "follows_several_people", "plays_what_others_recorded"] },
    Room { package: "stages", folder: "landmarks", mutants: 54, promises: &["tracks_a_head", "sees_nobody"] },
    Room { package: "stages", folder: "expression", mutants: 76, promises: &["learns_a_range", "tracks_a_head"] },
    Room { package: "stages", folder: "segment", mutants: 22, promises: &["follows_several_people", "tracks_a_head"] },
    Room { package: "stages", folder: "face_model", mutants: 11, promises: &["refuses_bad_input"] },
    Room { package: "stages", folder: "users", mutants: 11, promises: &["follows_several_people", "remembers_people"] },
    Room { package: "sensors", folder: "", mutants: 44, promises: &["drives_a_kinect", "records_and_replays", "plays_any_depth_camera"] },
    Room { package: "baking", folder: "bake", mutants: 44, promises: &["opens_joined_lips"] },
];

const COPY: &str = "target/mutants/copy";
const OUTCOMES: &str = "target/mutants/outcomes.tsv";
/// Tests that compare with recorded tables.
const TABLES: &str = "golden";

const SWITCH: &str = "
/// Whether this mutant is the one of this process.
#[inline]
pub fn mutant(id: u32) -> bool {
    static WANTED: std::sync::LazyLock<Option<u32>> =
        std::sync::LazyLock::new(|| std::env::var(\"MUTANT\").ok()?.parse().ok());
    *WANTED == Some(id)
}
";

struct Mutant {
    id: usize,
    room: usize,
    file: PathBuf,
    line: usize,
    range: Range<usize>,
    instead: String,
    was: String,
}

fn main() {
    let mut arguments = env::args()
        .skip(1)
        .map(|n| n.parse::<usize>().expect("a number"));
    let seed = arguments.next().expect("a seed");
    let wanted: BTreeSet<_> = arguments.collect();
    let mut mutants = draw(seed as u64);
    let programs = build(&mut mutants);
    let mut full = BTreeMap::new();
    let mut tally = BTreeMap::new();
    let mut outcomes = fs::File::options()
        .create(true)
        .append(true)
        .open(OUTCOMES)
        .expect(OUTCOMES);
    for mutant in &mutants {
        if !wanted.is_empty() && !wanted.contains(&mutant.id) {
            continue;
        }
        let room = &ROOMS[mutant.room];
        let outcome = judge(mutant, &programs, &mut full);
        let by = outcome.split(' ').next().unwrap_or_default().to_owned();
        *tally.entry((mutant.room, by)).or_insert(0) += 1;
        let (file, line) = (mutant.file.display(), mutant.line);
        let change = format!("{} => {}", mutant.was, mutant.instead)
            .split_whitespace()
            .collect::<Vec<_>>()
            .join(" ");
        let row = format!(
            "{}\t{} {}\t{file}:{line}\t{outcome}\t{change}",
            mutant.id, room.package, room.folder
        );
        println!("{row}");
        writeln!(outcomes, "{row}").expect(OUTCOMES);
    }
    for ((room, by), count) in tally {
        println!(
            "{} {}\t{by}\t{count}",
            ROOMS[room].package, ROOMS[room].folder
        );
    }
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder").flatten() {
        let path = entry.path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs")
            && !path.to_string_lossy().contains("tests")
        {
            found.push(path);
        }
    }
}

/// The same places for the same seed and code, spread evenly over the files of a room.
fn draw(seed: u64) -> Vec<Mutant> {
    let mut mutants = Vec::<Mutant>::new();
    for (number, room) in ROOMS.iter().enumerate() {
        let mut random = fastrand::Rng::with_seed(seed + number as u64);
        let mut files = Vec::new();
        sources(
            &Path::new("src").join(room.package).join(room.folder),
            &mut files,
        );
        files.sort();
        random.shuffle(&mut files);
        let mut piles: Vec<_> = files
            .into_iter()
            .map(|file| {
                let text = fs::read_to_string(&file).expect("a source");
                let mut pile = places::of(&text);
                random.shuffle(&mut pile);
                (file, text, pile)
            })
            .collect();
        let end = mutants.len() + room.mutants;
        while mutants.len() < end && piles.iter().any(|pile| !pile.2.is_empty()) {
            for (file, text, pile) in &mut piles {
                let apart = |place: &places::Place| {
                    mutants.iter().filter(|m| m.file == *file).all(|m| {
                        m.range.end <= place.range.start || place.range.end <= m.range.start
                    })
                };
                while let Some(place) = pile.pop() {
                    if apart(&place) && mutants.len() < end {
                        mutants.push(Mutant {
                            id: mutants.len(),
                            room: number,
                            file: file.clone(),
                            line: text[..place.range.start].lines().count(),
                            was: text[place.range.clone()].to_owned(),
                            range: place.range,
                            instead: place.instead,
                        });
                        break;
                    }
                }
            }
        }
    }
    mutants
}

/// The workspace as it is, with the switch in each crate that has mutants.
fn copy() {
    let copy =
        format!("mkdir -p {COPY} && tar c --exclude=./target --exclude=./.git . | tar x -C {COPY}");
    assert!(
        Command::new("sh")
            .args(["-c", &copy])
            .status()
            .expect("sh")
            .success()
    );
    for package in ["stages", "sensors", "baking"] {
        let lib = Path::new(COPY).join("src").join(package).join("lib.rs");
        let text = fs::read_to_string(&lib).expect("lib.rs");
        fs::write(lib, text + SWITCH).expect("lib.rs");
    }
}

/// Writes each file with all its mutants in it; returns where each ended up.
fn write(mutants: &[Mutant]) -> Vec<(usize, PathBuf, Range<usize>)> {
    let mut at = Vec::new();
    let files: BTreeSet<_> = mutants.iter().map(|m| &m.file).collect();
    for file in files {
        let text = fs::read_to_string(file).expect("a source");
        let mut here: Vec<_> = mutants.iter().filter(|m| m.file == *file).collect();
        here.sort_by_key(|m| m.range.start);
        let (mut out, mut copied) = (String::new(), 0);
        for m in here {
            out += &text[copied..m.range.start];
            let start = out.len();
            out += &format!(
                "(if crate::mutant({}) {{ {} }} else {{ {} }})",
                m.id, m.instead, m.was
            );
            at.push((m.id, file.clone(), start..out.len()));
            copied = m.range.end;
        }
        out += &text[copied..];
        fs::write(Path::new(COPY).join(file), out).expect("a copy");
    }
    at
}

/// The test programs by package, `it` among them.
fn build(mutants: &mut Vec<Mutant>) -> BTreeMap<String, PathBuf> {
    let all = "test --locked --no-run --lib --test it -p mien -p mien-stages -p mien-sensors -p mien-baking --message-format=json --target-dir";
    let target = env::current_dir()
        .expect("a folder")
        .join("target/mutants/target");
    loop {
        copy();
        let at = write(mutants);
        let mut cargo = Command::new("cargo");
        cargo
            .args(all.split(' '))
            .arg(&target)
            .current_dir(COPY)
            .env_remove("MUTANT");
        let output = cargo.stderr(Stdio::inherit()).output().expect("cargo");
        let (mut programs, mut wrong, mut errors) =
            (BTreeMap::new(), BTreeSet::new(), String::new());
        for line in output.stdout.split(|&byte| byte == b'\n') {
            let Ok(json) = serde_json::from_slice::<serde_json::Value>(line) else {
                continue;
            };
            if let Some(program) = json["executable"]
                .as_str()
                .filter(|_| json["profile"]["test"] == true)
            {
                programs.insert(
                    json["target"]["name"]
                        .as_str()
                        .unwrap_or_default()
                        .to_owned(),
                    program.into(),
                );
            }
            if json["message"]["level"] == "error" {
                errors += json["message"]["rendered"].as_str().unwrap_or_default();
                for span in json["message"]["spans"].as_array().into_iter().flatten() {
                    let byte = span["byte_start"].as_u64().unwrap_or_default() as usize;
                    let file = span["file_name"].as_str().unwrap_or_default();
                    wrong.extend(
                        at.iter()
                            .filter(|(_, of, range)| of == Path::new(file) && range.contains(&byte))
                            .map(|place| place.0),
                    );
                }
            }
        }
        if output.status.success() {
            return programs;
        }
        assert!(!wrong.is_empty(), "no mutant is to blame:\n{errors}");
        println!("do not compile: {wrong:?}");
        mutants.retain(|m| !wrong.contains(&m.id));
    }
}

/// Who notices a mutant: `own`, `table` or `none`, with the test's name.
fn judge(
    mutant: &Mutant,
    programs: &BTreeMap<String, PathBuf>,
    full: &mut BTreeMap<&str, Duration>,
) -> String {
    let room = &ROOMS[mutant.room];
    let lib = &programs[&format!("mien_{}", room.package)];
    let folder = Path::new(COPY).join("src").join(room.package);
    let all = ["--skip", TABLES];
    let limit = 5 * *full.entry(room.package).or_insert_with(|| {
        let start = Instant::now();
        let failed = run(lib, &folder, &all, None, Duration::from_secs(3600));
        assert_eq!(failed, None, "without a mutant");
        println!("{} without a mutant: {:?}", room.package, start.elapsed());
        start.elapsed()
    }) + Duration::from_secs(20);
    let id = Some(mutant.id);
    // The module's own tests first, because they are the quickest to notice.
    let module = mutant
        .file
        .with_extension("")
        .to_string_lossy()
        .splitn(3, '/')
        .nth(2)
        .expect("a module")
        .replace('/', "::");
    let module = module.trim_end_matches("::mod").to_owned() + "::";
    for filter in [&[module.as_str(), all[0], all[1]][..], &all] {
        if let Some(test) = run(lib, &folder, filter, id, limit) {
            return format!("own {test}");
        }
    }
    for promise in room.promises {
        let limit = Duration::from_secs(600);
        if let Some(test) = run(&programs["it"], Path::new(COPY), &[promise], id, limit) {
            return format!("own {test}");
        }
    }
    let table = run(lib, &folder, &[TABLES], id, limit);
    table.map_or("none".to_owned(), |test| format!("table {test}"))
}

/// Runs tests until one fails; its name, or what else went wrong.
fn run(
    program: &Path,
    folder: &Path,
    filter: &[&str],
    id: Option<usize>,
    limit: Duration,
) -> Option<String> {
    let temporary = env::current_dir()
        .expect("a folder")
        .join("target/mutants/tmp");
    let _ = fs::remove_dir_all(&temporary);
    fs::create_dir_all(&temporary).expect("a temporary folder");
    let mut command = Command::new(program);
    command
        .args(filter)
        .current_dir(folder)
        .env("TMPDIR", &temporary);
    command.env(
        "CARGO_MANIFEST_DIR",
        fs::canonicalize(folder).expect("a folder"),
    );
    if let Some(id) = id {
        command.env("MUTANT", id.to_string());
    }
    command
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .stdin(Stdio::null())
        .process_group(0);
    let mut child = command.spawn().expect("a test program");
    let lines = BufReader::new(child.stdout.take().expect("its output")).lines();
    let (send, receive) = channel();
    std::thread::spawn(move || {
        lines
            .map_while(Result::ok)
            .try_for_each(|line| send.send(line))
    });
    let end = Instant::now() + limit;
    let failed = loop {
        match receive.recv_timeout(end.saturating_duration_since(Instant::now())) {
            Ok(line) if line.ends_with("... FAILED") => {
                break line.split_whitespace().nth(1).map(str::to_owned);
            }
            Ok(_) => {}
            Err(RecvTimeoutError::Timeout) => break Some("timeout".to_owned()),
            Err(RecvTimeoutError::Disconnected) => {
                let ended = child.wait().expect("a test program");
                break (!ended.success()).then(|| format!("crash:{ended}").replace(' ', "_"));
            }
        }
    };
    // The programs that a test has started, too.
    let _ = Command::new("kill")
        .args(["-9", "--", &format!("-{}", child.id())])
        .stderr(Stdio::null())
        .status();
    let _ = child.wait();
    failed
}
