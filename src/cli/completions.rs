//! `sandgait completions`

use super::Cli;
use clap::CommandFactory as _;
use clap_complete::Shell;
use sandgait::Result;

/// Print the completions of commands and options for a shell.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait completions bash > /etc/bash_completion.d/sandgait
  sandgait completions zsh > ~/.zfunc/_sandgait
  sandgait completions fish > ~/.config/fish/completions/sandgait.fish")]
pub struct CompletionsArgs {
    /// The shell
    shell: Shell,
}

impl CompletionsArgs {
    pub fn run(self) -> Result<String> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut Cli::command(), "sandgait", &mut script);
        Ok(String::from_utf8_lossy(&script).into_owned())
    }
}
