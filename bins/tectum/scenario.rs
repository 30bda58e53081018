//! `tectum scenario`.

use std::process::ExitCode;

use clap::{Args, Subcommand};
use serde_json::json;
use tectum::process::print_error_line;
use tectum::runtime::exit;
use tectum::scenario::{Preset, presets};

use super::print;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum scenario list                  names, and one sentence about each
  tectum scenario show arm > my.toml    a copy to change; then: tectum run my.toml")]
pub struct Arguments {
    #[command(subcommand)]
    work: Work,
}

#[derive(Debug, Subcommand)]
enum Work {
    /// List the built-in scenarios: name, and one sentence about each
    #[command(after_help = "Example: tectum scenario list --json")]
    List {
        /// Print one JSON object instead of the table
        #[arg(long)]
        json: bool,
    },
    /// Print a built-in scenario's TOML, comments included
    #[command(after_help = "Example: tectum scenario show arm > my.toml")]
    Show {
        /// The scenario's name, as `tectum scenario list` shows it
        name: String,
        /// Print one JSON object instead of the TOML
        #[arg(long)]
        json: bool,
    },
}

pub fn main(arguments: &Arguments) -> ExitCode {
    match &arguments.work {
        Work::List { json } => print(&if *json { list_json() } else { list_text() }),
        Work::Show { name, json } => match Preset::named(name) {
            Ok(preset) if *json => {
                print(&object(&json!({ "name": preset.name, "about": preset.about, "toml": preset.text })))
            }
            Ok(preset) => print(preset.text),
            Err(error) => {
                print_error_line(&format!("tectum: {error}"));
                ExitCode::from(exit::INPUT)
            }
        },
    }
}

fn list_text() -> String {
    let width = presets().iter().map(|preset| preset.name.len()).max().unwrap_or(0);
    presets().iter().map(|preset| format!("{:width$}  {}\n", preset.name, preset.about)).collect()
}

fn list_json() -> String {
    let entry = |preset: &Preset| json!({ "name": preset.name, "about": preset.about });
    object(&json!({ "scenarios": presets().iter().map(entry).collect::<Vec<_>>() }))
}

fn object(value: &serde_json::Value) -> String {
    format!("{value:#}\n")
}
