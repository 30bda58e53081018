//! The film of a run from its log: the arm's reaches, or a pendulum's episodes, are read, and three of them are shown.

mod video;

use std::f32::consts::FRAC_PI_2;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::log::{LogError, LogRecord, RunLog};
use crate::report::ReportError;
use crate::report::film::{
    EARLY_REACHES, Film, FilmPanel, LATE_REACHES, ReachSelector, RecordedReach, SelectedReaches, centimetres, seconds,
};
use crate::runtime::Snapshot;
use crate::scenario::{ArmConfig, Plan, Scenario, ScenarioError};
use crate::supervise::{RunProgress, body_changes, reach};
use crate::text::{columns, thousands};
use crate::wire::{MAX_INPUTS, Observation, flag};

/// Why there is no film of a log.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// The log.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The scenario in the log.
    #[error("the scenario in the log {} cannot be read: {error}; read it with the build that wrote it", path.display())]
    Scenario {
        /// The log.
        path: PathBuf,
        /// What is wrong with it.
        error: Box<ScenarioError>,
    },
    /// Ticks were left out on purpose.
    #[error(
        "the log {} holds every {every}th tick only, and a film shows all of them; run the scenario again with \
         `every = 1` under [log]", path.display()
    )]
    Thinned {
        /// The log.
        path: PathBuf,
        /// Every how many ticks are in it.
        every: u64,
    },
    /// The plant is neither an arm nor a pendulum, or an arm whose ticks are no movement.
    #[error(
        "the plant of scenario \"{scenario}\" is {plant}, and a film shows an arm that reaches for targets, or a \
         pendulum; run a scenario with [plant.arm] and a closed loop, or with [plant.pendulum]"
    )]
    NoReaches {
        /// The scenario's name.
        scenario: String,
        /// What its plant is instead.
        plant: &'static str,
    },
    /// There are not enough reaches to choose from.
    #[error(
        "the log {} is too short for a film: {ticks} ticks hold {} whole {}, and it needs the first, \
         {EARLY_REACHES} from ten seconds on, and one after those; make a longer run",
        path.display(), thousands(*reaches), if *reaches == 1 { movement[0] } else { movement[1] }
    )]
    TooShort {
        /// The log.
        path: PathBuf,
        /// Ticks that it holds.
        ticks: u64,
        /// Whole reaches in it.
        reaches: u64,
        /// What one of them is called, and several.
        movement: [&'static str; 2],
    },
    /// The film cannot be written.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// The file's name says nothing that a film can be.
    #[error("{} is no name of a film; its end is the format, so let it end with .svg, .gif or .mp4", path.display())]
    Format {
        /// The file.
        path: PathBuf,
    },
    /// There is no ffmpeg.
    #[error("ffmpeg, which writes MP4, is not installed; install it, or write a film.gif or a film.svg")]
    NoFfmpeg,
    /// ffmpeg failed.
    #[error("ffmpeg, which writes MP4, failed: {said}; write a film.gif or a film.svg")]
    Ffmpeg {
        /// What it said last.
        said: String,
    },
}

/// A film that was written.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WrittenFilm {
    /// The file.
    pub file: PathBuf,
    /// Its size.
    pub bytes: usize,
    /// What it shows, from left to right.
    pub panels: Vec<WrittenPanel>,
}

/// What a panel of the film shows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WrittenPanel {
    /// The panel's headline.
    pub caption: String,
    /// The tick at which the target appeared.
    pub from: u64,
    /// The instant of that tick, s from tick 0 of the run.
    pub seconds: f64,
    /// Distance between end-effector and target when the next target appeared, m.
    pub end_error_m: f64,
}

impl WrittenFilm {
    /// A film that was written to `file`.
    pub fn new(film: &Film, file: &Path, bytes: usize) -> Self {
        let panel = |panel: &FilmPanel| WrittenPanel {
            caption: panel.caption.clone(),
            from: panel.reach.reach.from,
            seconds: panel.seconds(film.period_s)[0],
            end_error_m: panel.reach.end_error_m,
        };
        Self { file: file.to_owned(), bytes, panels: film.panels.iter().map(panel).collect() }
    }

    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// A table for people, and the file.
    pub fn to_text(&self) -> String {
        let mut rows = vec![["panel", "from tick", "time", "error at the end"].map(str::to_owned)];
        rows.extend(self.panels.iter().map(|panel| {
            let from = thousands(panel.from);
            [panel.caption.clone(), from, seconds(panel.seconds), centimetres(panel.end_error_m)]
        }));
        format!("{}\nfilm  {} ({} bytes)\n", columns(&rows), self.file.display(), thousands(self.bytes as u64))
    }
}

/// Writes `film` to `path`, in place of a file that is there, in the format that the name ends with: `.svg`, `.gif`, or
/// `.mp4` where ffmpeg is installed. Gives its size in bytes.
///
/// # Errors
/// [`FilmError::Format`] for another name, [`FilmError::NoFfmpeg`] and [`FilmError::Ffmpeg`] for MP4, and
/// [`FilmError::Report`] if the file cannot be written.
pub fn write(film: &Film, path: &Path) -> Result<usize, FilmError> {
    match format_of(path)? {
        FilmFormat::Svg => Ok(write_file(path, film.to_svg().as_bytes())?),
        FilmFormat::Gif => Ok(write_file(path, &film.to_gif()?)?),
        FilmFormat::Mp4 => video::write(film, path),
    }
}

