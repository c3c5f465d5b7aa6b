//! Promise: what the README and the documents tell a reader to type works as it stands, what they quote from the log is in
//! the log, what they point to is there, and the README is short.
//!
//! Every line of every `sh` block is run in order in one folder, as one reader would. What runs until it is stopped is stopped
//! after it has spoken. What builds and installs is not run; what trains or evaluates on data sets must
//! say where they are described.
#![cfg(feature = "studio")]

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use mien_appliance::settings::Settings;

/// Documents with commands, in the order of a reader who reads all.
const DOCUMENTS: [&str; 12] = [
    "README.md",
    "docs/receivers.md",
    "docs/examples/README.md",
    "docs/box.md",
    "docs/baking.md",
    "docs/workstation.md",
    "docs/recordings.md",
    "docs/results.md",
    "docs/data.md",
    "docs/paper.md",
    "docs/limits.md",
    "docs/troubleshooting.md",
];
/// Lines of the README, at most: what does not fit belongs into a document.
const README_LINES: usize = 140;
/// Where the commands of the documents expect the data sets, which the reader here does not have.
const DATA: &str = "../shared/data";
/// Commands of others, or of this very run.
const NOT_OURS: [&str; 10] = [
    "cargo",
    "sudo",
    "git",
    "node",
    "python",
    "cd",
    "npm",
    "apt",
    "export",
    "sha256sum",
];
/// Enough for the slowest to speak.
const PATIENCE: Duration = Duration::from_secs(300);

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn text(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap()
}

/// Lines of the `sh` blocks, without comments.
fn commands(document: &str) -> Vec<String> {
    let mut inside = false;
    let mut out = Vec::new();
    for line in document.lines() {
        match line.trim() {
            "```sh" => inside = true,
            "```" => inside = false,
            line if inside => {
                let line = line.split(" #").next().unwrap().trim();
                if !line.is_empty() && !line.starts_with('#') {
                    out.push(line.to_owned());
                }
            }
            _ => {}
        }
    }
    out
}

/// The folder the reader works in; the programs are found, the data are where the README says they are.
struct Reader {
    folder: tempfile::TempDir,
    path: std::ffi::OsString,
}

impl Reader {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let link = |name: &str| {
            let to = folder.path().join("mien").join(name);
            std::os::unix::fs::symlink(root().join(name), to).unwrap();
        };
        std::fs::create_dir(folder.path().join("mien")).unwrap();
        ["config", "docs", "tests", "systemd"]
            .into_iter()
            .for_each(link);
        // What `train` would have written.
        let model = folder.path().join("mien/face.model");
        std::os::unix::fs::symlink(root().join("config/face.model"), model).unwrap();
        let programs = Path::new(env!("CARGO_BIN_EXE_mien")).parent().unwrap();
        let mut path = programs.as_os_str().to_owned();
        path.push(":");
        path.push(std::env::var_os("PATH").unwrap_or_default());
        Self { folder, path }
    }

    /// The avatar that a reader has: here our own head under another name.
    fn bring_avatar(&self) {
        for line in [
            "mien-studio head --out avatar.glb",
            "mv avatar.glb avatar.vrm",
            "mien-studio head --out avatar.obj",
            "mv avatar.txt avatar68.txt",
        ] {
            self.run(line);
        }
    }

    fn home(&self) -> PathBuf {
        self.folder.path().join("mien")
    }

    fn start(&self, line: &str) -> Child {
        Command::new("sh")
            .args(["-c", &format!("exec {line}")])
            .current_dir(self.home())
            .env("PATH", &self.path)
            .env_remove("MIEN_DATA")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    }

    /// Runs to the end and must succeed.
    fn run(&self, line: &str) {
        let out = self.start(line).wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.success(), "{line}: {said}");
    }

    /// Starts what does not end, waits for its first words, and ends it.
    fn speak(&self, line: &str) {
        use std::io::BufRead;
        let mut child = self.start(line);
        let (to, from) = std::sync::mpsc::channel();
        let out = std::io::BufReader::new(child.stdout.take().unwrap());
        std::thread::spawn(move || {
            for line in out.lines() {
                let _ = to.send(line);
            }
        });
        let first = from.recv_timeout(PATIENCE);
        // To the process that was started, and no other.
        let term = Command::new("kill").arg(child.id().to_string()).status();
        assert!(term.unwrap().success(), "{line} ended by itself");
        let start = Instant::now();
        let status = loop {
            match child.try_wait().unwrap() {
                Some(status) => break status,
                None if start.elapsed() < PATIENCE => {
                    std::thread::sleep(Duration::from_millis(20));
                }
                None => panic!("{line} does not end when told to"),
            }
        };
        let spoke = matches!(&first, Ok(Ok(line)) if !line.trim().is_empty());
        assert!(spoke, "{line} says nothing");
        // The box ends in order; the page has nothing to put in order.
        assert!(
            status.success() || line.contains("preview") || line.contains("place"),
            "{line}: {status}"
        );
    }
}

