//! `sandgait studies`

use sandgait::Result;
use sandgait::study::layout::glossary;
use sandgait::study::{STUDIES, page, python};

/// List the studies: computations that the command line, Python and servers have with the same arguments.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait studies
  sandgait studies --markdown > docs/reference/studies.md
  sandgait studies --python > python_client/sandgait/study_functions.py")]
pub struct StudiesArgs {
    /// Print the page of the reference
    #[arg(long)]
    markdown: bool,
    /// Print the functions of the Python package
    #[arg(long, conflicts_with = "markdown")]
    python: bool,
}

impl StudiesArgs {
    pub fn run(self) -> Result<String> {
        if self.markdown {
            return Ok(page::page());
        }
        if self.python {
            return Ok(python::module());
        }
        let rows: Vec<_> = STUDIES.iter().map(|study| vec![study.name.to_owned(), study.about().summary]).collect();
        Ok(glossary(&rows))
    }
}