fn write_file(path: &Path, bytes: &[u8]) -> Result<usize, ReportError> {
    std::fs::write(path, bytes).map_err(|error| ReportError::Write { path: path.to_owned(), error })?;
    Ok(bytes.len())
}

/// How a film is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FilmFormat {
    Svg,
    Gif,
    Mp4,
}

/// The format that the name of a film's file ends with.
fn format_of(path: &Path) -> Result<FilmFormat, FilmError> {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
    match extension.as_deref() {
        Some("svg") => Ok(FilmFormat::Svg),
        Some("gif") => Ok(FilmFormat::Gif),
        Some("mp4") => Ok(FilmFormat::Mp4),
        _ => Err(FilmError::Format { path: path.to_owned() }),
    }
}

/// Requires that a film can be written to `path`, before the log is read.
///
/// # Errors
/// [`FilmError::Format`] for a name that ends with something else, [`FilmError::NoFfmpeg`] for MP4 without ffmpeg.
pub fn check_name(path: &Path) -> Result<(), FilmError> {
    match format_of(path)? {
        FilmFormat::Mp4 => video::check(),
        FilmFormat::Svg | FilmFormat::Gif => Ok(()),
    }
}

/// Makes the film of the run whose log lies in `segments`. With `progress`, a line on standard error shows how far it
/// is, if that is a terminal.
///
/// # Errors
/// [`FilmError`] if it is no log, is thinned or too short, or its plant is no arm that reaches.
pub fn film(segments: &[PathBuf], progress: bool) -> Result<Film, FilmError> {
    let mut log = RunLog::open(segments)?;
    let path = log.path().to_owned();
    let plan = Scenario::parse(log.scenario(), "scenario.toml")
        .and_then(Scenario::plan)
        .map_err(|error| FilmError::Scenario { path: path.clone(), error: Box::new(error) })?;
    let body = filmed_body(&plan)?;
    let arm = body.arm();
    if log.every() > 1 {
        return Err(FilmError::Thinned { path, every: log.every() });
    }
    let period_s = plan.period_ns as f64 / 1e9;
    let changes = body_changes(arm);
    let mut selector = ReachSelector::new(period_s, changes.iter().map(|change| change.tick).collect());
    let mut recorder = ReachRecorder::new(&plan, &body);
    let mut ticks = 0;
    let mut progress = RunProgress::study(&plan.scenario.name, plan.scenario.ticks, progress);
    for record in log.by_ref() {
        let LogRecord::Observation(observation) = record.inspect_err(|_| progress.clear())? else { continue };
        ticks += 1;
        if observation.header.tick.is_multiple_of(64) {
            progress.show_study(observation.header.tick, (f32::NAN, f32::NAN));
        }
        if let Some(reach) = recorder.take(&observation) {
            selector.add(reach);
        }
    }
    progress.clear();
    let reaches = selector.count();
    let selected = selector.select().ok_or(FilmError::TooShort { path, ticks, reaches, movement: body.movement() })?;
    Ok(compose(&plan, &body, selected))
}

/// What a film shows.
enum FilmedBody<'a> {
    /// An arm; a reach lasts from target to target.
    Arm(&'a ArmConfig),
    /// A pendulum, drawn as an arm of one segment, 1 m long, whose target is the upright position; a reach is an
    /// episode.
    Pendulum(Box<ArmConfig>),
}

impl FilmedBody<'_> {
    fn pendulum() -> Self {
        Self::Pendulum(Box::new(ArmConfig { lengths: vec![1.0], base: [0.0, 0.0], ..ArmConfig::default() }))
    }

    /// The arm that is drawn.
    fn arm(&self) -> &ArmConfig {
        match self {
            Self::Arm(arm) => arm,
            Self::Pendulum(rod) => rod,
        }
    }

    /// The drawn arm's inputs: the target's position, and then the angles.
    fn inputs(&self, inputs: &[f32; MAX_INPUTS]) -> [f32; MAX_INPUTS] {
        match self {
            Self::Arm(_) => *inputs,
            Self::Pendulum(_) => {
                let mut drawn = [0.0; MAX_INPUTS];
                // The pendulum's angle counts from upright, the arm's from the x axis.
                drawn[..3].copy_from_slice(&[0.0, 1.0, inputs[0] + FRAC_PI_2]);
                drawn
            }
        }
    }

    /// What a movement is called, and several.
    fn movement(&self) -> [&'static str; 2] {
        match self {
            Self::Arm(_) => ["reach", "reaches"],
            Self::Pendulum(_) => ["episode", "episodes"],
        }
    }
}

