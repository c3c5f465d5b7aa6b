//! Modules that use only modules below them, and files that never use each other in a circle. What a crate may use stands in
//! its manifest.
//!
//! What is read: `use` declarations, and paths that begin with `crate`, `super` or a file beside. A `mod.rs` that hands
//! on what a file of its folder has uses that file; a file that takes something by its folder's name uses the `mod.rs`. Tests
//! inside files may use what they like.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// The crates below `src`.
const CRATES: [&str; 10] = [
    "stages",
    "sensors",
    "simulator",
    "outputs",
    "appliance",
    "workbench",
    "linear",
    "baking",
    "training",
    "studio",
];

/// The modules of the stages, from the ground up: each uses those before it in this list.
const STAGES: [&str; 10] = [
    "base",
    "frame",
    "turn",
    "camera",
    "segment",
    "pose",
    "face_model",
    "landmarks",
    "expression",
    "users",
];

/// A crate, and the module in it.
pub(crate) type Module = Vec<String>;
type Uses = BTreeMap<Module, BTreeSet<Module>>;

fn source() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// Every file of the crates by its module, but those that are tests.
pub(crate) fn files() -> BTreeMap<Module, String> {
    fn walk(folder: &Path, module: &Module, files: &mut BTreeMap<Module, String>) {
        for entry in fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
            let inside = || [module.as_slice(), std::slice::from_ref(&name)].concat();
            if path.is_dir() {
                walk(&path, &inside(), files);
            } else if path.extension().is_some_and(|kind| kind == "rs") {
                let text = fs::read_to_string(&path).expect("a source file");
                match name.as_str() {
                    "main" | "build" | "mien-studio" => None,
                    "mod" | "lib" => files.insert(module.clone(), text),
                    _ => files.insert(inside(), text),
                };
            }
        }
    }
    let mut files = BTreeMap::new();
    walk(&source(), &Module::new(), &mut files);
    let mut tests = Vec::new();
    for (module, text) in &files {
        for after in text.split("#[cfg(test)]\n").skip(1) {
            let line = after.lines().next().unwrap_or_default();
            if let Some(name) = line.trim().strip_suffix(';')
                && let Some(name) = name.rsplit("mod ").next()
            {
                tests.push([module.as_slice(), &[name.to_owned()]].concat());
            }
        }
    }
    // Those in folders named so are tests too.
    files.retain(|module, _| !tests.contains(module) && module.iter().all(|name| name != "tests"));
    files
}

/// A file without the tests at its end.
pub(crate) fn without_tests(text: &str) -> &str {
    let end = text.find("#[cfg(test)]\nmod tests {");
    let end = end.or_else(|| text.find("#[cfg(test)]\npub(crate) mod tests {"));
    &text[..end.unwrap_or(text.len())]
}

/// A file without comments, and without the tests at its end.
fn code(text: &str) -> String {
    without_tests(text)
        .lines()
        .map(|line| line.split("//").next().unwrap_or_default())
        .collect::<Vec<_>>()
        .join("\n")
}

/// The paths of a `use` tree, one by one.
fn branches(tree: &str, before: &str, paths: &mut Vec<String>) {
    let Some(open) = tree.find('{') else {
        return paths.push(format!("{before}{}", tree.trim()));
    };
    let close = tree.rfind('}').expect("a closed tree");
    let before = format!("{before}{}", tree[..open].trim());
    let (mut depth, mut start) = (0, open + 1);
    for (at, letter) in tree
        .char_indices()
        .take_while(|(at, _)| *at < close)
        .skip(open + 1)
    {
        match letter {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                branches(&tree[start..at], &before, paths);
                start = at + 1;
            }
            _ => {}
        }
    }
    if !tree[start..close].trim().is_empty() {
        branches(&tree[start..close], &before, paths);
    }
}

