//! [`compare_with_golden`] and [`equals_golden`] compare lines with a table in `tests/golden`.

use std::fmt::Write as _;

/// Numbers are whole, and may differ by one: other processors round otherwise.
const WITHIN: f64 = 1.0;
/// One line in this many may differ.
const ONE_IN: usize = 25;

/// Compares lines with the table of this name, or writes it.
pub(crate) fn compare_with_golden(name: &str, lines: &[String]) {
    compare(name, lines, lines.len() / ONE_IN);
}

/// The same, and no line may differ.
#[allow(dead_code, reason = "some crates use one of them")]
pub(crate) fn equals_golden(name: &str, lines: &[String]) {
    compare(name, lines, 0);
}

fn compare(name: &str, lines: &[String], may_differ: usize) {
    let folder = super::data::root().join("tests/golden");
    let path = folder.join(format!("{name}.txt"));
    if std::env::var_os("MIEN_WRITE_GOLDEN").is_some() {
        std::fs::write(&path, lines.join("\n") + "\n").unwrap();
        return;
    }
    let golden = std::fs::read_to_string(&path).unwrap_or_default();
    let golden: Vec<&str> = golden.lines().collect();
    assert_eq!(golden.len(), lines.len(), "{name}: lines");
    let alike = |was: &str, is: &str| {
        let number = |word: &str| word.parse::<f64>().ok();
        let near = |was, is| Some((number(was)? - number(is)?).abs() <= WITHIN);
        let same = |(was, is)| was == is || near(was, is) == Some(true);
        let words = was.split(' ').zip(is.split(' '));
        was.split(' ').count() == is.split(' ').count() && words.into_iter().all(same)
    };
    let pairs = golden.iter().zip(lines);
    let apart: Vec<_> = pairs.filter(|(was, is)| !alike(was, is)).collect();
    let mut first = String::new();
    for (was, is) in apart.iter().take(5) {
        write!(first, "\n  was {was}\n  is  {is}").unwrap();
    }
    assert!(
        apart.len() <= may_differ,
        "{name}: {} of {} lines differ; if intended, MIEN_WRITE_GOLDEN=1 rewrites them{first}",
        apart.len(),
        lines.len()
    );
}
