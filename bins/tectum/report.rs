//! `tectum report`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use tectum::process::print_error_line;
use tectum::runtime::exit;
use tectum::study::report_page::write_page;

use super::print;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum report runs/arm-1                        runs/arm-1/report.html: one page with all that the run has left
  tectum report arm-1 --out arm.html              the same by the run's name, into another file
  tectum report --compare runs/arm-1 runs/arm-2   several runs side by side: compare.html
  tectum report runs/arm-1 --json                 one JSON object on standard output

The page needs nothing else: no other file, no network. It is dark or light as the system is; d switches.")]
pub struct Arguments {
    /// The folder of a run, or its name under runs/; several with --compare
    #[arg(value_name = "RUN", required = true)]
    runs: Vec<PathBuf>,
    /// Lay several runs side by side on one page
    #[arg(long)]
    compare: bool,
    /// Write an HTML page, which is the only form there is
    #[arg(long)]
    html: bool,
    /// The page's file [default: report.html in the run's folder; with --compare compare.html]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print one JSON object instead of the page's name
    #[arg(long)]
    json: bool,
}

pub fn main(arguments: &Arguments) -> ExitCode {
    let given = arguments.runs.len();
    let refused = match (arguments.compare, given) {
        (false, 2..) => Some(format!("{given} runs are given; add --compare to lay them side by side")),
        (true, 1) => Some("--compare needs two runs or more; give another one, or leave out --compare".to_owned()),
        _ => None,
    };
    let written = match refused {
        Some(why) => Err(why),
        None => write_page(&arguments.runs, arguments.out.as_deref()).map_err(|error| error.to_string()),
    };
    match written {
        Ok(written) => print(&if arguments.json { written.to_json() + "\n" } else { written.to_text() }),
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            ExitCode::from(exit::INPUT)
        }
    }
}