/// All paths that a file names.
fn paths(code: &str) -> Vec<String> {
    let mut paths = Vec::new();
    let mut rest = String::new();
    let is_use = |line: &str| {
        let line = line.trim_start();
        let line = line.strip_prefix("pub ").unwrap_or(line);
        let line = match line.strip_prefix("pub(") {
            Some(line) => line.split_once(") ").map_or(line, |(_, line)| line),
            None => line,
        };
        line.strip_prefix("use ").map(str::to_owned)
    };
    let mut lines = code.lines();
    while let Some(line) = lines.next() {
        let Some(mut tree) = is_use(line) else {
            rest.push_str(line);
            rest.push('\n');
            continue;
        };
        while !tree.contains(';') {
            tree.push_str(lines.next().expect("a whole use"));
        }
        branches(tree.trim_end_matches([';', ' ']), "", &mut paths);
    }
    let letter = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    let words = rest.split(|c: char| !letter(c));
    paths.extend(words.filter(|word| word.contains("::")).map(str::to_owned));
    paths
}

/// Who uses whom, file by file.
fn uses() -> Uses {
    let files = files();
    let mut uses = Uses::new();
    for (module, text) in files.iter().filter(|(module, _)| !module.is_empty()) {
        let used = uses.entry(module.clone()).or_default();
        for path in paths(&code(text)) {
            let words: Vec<&str> = path.split("::").map(str::trim).collect();
            let mut words = words.as_slice();
            let mut at = match words[0] {
                "crate" => module[..1].to_vec(),
                "super" | "self" => module.clone(),
                child if files.contains_key(&[module.as_slice(), &[child.into()]].concat()) => {
                    module.clone()
                }
                _ => continue,
            };
            while let Some(first) = words.first() {
                match *first {
                    "super" => drop(at.pop()),
                    "crate" | "self" => {}
                    _ => break,
                }
                words = &words[1..];
            }
            for word in words {
                let word = word.split(" as ").next().unwrap_or_default();
                at.push(word.to_owned());
                if !files.contains_key(&at) {
                    at.pop();
                    break;
                }
            }
            if at != *module && files.contains_key(&at) {
                used.insert(at);
            }
        }
    }
    uses
}

pub(crate) fn name(module: &Module) -> String {
    module.join("::")
}

#[test]
fn the_source_folder_shows_its_crates_and_nothing_else() {
    let mut found: Vec<String> = fs::read_dir(source())
        .expect("a folder")
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    found.sort();
    let mut expected: Vec<&str> = CRATES
        .iter()
        .chain(&["lib.rs", "main.rs", "bin", "build.rs"])
        .copied()
        .collect();
    expected.sort_unstable();
    assert_eq!(found, expected);
}

#[test]
fn a_stage_uses_only_stages_below_it() {
    let floor = |module: &Module| {
        let inside = module.get(1).filter(|_| module[0] == "stages");
        STAGES
            .iter()
            .position(|stage| Some(*stage) == inside.map(String::as_str))
    };
    let mut wrong = Vec::new();
    let uses = uses();
    for (module, used) in uses.iter().filter(|(module, _)| floor(module).is_some()) {
        for other in used.iter().filter(|other| floor(other) > floor(module)) {
            wrong.push(format!("{} uses {}", name(module), name(other)));
        }
    }
    assert!(
        uses.values().map(BTreeSet::len).sum::<usize>() > 700,
        "uses are seen"
    );
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn no_two_files_use_each_other_however_far_around() {
    let uses = uses();
    // What is left when files that use nothing of the rest are taken away again and again are circles, and who uses them.
    let mut left = uses.clone();
    loop {
        let done: BTreeSet<Module> = left
            .iter()
            .filter(|(_, used)| !used.iter().any(|other| left.contains_key(other)))
            .map(|(module, _)| module.clone())
            .collect();
        if done.is_empty() {
            break;
        }
        left.retain(|module, _| !done.contains(module));
    }
    // The other way round, those who are only using them.
    loop {
        let used: BTreeSet<Module> = left.values().flatten().cloned().collect();
        let before = left.len();
        left.retain(|module, _| used.contains(module));
        if left.len() == before {
            break;
        }
    }
    let circles: Vec<String> = left
        .iter()
        .map(|(module, used)| {
            let inside = used.iter().filter(|other| left.contains_key(*other));
            format!(
                "{} → {}",
                name(module),
                inside.map(name).collect::<Vec<_>>().join(", ")
            )
        })
        .collect();
    assert!(circles.is_empty(), "{circles:#?}");
}
