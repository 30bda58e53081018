//! A film as MP4: ffmpeg gets the frames as they are, through its standard input.

use std::fs::{File, Permissions};
use std::io::{ErrorKind, Read as _, Seek as _, Write as _};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use super::FilmError;
use crate::report::ReportError;
use crate::report::film::Film;

/// The program, which is looked for where programs are.
const FFMPEG: &str = "ffmpeg";

/// Requires that ffmpeg is there.
pub(super) fn check() -> Result<(), FilmError> {
    let mut command = Command::new(FFMPEG);
    command.arg("-version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    match command.status() {
        Ok(_) => Ok(()),
        Err(error) => Err(not_started(&error)),
    }
}

fn not_started(error: &std::io::Error) -> FilmError {
    match error.kind() {
        ErrorKind::NotFound => FilmError::NoFfmpeg,
        _ => FilmError::Ffmpeg { said: error.to_string() },
    }
}

/// Writes `film` to `path`. The file appears when it is whole.
pub(super) fn write(film: &Film, path: &Path) -> Result<usize, FilmError> {
    let failed = |error: std::io::Error| ReportError::Write { path: path.to_owned(), error };
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // Others may read it as far as the user's mask allows, as any other file.
    let open = Permissions::from_mode(0o666);
    let draft = tempfile::Builder::new().suffix(".mp4").permissions(open).tempfile_in(folder).map_err(failed)?;
    // A file, and no pipe, which would fill up while nobody reads.
    let mut said = tempfile::tempfile().map_err(failed)?;
    let mut frames = film.frames();
    let [width, height] = frames.size();
    let mut command = Command::new(FFMPEG);
    command.args(["-hide_banner", "-loglevel", "error", "-y", "-f", "rawvideo", "-pixel_format", "rgb24"]);
    command.args([
        "-video_size",
        &format!("{width}x{height}"),
        "-framerate",
        &format!("{:.4}", 1.0 / frames.frame_s()),
    ]);
    // The pixels that every player knows, and the index at the begin, so that it plays while it is loaded.
    command.args(["-i", "pipe:0", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4"]).arg(draft.path());
    command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(said.try_clone().map_err(failed)?);
    let mut child = command.spawn().map_err(|error| not_started(&error))?;
    let mut written = Ok(());
    let mut pipe = child.stdin.take();
    while let (Some(pipe), Some(pixels)) = (&mut pipe, frames.draw_next()) {
        written = pipe.write_all(pixels.as_flattened());
        if written.is_err() {
            break;
        }
    }
    drop(pipe);
    finish(child, &mut said, written)?;
    let bytes = draft.as_file().metadata().map_err(failed)?.len();
    draft.persist(path).map_err(|error| failed(error.error))?;
    Ok(bytes as usize)
}

/// Waits for the end of ffmpeg. What it says itself explains more than that it no longer reads.
fn finish(mut child: Child, said: &mut File, written: std::io::Result<()>) -> Result<(), FilmError> {
    let status = child.wait().map_err(|error| FilmError::Ffmpeg { said: error.to_string() })?;
    if status.success() && written.is_ok() {
        return Ok(());
    }
    let mut text = String::new();
    let _ = said.rewind().and_then(|()| said.read_to_string(&mut text));
    let last = text.lines().map(str::trim).rfind(|line| !line.is_empty()).map(str::to_owned);
    Err(FilmError::Ffmpeg { said: last.unwrap_or_else(|| status.to_string()) })
}
