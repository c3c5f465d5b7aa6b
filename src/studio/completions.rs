//! The manual page and shell completions of `mien-studio`, generated from its grammar, in the layout of a package.

use std::io;
use std::path::Path;

use clap::Command;
use clap_complete::Shell;
use clap_mangen::Man;

use mien_workbench::atomic_write::write_out;
use mien_workbench::fault::Fault;

/// Writes them below `share`, which corresponds to `/usr/share`.
///
/// # Errors
/// If a file cannot be written.
pub fn write(mut grammar: Command, share: &Path) -> Result<(), Fault> {
    let name = grammar.get_name().to_owned();
    let put = |at: String, bytes: &[u8]| {
        let path = share.join(at);
        let folder = path.parent().unwrap_or(share);
        let refused = Fault::cannot("make", folder, "; give another path with --out");
        std::fs::create_dir_all(folder).map_err(refused)?;
        write_out(&path, bytes)
    };
    let fish = format!("fish/vendor_completions.d/{name}.fish");
    for (shell, at) in [
        (Shell::Bash, format!("bash-completion/completions/{name}")),
        (Shell::Zsh, format!("zsh/vendor-completions/_{name}")),
        (Shell::Fish, fish),
    ] {
        let mut text = Vec::new();
        clap_complete::generate(shell, &mut grammar, &name, &mut text);
        put(at, &text)?;
    }
    grammar.build();
    let mut page = Vec::new();
    manual(&grammar, &mut page).map_err(Fault::within("manual page"))?;
    put(format!("man/man1/{name}.1"), &page)
}

/// The commands with their options, in one page.
fn manual(grammar: &Command, page: &mut Vec<u8>) -> io::Result<()> {
    Man::new(grammar.clone()).render(page)?;
    let commands = grammar.get_subcommands();
    for command in commands.filter(|command| command.get_name() != "help") {
        let mut text = Vec::new();
        let man = Man::new(command.clone());
        man.render_description_section(&mut text)?;
        man.render_synopsis_section(&mut text)?;
        man.render_options_section(&mut text)?;
        man.render_extra_section(&mut text)?;
        let text = String::from_utf8_lossy(&text).replace(".SH ", ".SS ");
        page.extend(format!(".SH {}\n{text}", command.get_name().to_uppercase()).bytes());
    }
    Ok(())
}