/// The body of a plan whose movements can be shown.
fn filmed_body(plan: &Plan) -> Result<FilmedBody<'_>, FilmError> {
    let plant = &plan.scenario.plant;
    let no = |what| FilmError::NoReaches { scenario: plan.scenario.name.clone(), plant: what };
    match (&plant.arm, &plant.pendulum, &plant.eye) {
        (Some(arm), ..) if arm.open_loop => Err(no("an arm in an open loop, where each tick is a trial of its own")),
        (Some(arm), ..) => Ok(FilmedBody::Arm(arm)),
        (None, Some(_), _) => Ok(FilmedBody::pendulum()),
        (None, None, Some(_)) => Err(no("an eye")),
        (None, None, None) => Err(no("neither an arm nor a pendulum")),
    }
}

/// Puts observations together to whole reaches.
struct ReachRecorder<'a> {
    body: &'a FilmedBody<'a>,
    /// Where the measure `error` stands, if the plant measures it.
    error: Option<usize>,
    /// The reach in progress, from the observation in which its target appeared.
    snapshots: Vec<Snapshot>,
    /// No observation is missing in it, and all its numbers are finite.
    whole: bool,
}

impl<'a> ReachRecorder<'a> {
    fn new(plan: &Plan, body: &'a FilmedBody<'a>) -> Self {
        // A pendulum's error is an angle.
        let error = plan.error.filter(|_| matches!(body, FilmedBody::Arm(_)));
        Self { body, error, snapshots: Vec::new(), whole: false }
    }

    /// Takes the next observation. Gives the reach that ended with it, if one did and is whole.
    fn take(&mut self, observation: &Observation) -> Option<RecordedReach> {
        let tick = observation.header.tick;
        let inputs = &observation.inputs;
        let finite = inputs.iter().all(|x| x.is_finite());
        let in_a_row = self.snapshots.last().is_none_or(|last| last.tick + 1 == tick);
        self.whole &= finite && in_a_row;
        self.snapshots.push(Snapshot { tick, inputs: self.body.inputs(inputs) });
        if observation.header.flags & flag::NEW_TARGET == 0 {
            if !self.whole {
                self.snapshots.clear();
            }
            return None;
        }
        let done = if self.whole { self.close(observation) } else { None };
        self.snapshots.drain(..self.snapshots.len() - 1);
        self.whole = finite;
        done
    }

    /// The reach that ends with `observation`, which has the posture at the end of its last tick, unless another
    /// episode begins with it.
    fn close(&self, observation: &Observation) -> Option<RecordedReach> {
        let is_another = observation.header.flags & (flag::TERMINATED | flag::TRUNCATED) != 0;
        let last = self.snapshots.len() - usize::from(is_another);
        let reach = reach(self.body.arm(), &self.snapshots[..last])?;
        let end = reach.postures.last()?.last()?;
        let distance = (end[0] - reach.target[0]).hypot(end[1] - reach.target[1]);
        let end_error_m = self.error.map_or(distance, |i| f64::from(observation.measures[i]));
        end_error_m.is_finite().then_some(RecordedReach { reach, end_error_m })
    }
}

/// Panels, captions and remarks.
fn compose(plan: &Plan, body: &FilmedBody, selected: SelectedReaches) -> Film {
    let arm = body.arm();
    let period_s = plan.period_ns as f64 / 1e9;
    let panel = |caption: &str, reach: RecordedReach| {
        let from = reach.reach.from;
        let blocked: Vec<usize> =
            arm.block.iter().filter(|block| block.tick <= from).map(|block| block.joint).collect();
        let last_change = body_changes(arm).into_iter().rfind(|change| change.tick <= from);
        let remark = last_change.map(|c| format!("{} at {}", c.label, seconds(c.tick as f64 * period_s)));
        FilmPanel { caption: caption.to_owned(), remark: remark.unwrap_or_default(), blocked, reach }
    };
    let late = match selected.changed {
        Some(changed) if arm.block.iter().any(|block| block.tick == changed) => "After the joint blocks",
        Some(_) => "After the body changes",
        None => "At the end",
    };
    let choice = choice(&selected, body.movement()[0]);
    let caption = if let FilmedBody::Arm(_) = body { "The first target" } else { "The first episode" };
    let mut first = panel(caption, selected.first);
    if first.reach.reach.from == 0 && first.remark.is_empty() {
        // Not "before learning": the quicker rules learn to reach before it ends.
        first.remark = "untrained at the start".to_owned();
    }
    let panels = [first, panel("After ten seconds", selected.early), panel(late, selected.late)];
    Film { scenario: plan.scenario.name.clone(), seed: plan.scenario.seed, period_s, panels, choice }
}

/// How the reaches were chosen, in a line.
fn choice(selected: &SelectedReaches, movement: &str) -> String {
    let early = match selected.early_count {
        1 => "the one from 10 s on".to_owned(),
        n => format!("the median of the {n} from 10 s on"),
    };
    let late = match (selected.late_count, selected.changed) {
        (1, _) => "the last".to_owned(),
        (n, Some(_)) if n < LATE_REACHES => format!("the median of the {n} since the body changed"),
        (n, _) => format!("the median of the last {n}"),
    };
    format!("Shown: the first {movement}, {early}, and {late} (by end error). With exploration noise.")
}
