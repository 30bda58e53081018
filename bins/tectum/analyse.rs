//! `tectum analyse`: the movements in a run's log.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use tectum::log;
use tectum::process::print_error_line;
use tectum::report::figure;
use tectum::runtime::exit;
use tectum::study::analyse::{AnalyseError, Analysis, analyse};

use super::print;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum run --ticks 6000                a run with every tick in its log: `every = 1` under [log]
  tectum analyse runs/arm-1              its movements: table, analysis.json, movements.csv, movements.svg
  tectum analyse log.mcap --out today    another log, another folder for what comes out
  tectum analyse runs/arm-1 --json       one JSON object on standard output")]
pub struct Arguments {
    /// A log, or the folder of a run, or the run's name under runs/
    log: PathBuf,
    /// Folder for what comes out [default: beside the log]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Leave out the movements without exploration noise, for which the learning must be done again
    #[arg(long)]
    measured_only: bool,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

pub fn main(arguments: &Arguments) -> ExitCode {
    match study(arguments) {
        Ok((analysis, files)) => {
            let text = if arguments.json { analysis.to_json() + "\n" } else { analysis.to_text() + "\n" + &files };
            print(&text)
        }
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            ExitCode::from(exit::INPUT)
        }
    }
}

fn study(arguments: &Arguments) -> Result<(Analysis, String), AnalyseError> {
    let log = log::find(&arguments.log)?;
    let analysis = analyse(&log, !arguments.measured_only, true)?;
    let beside = log[0].parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_owned();
    let out = arguments.out.clone().unwrap_or(beside);
    let failed = |path: &Path, error| AnalyseError::Write { path: path.to_owned(), error };
    std::fs::create_dir_all(&out).map_err(|error| failed(&out, error))?;
    let [json, csv, svg] = ["analysis.json", "movements.csv", "movements.svg"].map(|name| out.join(name));
    std::fs::write(&json, analysis.to_json()).map_err(|error| failed(&json, error))?;
    std::fs::write(&csv, analysis.to_csv()).map_err(|error| failed(&csv, error))?;
    figure::draw_movements(&analysis.figure(), &svg)?;
    let files = format!("table   {}\nfigure  {}\n", csv.display(), svg.display());
    Ok((analysis, files))
}
