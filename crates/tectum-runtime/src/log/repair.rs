//! Repairs a torn log: copies everything up to its last whole record, and adds the end that its logger did not
//! write.
//!
//! MCAP readers treat files without an end differently: some return what is there, some refuse the whole file.
//! After a repair the log has an ordinary end: totals, MCAP's summary and checksums. The totals are counted
//! from the messages and marked `repaired`, and the record `tectum.repair` states at which byte the log was
//! torn. The existing records stay the same, byte for byte. A damaged log is refused, because a new checksum
//! would hide the damage.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufReader, BufWriter, ErrorKind, Read, Seek, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::copier::RecordCopier;
use super::{LogError, LogReader, LogTotals, MessageCounts, REPAIR_METADATA, TOTALS_METADATA, in_use};

#[cfg(test)]
mod tests;

/// The result of a repair.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Repair {
    /// The log that was given.
    pub log: PathBuf,
    /// The contents of the repaired log; null if the log was whole and was not changed.
    pub mended: Option<TornContents>,
    /// The whole log.
    pub whole: PathBuf,
    /// The file in which the torn original is kept.
    pub torn: Option<PathBuf>,
}

/// The contents of a torn log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TornContents {
    /// End of its last whole record, bytes from its start.
    pub torn_at: u64,
    /// Bytes after that, of an incomplete record, which were left out.
    pub left_out: u64,
    /// Messages: observations, commands, learning records, gaps.
    pub messages: [u64; 4],
    /// Its last tick.
    pub last_tick: Option<u64>,
    /// Whether the log was whole, and only other bytes stood behind its end.
    pub whole: bool,
}

impl TornContents {
    fn of(counts: &MessageCounts, torn_at: u64, left_out: u64) -> Self {
        let [observation, command, learning] = counts.channels.each_ref().map(|channel| channel.messages);
        let last_tick = counts.channels.iter().filter_map(|channel| channel.ticks).map(|(_, last)| last).max();
        Self { torn_at, left_out, messages: [observation, command, learning, counts.gaps], last_tick, whole: false }
    }
}

impl Repair {
    /// The object of `--json`.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// The result as text.
    pub fn to_text(&self) -> String {
        let Some(mended) = &self.mended else {
            return format!("{} is whole; it was left alone\n", self.log.display());
        };
        let TornContents { torn_at, left_out, messages: [observations, commands, learnings, gaps], last_tick, whole } =
            mended;
        let was = if *whole { "had other bytes behind its end," } else { "was torn" };
        let last = last_tick.map_or(String::new(), |tick| format!(", up to tick {tick}"));
        let mut text = format!(
            "{} {was} at byte {torn_at}; {} is whole\n{observations} observations, {commands} commands, {learnings} \
             learning records, {gaps} gaps{last}; {left_out} bytes behind them were left out\n",
            self.log.display(),
            self.whole.display(),
        );
        if let Some(torn) = &self.torn {
            text += &format!("original  {}\n", torn.display());
        }
        text
    }
}

/// Repairs the torn log at `path`. Without `out` the repaired log replaces it, and the original is kept beside
/// it as `<name>.torn`; with `out` the repaired log is written there. It is written as a whole or not at all. A
/// whole log is not changed.
///
/// # Errors
///
/// As [`LogReader::open`] and its iterator, [`LogError::Damaged`] above all; [`LogError::InUse`] while its
/// logger is running; [`LogError::Kept`] if there is a `.torn` file already; [`LogError::Write`] if the new
/// file cannot be written or exists.
pub fn repair(path: &Path, out: Option<&Path>) -> Result<Repair, LogError> {
    let read = |e| LogError::read(path, e);
    let file = File::open(path).map_err(read)?;
    if in_use(&file) {
        return Err(LogError::InUse { path: path.to_owned() });
    }
    let target = out.unwrap_or(path);
    let write = |e| LogError::write(target, e);
    let folder = target.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if out.is_some_and(Path::exists) {
        return Err(write(ErrorKind::AlreadyExists.into()));
    }

    let mut draft = tempfile::NamedTempFile::new_in(folder).map_err(write)?;
    let open = || Ok(Box::new(File::open(path).map_err(read)?) as Box<dyn Read + Send>);
    let mut sink = BufWriter::new(draft.as_file_mut());
    let mended = mend(path, open, &mut sink).map_err(|error| match error {
        LogError::Write { error, .. } => write(error),
        other => other,
    })?;
    let Some(mended) = mended else {
        return Ok(Repair { log: path.to_owned(), mended: None, whole: path.to_owned(), torn: None });
    };
    sink.flush().map_err(write)?;
    drop(sink);
    let permissions = file.metadata().map_err(read)?.permissions();
    draft.as_file().set_permissions(permissions).map_err(write)?;
    draft.as_file().sync_all().map_err(write)?;
    let torn = if out.is_some() {
        draft.persist_noclobber(target).map_err(|e| write(e.error))?;
        None
    } else {
        // The original gets its second name first, so that at no instant either file is without a name.
        let torn = torn_name(path);
        fs::hard_link(path, &torn).map_err(|e| match e.kind() {
            ErrorKind::AlreadyExists => LogError::Kept { path: torn.clone() },
            _ => LogError::write(&torn, e),
        })?;
        draft.persist(target).map_err(|e| write(e.error))?;
        Some(torn)
    };
    // Also syncs the names.
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(write)?;
    Ok(Repair { log: path.to_owned(), mended: Some(mended), whole: target.to_owned(), torn })
}

