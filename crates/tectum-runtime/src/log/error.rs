//! Errors of writing and reading a log. Each message names the file, the cause and the remedy.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

/// Why a log cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// Creating, writing or closing the log failed.
    #[error("the log {} cannot be written: {}; {}", path.display(), cause(error), remedy(error.kind()))]
    Write {
        /// The log's file.
        path: PathBuf,
        /// The error of the operating system.
        error: io::Error,
    },
    /// The log is no longer what was written: somebody removed, replaced or truncated it.
    #[error("the log {} {what} while it was being written", path.display())]
    Gone {
        /// The log's file.
        path: PathBuf,
        /// What happened to it.
        what: &'static str,
    },
    /// A file made from the log cannot be written.
    #[error("{} cannot be written: {}; choose another --out", path.display(), cause(error))]
    Export {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        error: io::Error,
    },
    /// Opening or reading the log failed.
    #[error("the log {} cannot be read: {}", path.display(), cause(error))]
    Read {
        /// The log's file.
        path: PathBuf,
        /// The error of the operating system.
        error: io::Error,
    },
    /// There is no such file, or the folder has no log.
    #[error("{} {why}; give a log, or the folder of a run", path.display())]
    NoLog {
        /// The path that was given.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// Only a whole log can be packed.
    #[error(
        "the log {} is torn: its run was killed, or is still going on; make it whole with tectum log repair first",
        path.display()
    )]
    Torn {
        /// The log's file.
        path: PathBuf,
    },
    /// The logger is still writing the log.
    #[error("the log {} is still being written by its logger; wait until its run is over", path.display())]
    InUse {
        /// The log's file.
        path: PathBuf,
    },
    /// The file name under which the torn original would be kept is taken.
    #[error(
        "{} exists already, and the torn log would be kept under that name; move it away, or give another file with \
         --out",
        path.display()
    )]
    Kept {
        /// The file name for the original.
        path: PathBuf,
    },
    /// The header handed in cannot go into a log.
    #[error("the log {} cannot be described: {why}", path.display())]
    Header {
        /// The log's file.
        path: PathBuf,
        /// What is wrong with the header.
        why: String,
    },
    /// The file is not a log, or a log that was cut off inside its header.
    #[error("{} is not a log of this program: {why}", path.display())]
    NotALog {
        /// The file.
        path: PathBuf,
        /// What is missing or wrong.
        why: String,
    },
    /// The log was written by a build whose samples have another layout.
    #[error(
        "the log {} holds {found} on {topic}, and this build reads {expected}; read it with the build that wrote it \
         ({build})", path.display()
    )]
    Version {
        /// The log's file.
        path: PathBuf,
        /// Topic of the channel.
        topic: String,
        /// The sample type in the log.
        found: String,
        /// The sample type of this build.
        expected: &'static str,
        /// The build that wrote the log, as the log names it.
        build: String,
    },
    /// Bytes stand behind the end of a whole log, as a copy program or a file system may leave them.
    #[error(
        "the log {} is whole up to byte {end}, and other bytes stand behind its end; `tectum log repair` cuts them off",
        path.display()
    )]
    BehindEnd {
        /// The log's file.
        path: PathBuf,
        /// Where the log ends, bytes from the start of the file.
        end: u64,
    },
    /// A record in the middle is invalid, or a checksum is wrong: the file was changed after it was written.
    #[error("the log {} is damaged at byte {at}: {why}; records before that point were read", path.display())]
    Damaged {
        /// The log's file.
        path: PathBuf,
        /// Bytes from the start of the file to the invalid record; for a checksum, to the end of the bytes that
        /// it covers.
        at: u64,
        /// What is wrong.
        why: String,
    },
}

impl LogError {
    /// Whether the disk, the quota or the file-size limit is used up.
    pub fn is_full(&self) -> bool {
        let LogError::Write { error, .. } = self else { return false };
        matches!(error.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge)
    }

    pub(super) fn write(path: &Path, error: io::Error) -> LogError {
        LogError::Write { path: path.to_owned(), error }
    }

    /// The error of a log at `path` that cannot be read.
    pub fn read(path: &Path, error: io::Error) -> LogError {
        LogError::Read { path: path.to_owned(), error }
    }

    pub(super) fn not_a_log(path: &Path, why: impl Into<String>) -> LogError {
        LogError::NotALog { path: path.to_owned(), why: why.into() }
    }
}

/// The cause in plain words, or else the operating system's own text.
fn cause(error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::StorageFull => "no space left on device".into(),
        ErrorKind::QuotaExceeded => "the disk quota is used up".into(),
        ErrorKind::FileTooLarge => "the limit on the size of a file is reached".into(),
        ErrorKind::PermissionDenied => "permission denied".into(),
        ErrorKind::ReadOnlyFilesystem => "the file system is read-only".into(),
        ErrorKind::AlreadyExists => "the file exists already".into(),
        ErrorKind::NotADirectory => "a part of its path is a file, not a folder".into(),
        ErrorKind::IsADirectory => "it is a folder".into(),
        ErrorKind::NotFound => "there is no such file or folder".into(),
        _ => error.to_string(),
    }
}

fn remedy(kind: ErrorKind) -> &'static str {
    match kind {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
            "free some space, choose another --out or thin the log with [log] every"
        }
        ErrorKind::FileTooLarge => "raise the limit (ulimit -f) or thin the log with [log] every",
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => "choose an --out that you may write to",
        ErrorKind::AlreadyExists => "a log is never overwritten: choose another --out or move the file away",
        ErrorKind::NotFound => "make the folder first or choose another --out",
        _ => "choose another --out",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(code: i32) -> (String, bool) {
        let e = LogError::write(Path::new("/x/log.mcap"), io::Error::from_raw_os_error(code));
        (e.to_string(), e.is_full())
    }

    #[test]
    fn messages_name_path_cause_and_remedy() {
        let (enospc, efbig, eacces, eexist, enotdir) = (28, 27, 13, 17, 20);
        assert_eq!(
            message(enospc),
            (
                "the log /x/log.mcap cannot be written: no space left on device; free some space, choose another --out \
                 or thin the log with [log] every"
                    .into(),
                true
            )
        );
        let (text, full) = message(efbig);
        assert!(text.contains("size of a file") && text.contains("ulimit -f") && full, "{text}");
        for (code, words) in [(eacces, "permission denied"), (eexist, "exists already"), (enotdir, "not a folder")] {
            let (text, full) = message(code);
            assert!(text.contains("/x/log.mcap") && text.contains(words) && text.contains("--out"), "{text}");
            assert!(!full);
        }
    }
}
