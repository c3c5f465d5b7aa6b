//! Promise: the man page and the completions know every command and option of `mien help`, and no others; those of
//! `mien-studio` are made from its grammar (`MIEN_WRITE_GOLDEN=1` writes them anew).

use std::collections::BTreeSet;

use mien::appliance::cli::HELP;
use mien::expression::unit_words;

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

/// The commands with their options, in one page.
#[cfg(feature = "studio")]
fn manual_page() -> String {
    use clap_mangen::Man;
    let mut line = <mien::studio::cli::Line as clap::CommandFactory>::command();
    line.build();
    let mut page = Vec::new();
    let man = Man::new(line.clone());
    man.render(&mut page).unwrap();
    for command in line.get_subcommands().filter(|c| c.get_name() != "help") {
        let mut text = Vec::new();
        let man = Man::new(command.clone());
        man.render_description_section(&mut text).unwrap();
        man.render_synopsis_section(&mut text).unwrap();
        man.render_options_section(&mut text).unwrap();
        man.render_extra_section(&mut text).unwrap();
        let text = String::from_utf8(text).unwrap().replace(".SH ", ".SS ");
        page.extend(format!(".SH {}\n{text}", command.get_name().to_uppercase()).bytes());
    }
    String::from_utf8(page).unwrap()
}

#[cfg(feature = "studio")]
fn completions(shell: clap_complete::Shell) -> String {
    let mut text = Vec::new();
    let mut line = <mien::studio::cli::Line as clap::CommandFactory>::command();
    clap_complete::generate(shell, &mut line, "mien-studio", &mut text);
    String::from_utf8(text).unwrap()
}

#[test]
#[cfg(feature = "studio")]
fn what_is_shipped_for_the_workstation_is_made_from_its_grammar() {
    use clap_complete::Shell;
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("systemd");
    for (name, text) in [
        ("mien-studio.1", manual_page()),
        ("completions/mien-studio.bash", completions(Shell::Bash)),
        ("completions/_mien-studio", completions(Shell::Zsh)),
        ("completions/mien-studio.fish", completions(Shell::Fish)),
    ] {
        let path = folder.join(name);
        if std::env::var_os("MIEN_WRITE_GOLDEN").is_some() {
            std::fs::write(&path, &text).unwrap();
        }
        let shipped = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(
            shipped == text,
            "{name} is not what the grammar says; write it with MIEN_WRITE_GOLDEN=1 cargo test --features studio shipped_words"
        );
    }
}
