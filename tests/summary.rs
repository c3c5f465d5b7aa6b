//! The last lines of `cargo test`: the tests that were left out and the data that they want. Cargo runs test programs by
//! name, so this one comes after `it` and `memory`.
#![expect(
    clippy::print_stdout,
    reason = "it reports to the reader of the test run"
)]

use std::collections::{BTreeMap, BTreeSet};

#[path = "common/data.rs"]
#[expect(dead_code, reason = "the list alone is read here")]
mod data;

fn main() {
    let list = data::left_out_list();
    let lines = std::fs::read_to_string(&list).unwrap_or_default();
    let mut tests: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (wanted, test) in lines.lines().filter_map(|line| line.split_once('\t')) {
        tests.entry(wanted).or_default().insert(test);
    }
    let all: BTreeSet<&str> = tests.values().flatten().copied().collect();
    // Continuous integration runs these again with the data.
    let names = all.iter().map(|test| format!("{test}\n"));
    std::fs::write(list.with_file_name("last"), names.collect::<String>())
        .expect("the target folder can be written");
    // A list that stays would be counted again by a later run with this process number; that is no failure.
    let _ = std::fs::remove_file(list);
    if all.is_empty() {
        return println!("\nNo test was left out for want of data.\n");
    }
    println!(
        "\n{} tests were left out for want of data or programs:",
        all.len()
    );
    for (wanted, tests) in &tests {
        println!("  {:3}  {wanted}", tests.len());
    }
    println!("docs/data.md says what each data set is and how to get it.\n");
}
