//! `tectum new`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, ValueEnum};
use tectum::new_project::{ProjectKind, ProjectLanguage, create};
use tectum::process::print_error_line;
use tectum::runtime::exit;

use super::print;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum new plant my-arm                         a cargo package: plant, process, scenario, tests
  tectum new controller mine --lang python        a script that takes the controller's place

The project builds, tests and runs as it is. It refers to the checkout from which this program was
built, if that is still there, and otherwise to the published package.")]
pub struct Arguments {
    /// What to make
    kind: Kind,
    /// The project's name, and that of its folder: lower-case letters, digits, - and _
    name: String,
    /// The language
    #[arg(long, value_name = "LANGUAGE", default_value = "rust")]
    lang: Language,
    /// Print one JSON object instead of the text
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Kind {
    /// Takes the simulator's place
    Plant,
    /// Takes the place of Tectum's own controller
    Controller,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Language {
    Rust,
    Python,
}

pub fn main(arguments: &Arguments) -> ExitCode {
    let kind = match arguments.kind {
        Kind::Plant => ProjectKind::Plant,
        Kind::Controller => ProjectKind::Controller,
    };
    let language = match arguments.lang {
        Language::Rust => ProjectLanguage::Rust,
        Language::Python => ProjectLanguage::Python,
    };
    match create(Path::new(""), &arguments.name, kind, language, &this_program()) {
        Ok(project) if arguments.json => {
            let object = serde_json::to_string_pretty(&project).unwrap_or_default();
            print(&format!("{object}\n"));
            ExitCode::SUCCESS
        }
        Ok(project) => {
            print(&project.to_text());
            ExitCode::SUCCESS
        }
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            ExitCode::from(exit::INPUT)
        }
    }
}

/// This program as a command that works in another folder: its name if it was found in PATH, and otherwise its path.
fn this_program() -> String {
    let named = std::env::args_os().next().map(PathBuf::from).unwrap_or_default();
    let path = if named.components().count() > 1 { std::env::current_exe().unwrap_or(named) } else { named };
    path.display().to_string()
}
