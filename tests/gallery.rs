//! The figures of the documents: each is shown, says what made it, has the house's style, and is what its command makes
//! today.
//!
//! ```text
//! cargo test --release --test gallery -- --ignored --nocapture           # runs every command: 15 minutes
//! TECTUM_FIGURES=arm.svg,eye.svg cargo test ...                          # only these
//! TECTUM_SNAPSHOTS=write cargo test ...                                  # writes docs/figures/*.svg anew
//! ```
//!
//! The paragraph under a figure names its command. *Made by* means: from seeds alone, so the bytes are compared.
//! *Measured by* means that no two runs are equal. `film.svg` has a test of its own (`tests/film.rs`), and the picture
//! of the page one in a browser (`tests/watch_web.rs`).

mod support;

use std::fs;
use std::path::{Path, PathBuf};

use support::TestFolder;

const FIGURES: &str = "docs/figures";

/// A figure where a document shows it.
struct ShownFigure {
    file: String,
    alternative_text: String,
    /// The paragraph that follows.
    below: String,
}

/// All figures that the documents show, in the order of the documents' names.
fn shown_figures() -> Vec<ShownFigure> {
    let documents = fs::read_dir("docs").unwrap().map(|entry| entry.unwrap().path());
    let mut documents: Vec<PathBuf> = documents.filter(|path| path.extension().is_some_and(|e| e == "md")).collect();
    documents.push("README.md".into());
    documents.sort();
    documents.iter().flat_map(|path| figures_of(&fs::read_to_string(path).unwrap())).collect()
}

fn figures_of(document: &str) -> Vec<ShownFigure> {
    let paragraphs: Vec<&str> = document.split("\n\n").collect();
    let figure = |(i, paragraph): (usize, &&str)| {
        let (alternative_text, file) = paragraph.trim().strip_prefix("![")?.strip_suffix(')')?.split_once("](")?;
        let file = file.strip_prefix("docs/").unwrap_or(file).strip_prefix("figures/")?;
        let below = paragraphs.get(i + 1).copied().unwrap_or_default().replace('\n', " ");
        Some(ShownFigure { file: file.to_owned(), alternative_text: alternative_text.to_owned(), below })
    };
    paragraphs.iter().enumerate().filter_map(figure).collect()
}

/// The command of a figure that follows from seeds alone, without the folder that it writes into.
fn command(figure: &ShownFigure) -> Option<String> {
    let text = figure.below.trim().strip_prefix("Made by `")?.trim_start_matches('`');
    let (command, _) = text.split_once('`')?;
    command.strip_suffix(" --out figures").map(str::to_owned)
}

#[test]
fn every_figure_is_shown_and_says_what_made_it() {
    let shown = shown_figures();
    for entry in fs::read_dir(FIGURES).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let places: Vec<&ShownFigure> = shown.iter().filter(|figure| figure.file == name).collect();
        assert_eq!(places.len(), 1, "{name} is shown {} times", places.len());
        let ShownFigure { alternative_text, below, .. } = places[0];
        assert!(alternative_text.len() > 15, "{name} has no words for those who do not see it");
        assert!(below.contains("`tectum ") || below.contains("cargo test"), "{name}: no command below it: {below}");
    }
    assert!(shown.iter().all(|figure| Path::new(FIGURES).join(&figure.file).is_file()));
    assert!(shown.iter().filter(|figure| command(figure).is_some()).count() >= 5);
}

/// One font and one palette: that of Okabe and Ito, which colour-blind readers can tell apart, with ink and grids.
#[test]
fn figures_have_one_style() {
    let series = ["D55E00", "E69F00", "56B4E9", "009E73", "0072B2", "CC79A7", "5A5A5A"];
    let frame = ["282828", "8C8C8C", "E4E4E4", "FFFFFF"];
    let tasks = ["tasks-arm", "tasks-cart-pole", "tasks-pendulum", "tasks-arm-relative-stops", "tasks-so101"];
    let others = ["arm", "eye", "learners", "mujoco", "open-loop", "performance-growth", "performance-latency"];
    for name in others.into_iter().chain(tasks) {
        let svg = fs::read_to_string(format!("{FIGURES}/{name}.svg")).unwrap();
        assert!(!svg.contains("<image") && !svg.contains("<style"), "{name}");
        let fonts = svg.matches("font-family=").count();
        assert!(fonts > 5 && fonts == svg.matches("font-family=\"sans-serif\"").count(), "{name}");
        let colours = svg.split("=\"#").skip(1).map(|rest| &rest[..6]);
        // Postures go from light to dark, in shades of one blue: less red than green, less green than blue.
        let shade = |c: &str| c[..2] < c[2..4] && c[2..4] < c[4..6];
        let strange = colours.filter(|c| !series.contains(c) && !frame.contains(c) && !shade(c)).collect::<Vec<_>>();
        assert!(strange.is_empty(), "{name}: {strange:?}");
    }
}

#[test]
#[ignore = "runs the studies of docs/results.md again: 15 minutes in a release build"]
fn figures_are_what_their_commands_make() {
    let only = std::env::var("TECTUM_FIGURES").ok();
    let asked = |file: &str| only.as_ref().is_none_or(|only| only.split(',').any(|one| one == file));
    let mut outdated = Vec::new();
    for figure in shown_figures().into_iter().filter(|figure| asked(&figure.file)) {
        let Some(command) = command(&figure) else { continue };
        if command.contains("examples/python") && !Path::new("target/python/bin/python").is_file() {
            println!("skipped: {} needs the environment of examples/python/README.md", figure.file);
            continue;
        }
        println!("{}: {command}", figure.file);
        let (made, shown) = (made_by(&command, &figure.file), Path::new(FIGURES).join(&figure.file));
        if std::env::var_os("TECTUM_SNAPSHOTS").is_some() {
            fs::write(&shown, &made).unwrap();
        } else if made != fs::read_to_string(&shown).unwrap() {
            outdated.push(figure.file);
        }
    }
    assert!(
        outdated.is_empty(),
        "{outdated:?} are not what their commands make; TECTUM_SNAPSHOTS=write makes them anew"
    );
}

/// The figure that a command makes, which stands in a document as a shell takes it: `figure.svg`, or that of the one
/// task in a study of tasks.
fn made_by(command: &str, file: &str) -> String {
    let test_folder = TestFolder::new();
    let folder = test_folder.path().join("figures");
    let arguments = command.strip_prefix("tectum ").expect("a command of tectum");
    let shell = format!("exec \"$0\" {arguments} --out \"$1\"");
    let mut process = std::process::Command::new("sh");
    process.args(["-c", &shell, support::TECTUM]).arg(&folder).stdout(std::process::Stdio::null());
    assert!(process.status().unwrap().success(), "{command}");
    fs::read_to_string(folder.join(file.strip_prefix("tasks-").unwrap_or("figure.svg"))).unwrap()
}
