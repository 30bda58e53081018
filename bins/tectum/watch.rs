//! `tectum watch`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use tectum::clock::TerminationSignals;
use tectum::process::{print_error_line, print_result};
use tectum::runtime::exit;
#[cfg(feature = "foxglove")]
use tectum::watch::watch_by_foxglove;
use tectum::watch::{
    FaceEnd, Follower, WatchError, WatchTarget, serve_metrics, snapshot, watch_in_browser, watch_in_terminal,
};

use super::print;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum run --mode realtime             a run to watch
  tectum watch                           the newest living run, in this terminal
  tectum watch arm-1                     a run by its name under runs/, or by its folder
  tectum watch --wait                    the next run, if none is alive
  tectum watch --web                     a page in a browser: http://127.0.0.1:8417/
  tectum watch --web 0.0.0.0:8417        the same for other machines, with a token
  tectum watch --metrics 9417            metrics for Prometheus: http://127.0.0.1:9417/metrics
  tectum watch --foxglove                for Foxglove, Lichtblick, PlotJuggler: ws://127.0.0.1:8765/
  tectum watch --json                    one object with the numbers of now

A watcher slows nothing: it only reads shared memory, and leaves out what is too much. Keys: q quits, space pauses, ?
shows the others. NO_COLOR turns colours off.")]
pub struct Arguments {
    /// The folder of a run, or its name under runs/ [default: the newest run that is alive]
    #[arg(value_name = "RUN")]
    run: Option<PathBuf>,
    /// Wait until the run begins
    #[arg(long)]
    wait: bool,
    /// Serve a page for a browser at this address; other addresses than this machine's own need a token, which the
    /// printed link has
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "", conflicts_with = "json")]
    web: Option<String>,
    /// Serve metrics in Prometheus' text format at this address (PORT or HOST:PORT), under /metrics; other addresses
    /// than this machine's own need a token, which the printed link has
    #[arg(long, value_name = "ADDR", conflicts_with_all = ["json", "web"])]
    metrics: Option<String>,
    /// Serve the Foxglove WebSocket protocol at this address, for Foxglove, Lichtblick and PlotJuggler; needs a build
    /// with the feature foxglove
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "",
        conflicts_with_all = ["json", "web", "metrics"])]
    foxglove: Option<String>,
    /// Print one JSON object with the numbers of now, and end
    #[arg(long)]
    json: bool,
}

pub fn main(arguments: &Arguments) -> ExitCode {
    match watch(arguments) {
        Ok(code) => code,
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn watch(arguments: &Arguments) -> Result<ExitCode, WatchError> {
    if arguments.foxglove.is_some() && !cfg!(feature = "foxglove") {
        return Err(WatchError::NoFoxglove);
    }
    let signals = TerminationSignals::install().map_err(WatchError::Signals)?;
    let target = arguments.run.clone().map_or(WatchTarget::Newest, WatchTarget::Named);
    let mut follower = Follower::open(target, arguments.wait)?;
    if arguments.json {
        return Ok(match snapshot(&mut follower, &signals) {
            Some(text) => print(&(text + "\n")),
            None => ExitCode::from(exit::by_signal(signals.received())),
        });
    }
    let announce = |url: &str| print_result(&format!("{url}\n"));
    let end = match (&arguments.web, &arguments.metrics, &arguments.foxglove) {
        (Some(address), ..) => watch_in_browser(&mut follower, address, &signals, announce)?,
        (None, Some(address), _) => serve_metrics(&mut follower, address, &signals, announce)?,
        #[cfg(feature = "foxglove")]
        (None, None, Some(address)) => watch_by_foxglove(&mut follower, address, &signals, announce)?,
        _ => watch_in_terminal(&mut follower, &signals, || false)?,
    };
    Ok(match end {
        FaceEnd::Quit | FaceEnd::Over => ExitCode::SUCCESS,
        FaceEnd::Interrupted => ExitCode::from(exit::INTERRUPTED),
        FaceEnd::HungUp => ExitCode::from(exit::HUNG_UP),
        FaceEnd::Signal(number) => ExitCode::from(exit::by_signal(number)),
    })
}
