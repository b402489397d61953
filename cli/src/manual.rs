//! `ssplat completions` and `ssplat man`: shell completions and manual pages, for packages of the program.

use std::io;

use clap::CommandFactory;
use clap_mangen::Man;
use clap_mangen::roff::{Roff, roman};

use crate::args::{self, Args};
use crate::failure::Failure;
use crate::sink::{ReadOnly, Sink, say};

/// Prints the completions for a shell.
pub fn completions(args: &args::Completions) -> Result<(), Failure> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Args::command(), "ssplat", &mut text);
    say(&String::from_utf8_lossy(&text))
}

/// Prints the manual page of the program or of a command, or writes all of them into a folder.
pub fn man(args: &args::Man) -> Result<(), Failure> {
    // `ssplat help` has no page: it prints the help of the others.
    let mut program = Args::command().disable_help_subcommand(true);
    program.build();
    let commands: Vec<&clap::Command> = program.get_subcommands().collect();
    if let Some(folder) = &args.out_dir {
        std::fs::create_dir_all(folder).map_err(|e| Failure::io(folder, &e))?;
        for command in commands.into_iter().chain([&program]) {
            let path = folder.join(Man::new(command.clone()).get_filename());
            Sink::replacing(&path, &[], ReadOnly::Keep)?.finish_with(page(command, &program).as_bytes())?;
        }
        return Ok(());
    }
    let command = match &args.command {
        None => &program,
        Some(name) => commands.iter().find(|c| c.get_name() == name).ok_or_else(|| {
            let names: Vec<&str> = commands.iter().map(|c| c.get_name()).collect();
            Failure::usage(format!("no command {name:?}; the commands are {}", names.join(", ")))
        })?,
    };
    say(&page(command, &program))
}

/// What roff writes before each part: the definition of the apostrophe.
const PREAMBLE: &str = ".ie \\n(.g .ds Aq \\(aq\n.el .ds Aq '\n";

/// Returns the manual page of `command`, the program or one of its commands.
fn page(command: &clap::Command, program: &clap::Command) -> String {
    let mut parts = Vec::new();
    render(command, program, &mut parts).expect("memory can be written to");
    let parts = String::from_utf8_lossy(&parts).replace(PREAMBLE, "");
    let name = command.get_display_name().unwrap_or(command.get_name());
    // Without a date; clap_mangen would leave the argument out.
    format!(".TH {name} 1 \"\" \"ssplat {}\" \"User Commands\"\n{PREAMBLE}{parts}", env!("CARGO_PKG_VERSION"))
}

fn render(command: &clap::Command, program: &clap::Command, text: &mut Vec<u8>) -> io::Result<()> {
    // The synopsis as in the help: clap_mangen would list all options, without their values.
    let usage = command.clone().render_usage().to_string();
    let usage = usage.trim_start_matches("Usage:").trim().to_owned();
    let page = Man::new(command.clone().override_usage(usage));
    page.render_name_section(text)?;
    page.render_synopsis_section(text)?;
    page.render_options_section(text)?;
    if command.has_subcommands() {
        page.render_subcommands_section(text)?;
    }
    if let Some(after) = command.get_after_help() {
        paragraphs(&after.to_string()).to_writer(text)?;
    }
    if command.get_name() != program.get_name() {
        let mut others = Roff::default();
        others.control("SH", ["SEE ALSO"]).text([roman(format!("{}(1)", program.get_name()))]);
        others.to_writer(text)?;
    }
    Ok(())
}

/// Returns the text after the options: examples as they stand, and paragraphs that `man` fills.
fn paragraphs(text: &str) -> Roff {
    let mut roff = Roff::default();
    let mut section = "";
    let mut begin = |roff: &mut Roff, name: &'static str| {
        let is_new = std::mem::replace(&mut section, name) != name;
        if is_new {
            roff.control("SH", [name])
        } else {
            roff.control("PP", [])
        };
    };
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        match line {
            "" => {}
            "Examples:" => begin(&mut roff, "EXAMPLES"),
            line if line.starts_with("  ") => {
                roff.control("nf", []);
                roff.text([roman(line)]);
                while let Some(line) = lines.next_if(|line| line.starts_with("  ")) {
                    roff.text([roman(line)]);
                }
                roff.control("fi", []);
            }
            line => match line.strip_prefix("Exit status: ") {
                Some(status) => {
                    begin(&mut roff, "EXIT STATUS");
                    roff.text([roman(status)]);
                }
                None => {
                    begin(&mut roff, "NOTES");
                    roff.text([roman(line)]);
                }
            },
        }
    }
    roff
}
