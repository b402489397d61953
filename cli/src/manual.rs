//! `ssplat completions` and `ssplat man`: shell completions and the manual page, for packages of the program.

use clap::CommandFactory;

use crate::args::{self, Args};
use crate::failure::Failure;
use crate::sink::{self, say};

/// Prints the completions for a shell.
pub fn completions(args: &args::Completions) -> Result<(), Failure> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Args::command(), "ssplat", &mut text);
    say(&String::from_utf8_lossy(&text))
}

/// Prints the manual page: the program, then each command.
pub fn man() -> Result<(), Failure> {
    let mut text = Vec::new();
    let mut program = Args::command();
    program.build();
    let io = |e| Failure::io(&sink::named("-".as_ref()), &e);
    let page = clap_mangen::Man::new(program.clone());
    page.render_title(&mut text).map_err(io)?;
    page.render_name_section(&mut text).map_err(io)?;
    page.render_synopsis_section(&mut text).map_err(io)?;
    page.render_description_section(&mut text).map_err(io)?;
    // The commands follow on this page, so the list of pages that clap_mangen would add is not needed.
    page.render_options_section(&mut text).map_err(io)?;
    page.render_extra_section(&mut text).map_err(io)?;
    for command in program.get_subcommands().filter(|c| c.get_name() != "help") {
        let man = clap_mangen::Man::new(command.clone());
        man.render_name_section(&mut text).map_err(io)?;
        man.render_synopsis_section(&mut text).map_err(io)?;
        man.render_options_section(&mut text).map_err(io)?;
        man.render_extra_section(&mut text).map_err(io)?;
    }
    say(&String::from_utf8_lossy(&text))
}
