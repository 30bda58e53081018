//! A log's channel as CSV: one row per sample, columns named as in the scenario, with units.

use std::io::{self, Write};

use super::header::flag_words;
use super::{CHANNELS, LogError, LogRecord, RunLog};
use crate::scenario::SignalConfig;
use crate::wire::{Header, MAX_COLUMNS, MAX_INPUTS, MAX_MEASURES, MAX_OUTPUTS, flag};

/// The channels of a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CsvChannel {
    /// The plant's observations.
    Observation,
    /// The controller's commands.
    Command,
    /// The learning records.
    Learning,
    /// The log's statements of missing samples.
    Gap,
}

/// The first columns of every channel but `gap`.
const HEADER: &str = "tick,time (s),sequence,scheduled (ns),sensed (ns),published (ns),incarnation,flags,lost before";

/// Writes the samples of `channel` in `log` to `out`, after a line of column names. Returns the number of rows.
///
/// Columns are named as in the scenario, with the unit in brackets; `applied`, `drawn` and so on precede the
/// name of an output. `time` is the tick's scheduled instant, from the start of the run. Flags are words
/// separated by `|`. `lost before` counts the samples that the log states to be missing right before the row;
/// those missing after the last sample are in a last row with that value only. A hash is hexadecimal, and empty
/// where the weights were not hashed.
///
/// # Errors
///
/// The outer error is that of writing to `out`, the inner one that of reading the log; all rows before the
/// error have been written.
pub fn csv(log: &mut RunLog, channel: CsvChannel, out: &mut dyn Write) -> io::Result<Result<u64, LogError>> {
    let names = ColumnNames::of(log);
    let mut line = names.line(channel);
    let mut counts = log.message_counts();
    let mut rows = 0;
    let period_ns: u64 = log.run("period_ns").and_then(|ns| ns.parse().ok()).unwrap_or(0);
    let columns = line.len();
    line.end(out)?;
    for record in log.by_ref() {
        let record = match record {
            Ok(record) => record,
            Err(error) => return Ok(Err(error)),
        };
        let lost = counts.take(&record);
        match (channel, &record) {
            (CsvChannel::Observation, LogRecord::Observation(s)) => {
                line.header(&s.header, period_ns, lost);
                line.floats(&s.inputs[..names.inputs.len()]);
                line.floats(&s.applied[..names.outputs.len()]);
                line.floats(&[s.reward]);
                line.put(&s.skipped.to_string());
                line.floats(&s.measures[..names.measures.len()]);
            }
            (CsvChannel::Command, LogRecord::Command(s)) => {
                line.header(&s.header, period_ns, lost);
                line.floats(&s.mean[..names.outputs.len()]);
                line.floats(&s.drawn[..names.outputs.len()]);
            }
            (CsvChannel::Learning, LogRecord::Learning(s)) => {
                line.header(&s.header, period_ns, lost);
                line.floats(&s.noise[..names.outputs.len()]);
                line.floats(&[s.reward, s.step, s.weights_norm, s.trace_norm]);
                line.floats(&s.columns[..names.columns.len()]);
                let hashed = s.header.flags & flag::HASHED != 0;
                line.put(&if hashed { format!("{:016x}", s.weights_hash) } else { String::new() });
            }
            (CsvChannel::Gap, LogRecord::Gap(s)) => {
                let name = usize::try_from(s.channel).ok().and_then(|i| CHANNELS.get(i));
                line.put(&name.map_or_else(|| s.channel.to_string(), |name| (*name).to_owned()));
                [s.first, s.count, s.total].iter().for_each(|n| line.put(&n.to_string()));
            }
            _ => continue,
        }
        rows += 1;
        line.end(out)?;
    }
    let lost_at_end = match channel {
        CsvChannel::Gap => 0,
        other => counts.channels[other as usize].lost_at_end(),
    };
    if lost_at_end > 0 {
        let column = HEADER.split(',').count() - 1;
        (0..columns).for_each(|i| line.put(&if i == column { lost_at_end.to_string() } else { String::new() }));
        line.end(out)?;
    }
    out.flush()?;
    Ok(Ok(rows))
}

/// The scenario's names, from the log's description of the run.
struct ColumnNames {
    inputs: Vec<String>,
    outputs: Vec<String>,
    measures: Vec<String>,
    columns: Vec<String>,
}

