//! `tectum film`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use tectum::log;
use tectum::process::print_error_line;
use tectum::runtime::exit;
use tectum::study::film::{FilmError, WrittenFilm, check_name, film, write};

use super::print;

/// The film's name beside its log.
const FILM_FILE: &str = "film.svg";

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum run                             the arm learns to reach, and a joint blocks; every tick is in the log
  tectum film runs/arm-1                 three reaches of that run as an animated SVG: runs/arm-1/film.svg
  tectum film arm-1 -o reach.gif         the same by the run's name, as a GIF, for slides and chats
  tectum film arm-1 -o reach.mp4         as a video, where ffmpeg is installed
  tectum run pendulum                    a pendulum swings up; its film shows three episodes
  tectum film log.mcap --json            one JSON object on standard output

The SVG has no script, so that it plays wherever an SVG can be shown as an image. It is the sharpest and smallest of the
three.")]
pub struct Arguments {
    /// A log, or the folder of a run, or the run's name under runs/
    #[arg(value_name = "RUN")]
    log: PathBuf,
    /// The film's file, which ends with .svg, .gif or .mp4 [default: film.svg beside the log]
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

pub fn main(arguments: &Arguments) -> ExitCode {
    match make(arguments) {
        Ok(written) => print(&if arguments.json { written.to_json() + "\n" } else { written.to_text() }),
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            ExitCode::from(exit::INPUT)
        }
    }
}

fn make(arguments: &Arguments) -> Result<WrittenFilm, FilmError> {
    let log = log::find(&arguments.log)?;
    let file = arguments.out.clone().unwrap_or_else(|| log[0].with_file_name(FILM_FILE));
    check_name(&file)?;
    let film = film(&log, true)?;
    let bytes = write(&film, &file)?;
    Ok(WrittenFilm::new(&film, &file, bytes))
}
