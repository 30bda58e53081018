//! `tectum merge`: a study from its parts.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use tectum::study::merge;

use super::study_ended;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum compare --seeds 1000..1010 --part a.jsonl    on one machine
  tectum compare --seeds 1010..1020 --part b.jsonl    on another
  tectum merge a.jsonl b.jsonl --out runs/both        tables and figures, as one process would have made them

Parts must be of one study and one build, that of the program that merges them. Runs in more than one of them
must be equal. Missing runs are listed, and nothing is written then. docs/clusters.md has examples for clusters.")]
pub struct Arguments {
    /// Files that --part has written, or folders of studies
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Folder for tables and figures [default: runs/<study>-<n>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object instead of the tables
    #[arg(long)]
    json: bool,
}

pub fn main(arguments: &Arguments) -> ExitCode {
    let merged = merge(&arguments.files, arguments.out.as_deref());
    study_ended(merged.map(|study| if arguments.json { study.json + "\n" } else { study.text }))
}
