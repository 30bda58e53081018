//! `tectum new`: a small project for a plant or a controller of your own, which builds and runs at once.
//!
//! The files are templates beside this module. They are compiled in, so that an installed program has them.

mod error;
mod name;
mod templates;

pub use error::NewProjectError;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::Serialize;

/// What a project is to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProjectKind {
    /// A plant: it takes the simulator's place.
    Plant,
    /// A controller: it takes the place of Tectum's own.
    Controller,
}

impl ProjectKind {
    /// The kind in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plant => "plant",
            Self::Controller => "controller",
        }
    }
}

/// The language of a project.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProjectLanguage {
    /// A cargo package.
    Rust,
    /// A script that uses the Python package `tectum`.
    Python,
}

impl ProjectLanguage {
    /// The language in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rust => "Rust",
            Self::Python => "Python",
        }
    }
}

/// How a project refers to Tectum.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum TectumSource {
    /// The checkout from which this program was built.
    Path(PathBuf),
    /// The published package of this version.
    Version(String),
}

impl TectumSource {
    /// The checkout from which this program was built, if it is still there, and otherwise the published package. A
    /// package from a registry is not a checkout: it lacks the folder of the workspace's other crates.
    pub fn of_this_program() -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
        if folder.join("crates/tectum-testkit/Cargo.toml").is_file() {
            Self::Path(folder.to_owned())
        } else {
            Self::Version(env!("CARGO_PKG_VERSION").to_owned())
        }
    }
}

/// A project that was made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NewProject {
    /// Its name.
    pub name: String,
    /// What it is.
    pub kind: ProjectKind,
    /// Its language.
    pub language: ProjectLanguage,
    /// Its folder.
    pub folder: PathBuf,
    /// Its files, in the folder.
    pub files: Vec<String>,
    /// How it refers to Tectum.
    pub tectum: TectumSource,
    /// The commands that build, test and run it, in order.
    pub next: Vec<String>,
}

/// Makes a project in the folder `parent`. It is there completely or not at all. `program` is the command by which the
/// user calls `tectum`, for the next commands.
///
/// # Errors
///
/// If the name is none for a package, the folder exists, or a file cannot be written.
pub fn create(
    parent: &Path,
    name: &str,
    kind: ProjectKind,
    language: ProjectLanguage,
    program: &str,
) -> Result<NewProject, NewProjectError> {
    name::check(name)?;
    let folder = parent.join(name);
    if folder.symlink_metadata().is_ok() {
        return Err(NewProjectError::Exists { path: folder });
    }
    let tectum = TectumSource::of_this_program();
    let failed = |path: &Path, source: io::Error| NewProjectError::Write { path: path.to_owned(), source };
    // A relative folder without a name is the current one.
    let parent = if parent.as_os_str().is_empty() { Path::new(".") } else { parent };
    let draft = tempfile::Builder::new().prefix(".tectum-new-").tempdir_in(parent).map_err(|e| failed(&folder, e))?;
    let files = templates::files(kind, language);
    for file in files {
        let path = draft.path().join(file.path);
        let text = templates::fill(file.text, name, &tectum);
        let written = path.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::write(&path, text));
        written.map_err(|error| failed(&folder.join(file.path), error))?;
    }
    let draft = draft.keep();
    if let Err(error) = publish(&draft, &folder) {
        let _ = fs::remove_dir_all(&draft);
        return Err(failed(&folder, error));
    }
    let next = templates::next_commands(name, language, &tectum, program);
    let files = files.iter().map(|file| file.path.to_owned()).collect();
    Ok(NewProject { name: name.to_owned(), kind, language, folder, files, tectum, next })
}

/// Gives the folder of a draft its name and the usual permissions; a temporary folder is its owner's alone.
fn publish(draft: &Path, folder: &Path) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    let usual = fs::metadata(draft.join("README.md"))?.permissions().mode() & 0o777;
    // Whoever may read the files may enter the folder.
    fs::set_permissions(draft, fs::Permissions::from_mode(usual | 0o100 | (usual & 0o044) >> 2))?;
    fs::rename(draft, folder)
}

impl NewProject {
    /// The project as text: what it is, how it refers to Tectum, and the next commands.
    pub fn to_text(&self) -> String {
        let Self { name, kind, language, files, .. } = self;
        let tectum = match &self.tectum {
            TectumSource::Path(path) => format!("by path, in the checkout {}", path.display()),
            TectumSource::Version(version) => format!("by version, {version}"),
        };
        let next: String = self.next.iter().map(|command| format!("  {command}\n")).collect();
        format!(
            "{name}: a {} in {}, {} files. It refers to Tectum {tectum}.\nNext:\n{next}",
            kind.name(),
            language.name(),
            files.len(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [(ProjectKind, ProjectLanguage); 4] = [
        (ProjectKind::Plant, ProjectLanguage::Rust),
        (ProjectKind::Controller, ProjectLanguage::Rust),
        (ProjectKind::Plant, ProjectLanguage::Python),
        (ProjectKind::Controller, ProjectLanguage::Python),
    ];

    #[test]
    fn a_project_is_complete_and_has_no_placeholder_left() {
        let parent = tempfile::tempdir().unwrap();
        for (i, (kind, language)) in ALL.into_iter().enumerate() {
            let project = create(parent.path(), &format!("mine-{i}"), kind, language, "tectum").unwrap();
            for file in &project.files {
                let text = fs::read_to_string(project.folder.join(file)).unwrap();
                assert!(!text.contains("{{") && !text.contains("}}"), "{file}: {text}");
                assert!(text.lines().all(|line| line.chars().count() <= 120), "{file}");
            }
            assert!(project.files.iter().any(|file| file == "README.md"));
            assert!(project.files.iter().any(|file| file == "scenario.toml"));
        }
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), ALL.len(), "no draft is left");
    }

    #[test]
    fn an_existing_folder_or_file_is_refused_and_kept() {
        let parent = tempfile::tempdir().unwrap();
        fs::write(parent.path().join("mine"), "mine").unwrap();
        let error = create(parent.path(), "mine", ProjectKind::Plant, ProjectLanguage::Rust, "tectum").unwrap_err();
        assert!(matches!(error, NewProjectError::Exists { .. }), "{error}");
        assert_eq!(fs::read_to_string(parent.path().join("mine")).unwrap(), "mine");
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_named() {
        let error =
            create(Path::new("/proc"), "mine", ProjectKind::Plant, ProjectLanguage::Rust, "tectum").unwrap_err();
        assert!(error.to_string().starts_with("/proc/mine cannot be written: "), "{error}");
    }
}