/// A command without the data that it wants ends with one sentence that points to the page about them. Unknown options would
/// end it otherwise.
fn points_to_the_data(reader: &Reader, line: &str) {
    let out = reader.start(line).wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{line}: {said}");
    assert!(said.contains("docs/data.md"), "{line}: {said}");
    assert_eq!(said.trim().lines().count(), 1, "{line}: {said}");
}

#[test]
fn every_command_of_the_documents_works_as_it_stands() {
    let reader = Reader::new();
    reader.bring_avatar();
    let mut done = [0; 3];
    let mut seen: Vec<String> = Vec::new();
    // It takes half a minute and uses no processor: it runs beside the others.
    let mut sweeps = Vec::new();
    for line in DOCUMENTS.iter().flat_map(|path| commands(&text(path))) {
        if seen.contains(&line) {
            continue;
        }
        seen.push(line.clone());
        let words: Vec<&str> = line.split_whitespace().collect();
        if NOT_OURS.contains(&words[0]) || words[0].contains('/') {
            println!("not run: {line}");
            done[2] += 1;
            continue;
        }
        let command = words.get(1).copied().unwrap_or_default();
        if line.contains(DATA) {
            points_to_the_data(&reader, &line);
            done[1] += 1;
            continue;
        }
        let endless = command == "preview"
            || command == "place"
            || command == "run" && !line.contains("--frames") && !line.contains("--fast");
        println!("{line}");
        let start = Instant::now();
        match command {
            // A port that another test may have, and no second one on it.
            "preview" => reader.speak(&format!("{line} --port 0{}", other_port(&line))),
            "place" => reader.speak(&format!("{line} --port 0")),
            // Off a terminal it says nothing on its own: the table does.
            "run" if endless => reader.speak(&format!("{line} --csv -")),
            "send-test" => sweeps.push(reader.start(&line)),
            // What it measures in hundreds of frames it says after some as well.
            "bench" => reader.run(&format!("{line} --frames 20")),
            // What reports trouble with this machine says so in its exit code.
            "doctor" | "devices" => drop(reader.start(&line).wait_with_output()),
            _ => reader.run(&line),
        }
        println!("    {:.1} s", start.elapsed().as_secs_f64());
        done[0] += 1;
    }
    for sweep in sweeps {
        assert!(sweep.wait_with_output().unwrap().status.success());
    }
    let [run, words, not] = done;
    println!("{run} run, {words} without their data, {not} not ours");
    assert!(run >= 12, "only {run} commands were found");
}

/// OSC at a free port, for a preview that would take the standard one.
fn other_port(line: &str) -> &'static str {
    let named = ["--osc", "--csv", "--serial", "--source"];
    if named.iter().any(|option| line.contains(option)) {
        ""
    } else {
        " --osc 0"
    }
}

/// The heading's anchor as Markdown on the web makes it.
fn anchor(heading: &str) -> String {
    let words = heading.trim_start_matches('#').trim().to_lowercase();
    let kept = words
        .chars()
        .filter(|&c| c.is_alphanumeric() || " -_".contains(c));
    kept.collect::<String>().replace(' ', "-")
}

/// Every page below a folder.
fn pages(folder: &Path, all: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            pages(&path, all);
        } else if path.extension().is_some_and(|end| end == "md") {
            all.push(path);
        }
    }
}

