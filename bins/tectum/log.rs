//! `tectum log`.

use std::fs::File;
use std::io::{BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, Subcommand, ValueEnum};
use tectum::log::{CsvChannel, LogError, LogInfo, PackExtras, PackedLog, Repair, RunLog, csv, find, pack, repair};
use tectum::process::print_error_line;
use tectum::runtime::exit;

use super::export::{PythonExport, export_with_python};
use super::print;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum log info runs/arm-1                its run, whether it is whole, what it holds and what is missing
  tectum log repair runs/arm-1              makes a torn log whole
  tectum log pack runs/arm-1                puts it into compressed, indexed chunks, for viewers and archives
  tectum log csv runs/arm-1 --out arm.csv   its observations as a table
  tectum log export runs/arm-1 --format lerobot --out arm   training data: a LeRobotDataset")]
pub struct Arguments {
    #[command(subcommand)]
    work: Work,
}

#[derive(Debug, Subcommand)]
enum Work {
    /// Show a log's run, whether the log is whole, what it holds and what is missing from it
    #[command(after_help = "Example: tectum log info runs/arm-1 --json")]
    Info(Common),
    /// Make a torn log whole, all its segments, so that every MCAP reader accepts it; a whole log stays as it is
    #[command(after_help = "\
Examples:
  tectum log repair runs/arm-1                      the torn original is kept as log.mcap.torn
  tectum log repair torn.mcap --out whole.mcap      the original stays as it is")]
    Repair {
        #[command(flatten)]
        common: Common,
        /// Write the repaired log there, and leave the torn one as it is
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Put a whole log, all its segments, into compressed chunks with an index, for viewers (Foxglove, Lichtblick,
    /// PlotJuggler, rerun) and archives. Adds topics with the scenario's names. All commands read it as before
    #[command(after_help = "\
Examples:
  tectum log pack runs/arm-1                        the packed log takes the other one's place
  tectum log pack runs/arm-1 --out packed.mcap      the log stays as it is
  tectum log pack runs/arm-1 --archive              the smallest log")]
    Pack {
        #[command(flatten)]
        common: Common,
        /// Write the packed log there, and leave the log as it is
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// Leave out the topics that repeat the samples for viewers: /inputs, /joint_states, /loss, /scene/links, ...
        #[arg(long)]
        no_views: bool,
        /// Leave out the views and the index of the messages in each chunk: the smallest log, for archives. tectum and
        /// other programs that read a log from its beginning read it; viewers that jump may show nothing
        #[arg(long)]
        archive: bool,
    },
    /// Export a channel as CSV: one row per sample, columns by the scenario's names, with units
    #[command(after_help = "\
Examples:
  tectum log csv runs/arm-1                         observations, to standard output
  tectum log csv runs/arm-1 --channel learning --out learning.csv")]
    Csv {
        /// A log, or the folder of a run, or the run's name under runs/
        log: PathBuf,
        /// The channel
        #[arg(long, value_enum, default_value_t = ChannelArgument::Observation)]
        channel: ChannelArgument,
        /// The file to write [default: standard output]
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Export a log for other programs: as CSV, as a Parquet table, or as a LeRobotDataset of version 3. The last two
    /// need the Python package of Tectum and pyarrow
    #[command(after_help = "\
Examples:
  tectum log export runs/arm-1 --format csv --out arm.csv
  tectum log export runs/arm-1 --format parquet --channel command --out commands.parquet
  tectum log export runs/arm-1 --format lerobot --out arm-dataset
  TECTUM_PYTHON=venv/bin/python tectum log export runs/arm-1 --format lerobot --out arm-dataset")]
    Export {
        /// A log, or the folder of a run, or the run's name under runs/
        log: PathBuf,
        /// The format
        #[arg(long, value_enum)]
        format: ExportFormat,
        /// The channel, for CSV and Parquet
        #[arg(long, value_enum, default_value_t = ChannelArgument::Observation)]
        channel: ChannelArgument,
        /// The file to write, or for lerobot the folder
        #[arg(long, value_name = "PATH")]
        out: PathBuf,
    },
}

#[derive(Debug, Args)]
struct Common {
    /// A log, or the folder of a run, or the run's name under runs/
    log: PathBuf,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ChannelArgument {
    /// Inputs, applied command, reward and measures
    Observation,
    /// Mean and drawn outputs
    Command,
    /// Noise, steps, norms and hashes
    Learning,
    /// Samples missing from the log
    Gap,
}

/// What a log is exported as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// A table as text: a row a sample, columns by the scenario's names, with units
    Csv,
    /// The same table in Apache Parquet
    Parquet,
    /// Training data: a LeRobotDataset of version 3
    Lerobot,
}

impl ChannelArgument {
    fn channel(self) -> CsvChannel {
        match self {
            Self::Observation => CsvChannel::Observation,
            Self::Command => CsvChannel::Command,
            Self::Learning => CsvChannel::Learning,
            Self::Gap => CsvChannel::Gap,
        }
    }
}

pub fn main(arguments: &Arguments) -> ExitCode {
    let result = match &arguments.work {
        Work::Info(common) => find(&common.log)
            .and_then(|log| LogInfo::of(&log))
            .map(|info| print(&if common.json { info.to_json() + "\n" } else { info.to_text() })),
        Work::Repair { common, out } => {
            find(&common.log).and_then(|log| repair_segments(&log, out.as_deref())).map(|repairs| {
                print(&if common.json {
                    json(&repairs, Repair::to_json) + "\n"
                } else {
                    text(&repairs, Repair::to_text)
                })
            })
        }
        Work::Pack { common, out, no_views, archive } => {
            let extras = match (archive, no_views) {
                (true, _) => PackExtras::Nothing,
                (false, true) => PackExtras::Index,
                (false, false) => PackExtras::Views,
            };
            find(&common.log).and_then(|log| pack_segments(&log, out.as_deref(), extras)).map(|packed| {
                print(&if common.json {
                    json(&packed, PackedLog::to_json) + "\n"
                } else {
                    text(&packed, PackedLog::to_text)
                })
            })
        }
        Work::Export { log, format: ExportFormat::Csv, channel, out } => {
            find(log).and_then(|log| export(&log, channel.channel(), Some(out)).map(|()| ExitCode::SUCCESS))
        }
        Work::Export { log, format, channel, out } => return export_by_python(log, *format, *channel, out),
        Work::Csv { log, channel, out } => {
            find(log).and_then(|log| export(&log, channel.channel(), out.as_deref()).map(|()| ExitCode::SUCCESS))
        }
    };
    match result {
        Ok(printed) => printed,
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            ExitCode::from(exit::INPUT)
        }
    }
}

/// Refuses a single file for several segments.
fn one_target(segments: &[PathBuf], out: Option<&Path>) -> Result<(), LogError> {
    let Some(out) = out.filter(|_| segments.len() > 1) else { return Ok(()) };
    let error = std::io::Error::other("the log has several segments, which would all go there; name one of them");
    Err(LogError::Export { path: out.to_owned(), error })
}

/// Packs every segment, one after the other. A failure leaves the segments before it packed.
fn pack_segments(segments: &[PathBuf], out: Option<&Path>, extras: PackExtras) -> Result<Vec<PackedLog>, LogError> {
    one_target(segments, out)?;
    segments.iter().map(|log| pack(log, out, extras)).collect()
}

/// Repairs every torn segment, one after the other. A failure leaves the segments before it repaired.
fn repair_segments(segments: &[PathBuf], out: Option<&Path>) -> Result<Vec<Repair>, LogError> {
    one_target(segments, out)?;
    segments.iter().map(|log| repair(log, out)).collect()
}

/// One object for a log of one segment; otherwise a list with one object per segment.
fn json<T>(results: &[T], to_json: fn(&T) -> String) -> String {
    match results {
        [one] => to_json(one),
        several => format!("[{}]", several.iter().map(to_json).collect::<Vec<_>>().join(",\n")),
    }
}

/// The texts of all segments, one after the other.
fn text<T>(results: &[T], to_text: fn(&T) -> String) -> String {
    results.iter().map(to_text).collect()
}

fn export(segments: &[PathBuf], channel: CsvChannel, out: Option<&Path>) -> Result<(), LogError> {
    let mut log = RunLog::open(segments)?;
    let target = out.unwrap_or(Path::new("standard output"));
    let failed = |error| LogError::Export { path: target.to_owned(), error };
    // Opening the log for writing would empty it.
    if out.is_some_and(|out| segments.iter().any(|log| is_same_file(out, log))) {
        return Err(failed(std::io::Error::other("it is the log itself")));
    }
    let mut sink: Box<dyn Write> = match out {
        Some(file) => Box::new(File::create(file).map_err(failed)?),
        None => Box::new(std::io::stdout().lock()),
    };
    match csv(&mut log, channel, &mut BufWriter::new(&mut sink)) {
        // The reader of standard output has closed it: nothing more is wanted.
        Err(error) if out.is_none() && error.kind() == ErrorKind::BrokenPipe => return Ok(()),
        done => drop(done.map_err(failed)??),
    }
    if !log.finished() {
        print_error_line(&format!(
            "tectum: the log {} was cut off; it was exported as far as it goes",
            log.path().display()
        ));
    }
    Ok(())
}

/// Exports with the Python package, which says itself what is wrong with its input.
fn export_by_python(log: &Path, format: ExportFormat, channel: ChannelArgument, out: &Path) -> ExitCode {
    let name = channel.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
    let export = if format == ExportFormat::Lerobot { PythonExport::LeRobot } else { PythonExport::Parquet(name) };
    let found = find(log).map_err(|error| error.to_string());
    match found.and_then(|segments| export_with_python(log, &segments, &export, out)) {
        Ok(code) => code,
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            ExitCode::from(exit::INPUT)
        }
    }
}

/// Whether both paths lead to the same file.
fn is_same_file(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}
