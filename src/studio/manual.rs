//! Generated from the grammar of the command line, so that they cannot differ from it: the manual page (man(7)) and the
//! completions of the shells. `tests/it/shipped_words.rs` writes them to `systemd/` and holds them to it.

use super::cli::{ABOUT, COMMANDS, Command};

/// Text of a manual page: no hyphens that are broken or replaced, no line that is taken for a request.
fn escaped(text: &str) -> String {
    let text = text.replace('\\', "\\e").replace('-', "\\-");
    let lines = text.lines().map(|line| match line.chars().next() {
        Some('.' | '\'') => format!("\\&{line}\n"),
        _ => format!("{line}\n"),
    });
    lines.collect()
}

/// The manual page, `mien-studio.1`.
#[must_use]
pub fn page() -> String {
    let mut text = format!(
        ".TH MIEN\\-STUDIO 1 \"\" \"mien\" \"User Commands\"\n.SH NAME\nmien\\-studio \\- {}.SH SYNOPSIS\n.B mien\\-studio\n\\fICOMMAND\\fR ...\n.SH COMMANDS\n",
        escaped(ABOUT)
    );
    for command in COMMANDS {
        let Command {
            name,
            usage,
            about,
            example,
            ..
        } = command;
        text += &format!(".SS {}", escaped(name));
        text += &format!(".B mien\\-studio {name}\n{}.PP\n", escaped(usage));
        text += &escaped(&format!("{about}."));
        if !command.details().is_empty() {
            // Laid out by hand, as --help prints it.
            text += &format!(".PP\n.nf\n{}.fi\n", escaped(command.details()));
        }
        text += &format!(".PP\nExample:\n.B {}", escaped(example));
    }
    text + ".SH SEE ALSO\n.BR mien (1)\n"
}

/// `--name` of every option and flag of a command.
fn words(command: &Command) -> impl Iterator<Item = &'static str> {
    command.options.iter().chain(command.flags).copied()
}

/// Completions for bash, `mien-studio.bash`.
#[must_use]
pub fn bash() -> String {
    let names: Vec<&str> = COMMANDS.iter().map(|command| command.name).collect();
    let mut text = format!(
        "# bash completion for mien-studio\n_mien_studio() {{\n  local word=${{COMP_WORDS[COMP_CWORD]}}\n  if [ \"$COMP_CWORD\" -eq 1 ]; then\n    COMPREPLY=($(compgen -W '{} help --help --version' -- \"$word\"))\n    return\n  fi\n  if [[ $word != -* ]]; then\n    COMPREPLY=($(compgen -f -- \"$word\"))\n    return\n  fi\n  case ${{COMP_WORDS[1]}} in\n",
        names.join(" ")
    );
    for command in COMMANDS {
        let options: Vec<String> = words(command).map(|word| format!("--{word}")).collect();
        text += &format!(
            "    {}) COMPREPLY=($(compgen -W '{} --help' -- \"$word\")) ;;\n",
            command.name,
            options.join(" ")
        );
    }
    text + "  esac\n}\ncomplete -o filenames -F _mien_studio mien-studio\n"
}

/// Completions for zsh, `_mien-studio`.
#[must_use]
pub fn zsh() -> String {
    let mut text = String::from(
        "#compdef mien-studio\n# zsh completion for mien-studio\nlocal -a commands\ncommands=(\n",
    );
    for command in COMMANDS {
        // A quote would end the word, a colon the name.
        let about = command.about.replace('\'', "’").replace(':', "\\:");
        text += &format!("  '{}:{about}'\n", command.name);
    }
    text += ")\nif (( CURRENT == 2 )); then\n  _describe command commands\n  _arguments '--help[commands]' '--version[version]'\n  return\nfi\ncase $words[2] in\n";
    for command in COMMANDS {
        let options = command
            .options
            .iter()
            .map(|word| format!(" '*--{word}:{word}:_files'"));
        let flags = command.flags.iter().map(|word| format!(" '--{word}'"));
        let all: String = options.chain(flags).collect();
        let free = if command.words > 0 {
            " '*:file:_files'"
        } else {
            ""
        };
        text += &format!("  {}) _arguments{all} '--help'{free} ;;\n", command.name);
    }
    text + "esac\n"
}

/// Completions for fish, `mien-studio.fish`.
#[must_use]
pub fn fish() -> String {
    let names: Vec<&str> = COMMANDS.iter().map(|command| command.name).collect();
    let mut text = format!(
        "# fish completion for mien-studio\nset mien_studio_first 'not __fish_seen_subcommand_from {}'\n",
        names.join(" ")
    );
    for command in COMMANDS {
        let about = command.about.replace('\'', "’");
        let seen = format!("-n '__fish_seen_subcommand_from {}'", command.name);
        text += &format!(
            "complete -c mien-studio -n $mien_studio_first -f -a {} -d '{about}'\n",
            command.name
        );
        for word in command.options {
            text += &format!("complete -c mien-studio {seen} -l {word} -r -F\n");
        }
        for word in command.flags {
            text += &format!("complete -c mien-studio {seen} -l {word}\n");
        }
    }
    text
}
