//! The scenarios that are built into the program, so that an installed `tectum` runs in any folder.
//!
//! They are byte-for-byte copies of the files in the project's `scenarios/` folder.

use std::path::{Component, Path};

use super::{
    Scenario, ScenarioError,
    error::{nearest_name, word_list},
};

/// A built-in scenario.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Preset {
    /// The name by which it is found.
    pub name: &'static str,
    /// Description, one sentence.
    pub about: &'static str,
    /// The text of its TOML file.
    pub text: &'static str,
}

/// A preset whose text is `scenarios/<name>.toml`.
macro_rules! preset {
    ($name:literal, $about:literal) => {
        Preset { name: $name, about: $about, text: include_str!(concat!("../scenarios/", $name, ".toml")) }
    };
}

const PRESETS: &[Preset] = &[
    preset!("arm", "A planar arm with four joints learns to reach for targets; after two minutes one joint blocks."),
    preset!("paper", "The closed-loop arm of Daucé & Dutech (2010) with the paper's own rule: 12 million ticks."),
    preset!("eye", "The paper's eye with a log-polar retina learns to look at a moving target, one saccade a tick."),
    preset!("near", "The paper's arm, rewarded only within a given distance of the target."),
    preset!("laplace", "The paper's arm, explored with Laplace (L1) noise instead of Gaussian noise."),
    preset!("limited", "The paper's arm with joints that stop at the end of their range."),
    preset!("relative", "The paper's arm with each joint angle measured from the segment before it."),
    preset!("collision", "The paper's arm with a penalty for every pair of segments that cross."),
    preset!("todorov", "The paper's arm with the reward of Todorov and Jordan (2002), which has no penalty on angles."),
    preset!("open-loop-3", "An arm with three segments takes one posture a trial, rewarded by its visual error alone."),
    preset!("open-loop-4", "An arm with four segments takes one posture a trial, rewarded by its visual error alone."),
    preset!("office", "The arm of `arm` under injected faults: lost, late and corrupt samples, and killed processes."),
    preset!("pendulum", "Gymnasium's Pendulum-v1: a weak motor swings a rod up and balances it."),
    preset!("cart-pole", "dm_control's cart-pole: a cart swings a pole up and balances it."),
    preset!("so101", "The arm SO-101, simulated: five joints between stops, with a lag; targets in three dimensions."),
    preset!("so101-emulated", "The arm of `so101` on emulated servos with position goals; its gripper is held."),
    preset!(
        "so101-planar",
        "As `so101-emulated`, but only its three joints with parallel axes move: targets in a plane."
    ),
    preset!("servo-simulated", "The arm of `servo-emulated` with the simulator in the place of the servos."),
    preset!("servo-emulated", "An arm on four emulated Dynamixel servos behind a pseudo-terminal, in real time."),
    preset!("servo-vision", "As `servo-emulated`, but a tracker (such as a camera) reports target and end-effector."),
];

/// The built-in scenarios, in the order in which they are most used.
pub fn presets() -> &'static [Preset] {
    PRESETS
}

impl Preset {
    /// The built-in scenario of this name. Does not look at files: `arm`, `arm.toml` and `scenarios/arm.toml`
    /// all name `arm`.
    ///
    /// # Errors
    ///
    /// [`ScenarioError::UnknownName`] if there is none.
    pub fn named(name: &str) -> Result<&'static Self, ScenarioError> {
        preset_for(Path::new(name)).ok_or_else(|| ScenarioError::UnknownName {
            name: name.to_owned(),
            searched: "no built-in scenario has that name".to_owned(),
            remedy: remedy(name),
        })
    }

    /// Parses the preset's text.
    pub fn scenario(&self) -> Result<Scenario, ScenarioError> {
        Scenario::parse(self.text, &format!("{}.toml (built in)", self.name))
    }
}

impl Scenario {
    /// Finds a scenario by path or name. An existing file takes precedence. Otherwise `arm`, `arm.toml` and
    /// `scenarios/arm.toml` all name the built-in `arm`.
    ///
    /// # Errors
    ///
    /// [`ScenarioError::UnknownName`] if it is neither; it names the places searched and the nearest scenarios.
    /// Otherwise as [`load`](Self::load).
    pub fn find(name_or_path: impl AsRef<Path>) -> Result<Self, ScenarioError> {
        let path = name_or_path.as_ref();
        // A folder with the name of a preset does not hide the preset. Only a file does.
        if path.exists() && !path.is_dir() {
            return Self::load(path);
        }
        if let Some(preset) = preset_for(path) {
            return preset.scenario();
        }
        if path.exists() {
            return Self::load(path);
        }
        let name = path.display().to_string();
        let file = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let searched = format!("no file {} exists, and no built-in scenario has that name", file.display());
        let with_extension = format!("{name}.toml");
        let remedy = if Path::new(&with_extension).is_file() {
            format!("did you mean {with_extension:?}?")
        } else {
            remedy(&name)
        };
        Err(ScenarioError::UnknownName { name, searched, remedy })
    }

    /// The built-in scenario of this name. Does not look at files.
    ///
    /// # Errors
    ///
    /// [`ScenarioError::UnknownName`] if there is none.
    pub fn built_in(name: &str) -> Result<Self, ScenarioError> {
        Preset::named(name)?.scenario()
    }
}

/// The preset that a path names, if any. The path may begin with `scenarios/` and end with `.toml`.
fn preset_for(path: &Path) -> Option<&'static Preset> {
    let parts: Vec<_> = path.components().filter(|part| *part != Component::CurDir).collect();
    let file = match parts.as_slice() {
        [file] => file,
        [folder, file] if folder.as_os_str() == "scenarios" => file,
        _ => return None,
    };
    let name = without_extension(file.as_os_str().to_str()?);
    PRESETS.iter().find(|preset| preset.name == name)
}

/// The remedy for an unknown name: the nearest presets, or all of them.
fn remedy(name: &str) -> String {
    let nearest: Vec<_> = nearest(name).into_iter().map(|preset| format!("{preset:?}")).collect();
    if nearest.is_empty() {
        let names: Vec<_> = PRESETS.iter().map(|preset| preset.name).collect();
        return format!("the built-in ones are {}", word_list(&names, "and"));
    }
    format!("did you mean {}?", word_list(&nearest, "or"))
}

/// The presets that begin with the name, such as `servo`. If there are none, the preset with the smallest edit
/// distance, if that is small. Folder, extension and case are ignored.
fn nearest(name: &str) -> Vec<&'static str> {
    let file = Path::new(name).file_name().and_then(|file| file.to_str()).unwrap_or(name);
    let name = without_extension(file).to_lowercase();
    if name.is_empty() {
        return Vec::new();
    }
    let names = || PRESETS.iter().map(|preset| preset.name);
    let with_prefix: Vec<_> = names().filter(|preset| preset.starts_with(&name)).collect();
    if !with_prefix.is_empty() {
        return with_prefix;
    }
    // Of several equal ones the first, and presets are in the order in which they are most used.
    nearest_name(&name, names()).into_iter().collect()
}

fn without_extension(file: &str) -> &str {
    file.strip_suffix(".toml").unwrap_or(file)
}