/// Fails unless a page's link leads to a file or a heading below `tree`.
fn leads_somewhere(tree: &Path, page: &Path, link: &str) {
    let (file, part) = link.split_once('#').unwrap_or((link, ""));
    let to = match file {
        "" => page.to_owned(),
        file => page.parent().unwrap().join(file),
    };
    let name = page.strip_prefix(tree).unwrap().display();
    let to = to.canonicalize();
    let to = to.unwrap_or_else(|_| panic!("{name} points to {link}, which is not installed"));
    assert!(to.starts_with(tree), "{name}: {link} leads out of the tree");
    let headings = |text: String| {
        text.lines()
            .any(|line| line.starts_with('#') && anchor(line) == part)
    };
    assert!(
        part.is_empty() || headings(std::fs::read_to_string(&to).unwrap()),
        "{name} points to {link}: no such heading"
    );
}

#[test]
fn what_the_installed_documents_point_to_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let lays = Command::new(root().join("systemd/deb/documents"))
        .arg(folder.path())
        .status();
    assert!(lays.unwrap().success());
    let tree = folder.path().canonicalize().unwrap();
    let mut all = Vec::new();
    pages(&tree, &mut all);
    let mut links = 0;
    for page in &all {
        let whole = std::fs::read_to_string(page).unwrap();
        for link in whole.split("](").skip(1) {
            let link = link.split(')').next().unwrap();
            if !link.contains("://") {
                leads_somewhere(&tree, page, link);
                links += 1;
            }
        }
        // Files that are named in passing: scripts, sketches, tables. Those of docs are installed, the others are in the sources;
        // data.md names files of others.
        if page.ends_with("docs/data.md") {
            continue;
        }
        for name in whole.split('`').skip(1).step_by(2) {
            let name = name.split_whitespace().next().unwrap_or_default();
            let ours = ["tests/", "config/", "systemd/", "src/"];
            let there = match name.starts_with("docs/") {
                true => tree.join(name).exists(),
                false => {
                    !ours.iter().any(|folder| name.starts_with(folder))
                        || root().join(name).exists()
                }
            };
            assert!(there, "{}: no {name}", page.display());
        }
    }
    assert!(links > 60, "only {links} links were found");
    for sketch in ["mien_receiver", "mien_servo_face"] {
        let header = tree.join("docs/examples").join(sketch).join("mien.h");
        assert!(header.is_file(), "the sketch {sketch} lacks its mien.h");
    }
}

#[test]
fn every_data_set_that_a_test_can_name_is_described() {
    let page = text("docs/data.md");
    let names = include_str!("../common/data.rs").split("=> \"").skip(1);
    let names: Vec<&str> = names.map(|rest| rest.split('"').next().unwrap()).collect();
    assert!(names.len() > 10, "{names:?}");
    for name in names {
        assert!(page.matches(&format!("`{name}`")).count() >= 3, "{name}");
    }
}

#[test]
fn every_configuration_in_the_documents_is_accepted() {
    let mut blocks = 0;
    // What this build refuses is not in its documents.
    let gestures = mien_outputs::gesture::ENABLED.then_some(&"docs/gestures.md");
    for document in DOCUMENTS.iter().chain(&["docs/fleet.md"]).chain(gestures) {
        let whole = text(document);
        for block in whole.split("```toml\n").skip(1) {
            let block = block.split("```").next().unwrap();
            if let Err(error) = Settings::parse(block, Path::new(document)) {
                panic!("{error}\n{block}");
            }
            blocks += 1;
        }
    }
    assert!(blocks > 5, "only {blocks} were found");
}

#[test]
fn the_readme_is_short() {
    let lines = text("README.md").lines().count();
    assert!(
        lines <= README_LINES,
        "README.md has {lines} lines, {README_LINES} are allowed"
    );
}

#[test]
fn what_is_quoted_from_the_log_is_in_the_source() {
    fn sources(folder: &Path, all: &mut String) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                sources(&path, all);
            } else if let Ok(text) = std::fs::read_to_string(&path) {
                all.push_str(&text);
            }
        }
    }
    let mut all = String::new();
    sources(&root().join("src"), &mut all);
    let document = text("docs/troubleshooting.md");
    let mut quoted = 0;
    for line in document.lines().filter(|line| line.starts_with("| `")) {
        let cell = line.split('|').nth(1).unwrap();
        for quote in cell.split('`').skip(1).step_by(2) {
            assert!(all.contains(quote), "{quote:?} is nowhere in src");
            quoted += 1;
        }
    }
    assert!(quoted > 25, "only {quoted} quotes were found");
}
