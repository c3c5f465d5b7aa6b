//! No function is longer than a page, unless a line of its doc comment that begins with "Long because" says why.
//!
//! Lines are counted from `fn` to the brace that closes it, as `cargo fmt` lays them out. Tests inside files may be longer.

use crate::keeps_its_modules_apart::{files, name, without_tests};

/// Lines of a function.
const MOST: usize = 80;

/// A function: its name, its first line counted from 1, its lines, and whether it says why it is long.
#[derive(Debug, PartialEq)]
struct Function {
    name: String,
    line: usize,
    lines: usize,
    says_why: bool,
}

/// The name of the function that a line begins.
fn begins(line: &str) -> Option<&str> {
    let mut words = line.trim_start();
    loop {
        if let Some(rest) = words.strip_prefix("fn ") {
            let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_')?;
            return Some(&rest[..end]);
        }
        let (word, rest) = words.split_once(' ')?;
        let before = ["pub", "const", "unsafe", "async", "extern", "\"C\""];
        if !before.contains(&word) && !word.starts_with("pub(") {
            return None;
        }
        words = rest;
    }
}

/// All functions with a body.
fn functions(text: &str) -> Vec<Function> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    for (at, line) in lines.iter().enumerate() {
        let Some(name) = begins(line) else { continue };
        let indent = line.len() - line.trim_start().len();
        let closing = format!("{}}}", &line[..indent]);
        let signature = lines[at..]
            .iter()
            .position(|line| line.ends_with(['{', '}', ';']))
            .expect("an end of the signature");
        let length = match lines[at + signature].chars().last() {
            Some('{') => lines[at..]
                .iter()
                .position(|line| *line == closing)
                .expect("a closing brace"),
            _ => signature,
        };
        let above = lines[..at].iter().rev();
        let mut above = above.take_while(|line| {
            let line = line.trim_start();
            line.starts_with("///")
                || line.starts_with("#[")
                || line.ends_with([',', ']', '(', '"'])
        });
        found.push(Function {
            name: name.to_owned(),
            line: at + 1,
            lines: length + 1,
            says_why: above.any(|line| line.trim_start().starts_with("/// Long because ")),
        });
    }
    found
}

#[test]
fn functions_are_seen_with_their_lengths_and_reasons() {
    let text = "trait A {\n    fn a(&self)\n    -> u8;\n}\n\n/// Does b.\n///\n/// Long because it is.\n#[inline]\npub(crate) const fn b(\n    x: u8,\n) {\n    {\n    }\n}\n\nfn c() {}\n";
    let function = |name: &str, line, lines, says_why| Function {
        name: name.to_owned(),
        line,
        lines,
        says_why,
    };
    let expected = [
        function("a", 2, 2, false),
        function("b", 10, 6, true),
        function("c", 17, 1, false),
    ];
    assert_eq!(functions(text), expected);
}

#[test]
fn a_long_function_says_why() {
    let mut long = Vec::new();
    let mut seen = 0;
    for (module, text) in files() {
        for one in functions(without_tests(&text)) {
            seen += 1;
            if one.lines > MOST && !one.says_why {
                let (
                    file,
                    Function {
                        name, line, lines, ..
                    },
                ) = (name(&module), &one);
                long.push(format!("{file}, line {line}: {name} has {lines} lines"));
            }
        }
    }
    assert!(seen > 2000, "functions are seen: {seen}");
    assert!(
        long.is_empty(),
        "longer than {MOST} lines; cut at a seam, or say why after \"Long because\": {long:#?}"
    );
}
