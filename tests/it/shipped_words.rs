//! Promise: the man page and the completions know every command and option of `mien help`, and no others; those that
//! `mien-studio` makes of itself know all of its own.

use std::collections::BTreeSet;

use mien_appliance::cli::HELP;
use mien_stages::expression::unit_words;

/// Options in a text; completions of fish have them as `-l name`.
fn options(text: &str) -> BTreeSet<String> {
    let text = text.replace("\\-", "-").replace(" -l ", " --");
    let starts = text.match_indices("--").map(|(at, _)| at + 2);
    let words = starts.map(|at| {
        let word = text[at..].split(|c: char| !c.is_ascii_lowercase() && c != '-');
        word.take(1).collect::<String>()
    });
    words.filter(|word| word.len() > 1).collect()
}

fn commands() -> BTreeSet<&'static str> {
    let lines = HELP.lines().filter_map(|line| line.strip_prefix("mien "));
    let words = lines.filter_map(|line| line.split_whitespace().next());
    words.filter(|word| *word != "-").collect()
}

#[test]
fn man_page_and_completions_know_what_help_says() {
    let expected = options(HELP);
    assert!(commands().len() == 8 && expected.len() >= 9, "{expected:?}");
    for (name, text) in [
        ("mien.1", include_str!("../../systemd/mien.1")),
        ("bash", include_str!("../../systemd/completions/mien.bash")),
        ("zsh", include_str!("../../systemd/completions/_mien")),
        ("fish", include_str!("../../systemd/completions/mien.fish")),
    ] {
        // What shells call their own words with.
        let text = text.replace("-- \"$word\"", "");
        assert_eq!(options(&text), expected, "{name}");
        let plain = text.replace("\\-", "-");
        for command in commands() {
            assert!(plain.contains(command), "{name} does not know {command}");
        }
    }
}

#[test]
fn the_page_of_units_has_every_unit_s_words() {
    let page = include_str!("../../docs/units.md");
    let manual = include_str!("../../systemd/mien.1");
    for words in &unit_words::ALL {
        let entry = format!(".B {}\n{}: {}\n", words.code, words.plain, words.does);
        assert!(manual.contains(&entry), "mien.1 has not {entry}");
        let row = page
            .lines()
            .find(|line| line.starts_with(&format!("| {} |", words.code)))
            .unwrap_or_else(|| panic!("no row of {}", words.code));
        for part in [words.facs, words.plain, words.does] {
            assert!(row.contains(&format!("| {part} |")), "{row}: {part}");
        }
        for shape in words.arkit.split_whitespace() {
            assert!(row.contains(&format!("`{shape}`")), "{row}: {shape}");
        }
    }
    let rows = page.lines().filter(|line| line.starts_with("| AU"));
    assert_eq!(rows.count(), unit_words::ALL.len());
}

#[test]
#[cfg(feature = "studio")]
fn the_workstation_s_manual_page_and_completions_know_every_command_and_option() {
    let grammar = <mien_studio::cli::Line as clap::CommandFactory>::command();
    let folder = tempfile::tempdir().unwrap();
    mien_studio::completions::write(grammar.clone(), folder.path()).unwrap();
    for at in [
        "man/man1/mien-studio.1",
        "bash-completion/completions/mien-studio",
        "zsh/vendor-completions/_mien-studio",
        "fish/vendor_completions.d/mien-studio.fish",
    ] {
        let text = std::fs::read_to_string(folder.path().join(at)).unwrap();
        let (text, known) = (text.replace("\\-", "-"), options(&text));
        for command in grammar.get_subcommands() {
            let name = command.get_name();
            assert!(text.contains(name), "{at} does not know {name}");
            let options = command.get_arguments().filter_map(|one| one.get_long());
            for option in options {
                assert!(known.contains(option), "{at}: {name} --{option}");
            }
        }
    }
}