/// `log.mcap.torn` for `log.mcap`.
fn torn_name(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".torn");
    name.into()
}

/// Writes the repaired log to `sink`. Returns `None` and writes nothing if the log is whole already. `open`
/// returns the log's bytes from the start, and is called twice.
///
/// # Errors
///
/// As [`repair`]; an error of `sink` is a [`LogError::Write`] that names `path`.
pub fn mend<W: Write + Seek>(
    path: &Path,
    mut open: impl FnMut() -> Result<Box<dyn Read + Send>, LogError>,
    sink: W,
) -> Result<Option<TornContents>, LogError> {
    let mut log = LogReader::over(path, open()?)?;
    let mut counts = log.message_counts();
    for record in log.by_ref() {
        match record {
            Ok(record) => {
                counts.take(&record);
            }
            Err(LogError::BehindEnd { end, .. }) => return cut_off(path, open()?, sink, end, &counts).map(Some),
            Err(error) => return Err(error),
        }
    }
    if log.finished() {
        return Ok(None);
    }
    let mut copier = RecordCopier::begin(path, BufReader::new(open()?), sink, log.position(), plain())?;
    while copier.copy_record()? {}
    let mended = TornContents::of(&counts, log.position(), copier.incomplete_bytes()?);
    // A log can be torn after the logger's own totals, which are kept.
    let without_totals = log.totals().is_none();
    if without_totals {
        copier.add_metadata(TOTALS_METADATA, counted_totals(&log, &counts, &mended))?;
    }
    copier.add_metadata(
        REPAIR_METADATA,
        BTreeMap::from([
            ("torn_at".into(), mended.torn_at.to_string()),
            ("left_out".into(), mended.left_out.to_string()),
            ("totals".into(), if without_totals { "counted" } else { "logger" }.into()),
            ("build".into(), crate::BUILD.into()),
        ]),
    )?;
    copier.finish()?;
    Ok(Some(mended))
}

/// A log's layout while it is written: without chunks.
fn plain() -> mcap::WriteOptions {
    mcap::WriteOptions::new().use_chunks(false).compression(None)
}

/// Copies a whole log up to its end, at byte `end`, and leaves out what stands behind it.
fn cut_off(
    path: &Path,
    mut source: Box<dyn Read + Send>,
    mut sink: impl Write,
    end: u64,
    counts: &MessageCounts,
) -> Result<TornContents, LogError> {
    let mut log = source.by_ref().take(end);
    std::io::copy(&mut log, &mut sink).map_err(|e| LogError::write(path, e))?;
    let behind = std::io::copy(&mut source, &mut std::io::sink()).map_err(|e| LogError::read(path, e))?;
    Ok(TornContents { whole: true, ..TornContents::of(counts, end, behind) })
}

/// Totals counted from the messages, and those of the earlier segments. Whether the run reached its end is not
/// known.
fn counted_totals(log: &LogReader, counts: &MessageCounts, mended: &TornContents) -> BTreeMap<String, String> {
    let (thinned, before) = (log.every() > 1, log.log_segment());
    let totals = LogTotals {
        lost: counts.channels.each_ref().map(|channel| channel.stated),
        thinned: std::array::from_fn(|i| {
            before.thinned[i].saturating_add(if thinned { counts.channels[i].unexplained } else { 0 })
        }),
        duplicates: before.duplicates,
        missing_from: log.missing_from(),
        last_tick: mended.last_tick,
        complete: false,
    };
    let mut map = totals.to_map(std::array::from_fn(|i| before.written[i].saturating_add(mended.messages[i])));
    map.insert("repaired".into(), "true".into());
    map
}
