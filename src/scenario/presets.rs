//! The scenarios that are built into the program, so that an installed `tectum` runs in any folder.
//!
//! They are the files of the project's `scenarios/` folder, byte for byte.

use std::path::{Component, Path};

use super::{Scenario, ScenarioError, error::either};

/// A built-in scenario.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Preset {
    /// The name by which it is found.
    pub name: &'static str,
    /// The text of its TOML file.
    pub text: &'static str,
}

const PRESETS: &[Preset] = &[
    Preset { name: "arm", text: include_str!("../../scenarios/arm.toml") },
    Preset { name: "paper", text: include_str!("../../scenarios/paper.toml") },
    Preset { name: "eye", text: include_str!("../../scenarios/eye.toml") },
    Preset { name: "near", text: include_str!("../../scenarios/near.toml") },
    Preset { name: "laplace", text: include_str!("../../scenarios/laplace.toml") },
    Preset { name: "limited", text: include_str!("../../scenarios/limited.toml") },
    Preset { name: "relative", text: include_str!("../../scenarios/relative.toml") },
    Preset { name: "collision", text: include_str!("../../scenarios/collision.toml") },
    Preset { name: "todorov", text: include_str!("../../scenarios/todorov.toml") },
    Preset { name: "open-loop-3", text: include_str!("../../scenarios/open-loop-3.toml") },
    Preset { name: "open-loop-4", text: include_str!("../../scenarios/open-loop-4.toml") },
    Preset { name: "office", text: include_str!("../../scenarios/office.toml") },
    Preset { name: "servo-simulated", text: include_str!("../../scenarios/servo-simulated.toml") },
    Preset { name: "servo-emulated", text: include_str!("../../scenarios/servo-emulated.toml") },
    Preset { name: "servo-vision", text: include_str!("../../scenarios/servo-vision.toml") },
];

/// The built-in scenarios, the one to start with first.
pub fn presets() -> &'static [Preset] {
    PRESETS
}

impl Preset {
    /// The scenario that the preset's text says, as it stands.
    pub fn scenario(&self) -> Result<Scenario, ScenarioError> {
        Scenario::parse(self.text, &format!("{}.toml (built in)", self.name))
    }
}

impl Scenario {
    /// Finds a scenario by path or name: an existing file wins; otherwise `arm`, `arm.toml` and `scenarios/arm.toml`
    /// all name the built-in `arm`.
    ///
    /// # Errors
    ///
    /// [`ScenarioError::UnknownName`], which lists the built-in scenarios, if it is neither; otherwise as
    /// [`load`](Self::load).
    pub fn find(name_or_path: impl AsRef<Path>) -> Result<Self, ScenarioError> {
        let path = name_or_path.as_ref();
        // A folder that happens to be called like a preset does not hide it: only a file wins.
        if path.exists() && !path.is_dir() {
            return Self::load(path);
        }
        if let Some(preset) = preset(path) {
            return preset.scenario();
        }
        if path.exists() {
            return Self::load(path);
        }
        Err(unknown(path.display().to_string()))
    }

    /// The built-in scenario of this name, whatever files lie about.
    ///
    /// # Errors
    ///
    /// [`ScenarioError::UnknownName`] if there is none.
    pub fn built_in(name: &str) -> Result<Self, ScenarioError> {
        let preset = PRESETS.iter().find(|preset| preset.name == name).ok_or_else(|| unknown(name.to_owned()))?;
        preset.scenario()
    }
}

fn unknown(name: String) -> ScenarioError {
    let names: Vec<_> = PRESETS.iter().map(|preset| preset.name).collect();
    ScenarioError::UnknownName { name, presets: either(&names, "and") }
}

/// The preset that a path names, if it is one of ours: bare or in `scenarios/`, with or without `.toml`.
fn preset(path: &Path) -> Option<&'static Preset> {
    let parts: Vec<_> = path.components().filter(|part| *part != Component::CurDir).collect();
    let file = match parts.as_slice() {
        [file] => file,
        [folder, file] if folder.as_os_str() == "scenarios" => file,
        _ => return None,
    };
    let file = file.as_os_str().to_str()?;
    let name = file.strip_suffix(".toml").unwrap_or(file);
    PRESETS.iter().find(|preset| preset.name == name)
}