impl ColumnNames {
    fn of(log: &RunLog) -> Self {
        let signals = |key: &str, most: usize| {
            let table: Option<Vec<SignalConfig>> = log.run(key).and_then(|json| serde_json::from_str(json).ok());
            let named = |s: SignalConfig| if s.unit.is_empty() { s.name } else { format!("{} ({})", s.name, s.unit) };
            let mut names: Vec<String> = table.unwrap_or_default().into_iter().map(named).collect();
            names.truncate(most);
            names
        };
        let names = |key: &str, most: usize| {
            let names: Option<Vec<String>> = log.run(key).and_then(|json| serde_json::from_str(json).ok());
            let mut names = names.unwrap_or_default();
            names.truncate(most);
            names
        };
        Self {
            inputs: signals("inputs", MAX_INPUTS),
            outputs: signals("outputs", MAX_OUTPUTS),
            measures: names("measures", MAX_MEASURES),
            columns: names("columns", MAX_COLUMNS),
        }
    }

    /// The row of column names.
    fn line(&self, channel: CsvChannel) -> CsvRow {
        let mut line = CsvRow::default();
        let outputs = |line: &mut CsvRow, prefix: &str| {
            self.outputs.iter().for_each(|name| line.put(&format!("{prefix} {name}")));
        };
        if channel == CsvChannel::Gap {
            "channel,first,count,total".split(',').for_each(|name| line.put(name));
            return line;
        }
        HEADER.split(',').for_each(|name| line.put(name));
        match channel {
            CsvChannel::Observation => {
                self.inputs.iter().for_each(|name| line.put(name));
                outputs(&mut line, "applied");
                line.put("reward");
                line.put("skipped");
                self.measures.iter().for_each(|name| line.put(name));
            }
            CsvChannel::Command => {
                outputs(&mut line, "mean");
                outputs(&mut line, "drawn");
            }
            CsvChannel::Learning | CsvChannel::Gap => {
                outputs(&mut line, "noise");
                "reward,step,weights norm,trace norm".split(',').for_each(|name| line.put(name));
                self.columns.iter().for_each(|name| line.put(name));
                line.put("weights hash");
            }
        }
        line
    }
}

/// A row of comma-separated fields that is being built.
#[derive(Default)]
struct CsvRow {
    text: String,
    fields: usize,
}

impl CsvRow {
    fn len(&self) -> usize {
        self.fields
    }

    fn put(&mut self, field: &str) {
        if self.fields > 0 {
            self.text.push(',');
        }
        self.fields += 1;
        // RFC 4180: names come from a scenario and may contain any character.
        if field.contains([',', '"', '\n', '\r']) {
            self.text += &format!("\"{}\"", field.replace('"', "\"\""));
        } else {
            self.text += field;
        }
    }

    /// Writes each number with the fewest digits that give the same number again.
    fn floats(&mut self, values: &[f32]) {
        values.iter().for_each(|x| self.put(&format!("{x:?}")));
    }

    fn header(&mut self, header: &Header, period_ns: u64, lost: u64) {
        self.put(&header.tick.to_string());
        self.put(&format!("{:?}", (u128::from(header.tick) * u128::from(period_ns)) as f64 / 1e9));
        let stamps = [header.sequence, header.scheduled_ns, header.sensed_ns, header.published_ns];
        stamps.iter().for_each(|n| self.put(&n.to_string()));
        self.put(&header.incarnation.to_string());
        self.put(&flag_words(header.flags));
        self.put(&lost.to_string());
    }

    fn end(&mut self, out: &mut dyn Write) -> io::Result<()> {
        self.text.push('\n');
        let result = out.write_all(self.text.as_bytes());
        self.text.clear();
        self.fields = 0;
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_quoted_where_needed() {
        let (mut line, mut out) = (CsvRow::default(), Vec::new());
        ["plain", "a,b", "say \"x\"", ""].iter().for_each(|field| line.put(field));
        line.floats(&[0.1, -0.0, 1e-30, f32::NAN, f32::INFINITY]);
        line.end(&mut out).unwrap();
        assert_eq!(String::from_utf8(out).unwrap(), "plain,\"a,b\",\"say \"\"x\"\"\",,0.1,-0.0,1e-30,NaN,inf\n");
    }
}
