//! The browser's face: one page with all that it needs, and the messages that it is sent.
//!
//! A reader of the page gets one `hello` for each run and then updates. Each reader has a [`PageCursor`], so that one
//! that is slow gets fewer and larger updates, and what it missed as far as it is still kept.

use serde_json::{Value, json};

use crate::run_view::ROLES;
use crate::{Curve, RunView, Stage, TickRecord};

/// Seconds between two messages with curves.
const CURVES_EVERY_S: f64 = 1.0;
/// Significant digits of numbers in messages.
const DIGITS: usize = 5;

/// The page: HTML with styles and scripts in it. It asks only for `events` beside it.
pub fn page() -> String {
    // In this order: the last part holds braces of its own.
    include_str!("page.html")
        .replacen("/*uplot.css*/", include_str!("uPlot.min.css"), 1)
        .replacen("/*page.css*/", include_str!("page.css"), 1)
        .replacen("/*uplot.js*/", include_str!("uPlot.iife.min.js"), 1)
        .replacen("/*plots.js*/", include_str!("plots.js"), 1)
        .replacen("/*page.js*/", include_str!("page.js"), 1)
}

/// How much of a run a reader of the page has got.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PageCursor {
    /// Which run it knows; 0 for none.
    generation: u64,
    next_record: u64,
    next_event: u64,
    /// When it gets curves again, s.
    next_curves: f64,
    /// Whether it knows that the run is over.
    knows_end: bool,
}

impl PageCursor {
    /// The messages that bring the reader up to date, as JSON. `generation` numbers the runs from 1, and `now` is the
    /// watcher's own time, s. Empty if there is nothing new.
    pub fn update(&mut self, view: &RunView, generation: u64, now: f64) -> Vec<String> {
        let mut messages = Vec::new();
        if self.generation != generation {
            *self = Self { generation, ..Self::default() };
            messages.push(hello(view, generation).to_string());
        }
        if self.knows_end {
            return messages;
        }
        self.knows_end = view.ended.is_some();
        let records: Vec<Value> =
            view.records().skip_while(|record| record.number < self.next_record).map(record_json).collect();
        let mut message = state(view);
        message["kind"] = "update".into();
        message["records"] = records.into();
        message["events"] = self.events(view);
        self.next_record = view.next_record();
        self.next_event = view.events.next_number();
        if now >= self.next_curves || view.ended.is_some() {
            self.next_curves = now + CURVES_EVERY_S;
            message["curves"] = curves(view);
        }
        messages.push(message.to_string());
        messages
    }

    fn events(&self, view: &RunView) -> Value {
        let new = view.events.iter().filter(|event| event.number >= self.next_event);
        let new = new.map(|event| {
            let (tick, kind) = (event.tick, event.kind.name());
            let (last, text) = (event.last_tick, &event.text);
            json!({"tick": tick, "last": last, "kind": kind, "text": text, "count": event.count})
        });
        new.collect()
    }
}

/// A number with few digits; null for what is no number.
fn number(x: f64) -> Value {
    if !x.is_finite() {
        return Value::Null;
    }
    let digits = DIGITS - 1;
    format!("{x:.digits$e}").parse::<f64>().map_or(Value::Null, Value::from)
}

fn numbers(values: &[f32]) -> Value {
    values.iter().map(|&x| number(f64::from(x))).collect()
}

/// The run and its signals.
fn hello(view: &RunView, generation: u64) -> Value {
    let facts = &view.facts;
    let signals = |signals: &[crate::SignalRange]| -> Value {
        let json = |s: &crate::SignalRange| {
            let [min, max] = [s.min, s.max].map(|end| number(end.into()));
            json!({"name": s.name, "unit": s.unit, "min": min, "max": max})
        };
        signals.iter().map(json).collect()
    };
    let frame = facts.arm.map(|frame| json!({"centre": numbers(&frame.centre), "half": number(frame.half.into())}));
    json!({
        "kind": "hello",
        "generation": generation,
        "name": facts.name,
        "scenario": facts.scenario,
        "seed": facts.seed,
        "realtime": facts.realtime,
        "period_s": facts.period_ns as f64 / 1e9,
        "ticks": facts.ticks,
        "inputs": signals(&facts.inputs),
        "outputs": signals(&facts.outputs),
        "error_unit": facts.error_unit,
        "has_error": facts.error.is_some(),
        "arm": frame,
        "changes": facts.changes,
    })
}

fn record_json(record: &TickRecord) -> Value {
    json!({
        "t": record.tick,
        "f": record.flags,
        "x": numbers(&record.inputs),
        "u": numbers(&record.applied),
        "l": number(record.loss.into()),
        "e": record.error.map(|e| number(e.into())),
        "p": record.posture.iter().map(|point| numbers(point)).collect::<Value>(),
        "g": record.target.map(|target| numbers(&target)),
    })
}

/// The numbers of now: what `tectum watch --json` prints, and a part of every update.
pub fn state(view: &RunView) -> Value {
    let processes = ROLES.iter().zip(&view.processes).map(|(role, process)| {
        json!({
            "name": role,
            "state": process.state.name(),
            "bad": process.state.is_bad(),
            "pid": process.pid,
            "start": process.restarts + 1,
            "ticks": process.ticks,
            "missed": process.missed,
            "late": process.late,
            "lost": process.lost,
        })
    });
    let stages = Stage::ALL.into_iter().map(|stage| {
        let quantiles = view.stages[stage as usize].quantiles([0.01, 0.5, 0.99]);
        let quantiles = quantiles.map(|q| json!({"p1": number(q[0]), "p50": number(q[1]), "p99": number(q[2])}));
        json!({"name": stage.name(), "us": quantiles})
    });
    json!({
        "run": view.facts.name,
        "tick": view.ticks_done(),
        "ticks": view.facts.ticks,
        "ended": view.ended,
        "rate": number(view.rate),
        "left_s": view.seconds_left().map(number),
        "loss": view.newest().map(|record| number(record.loss.into())),
        "error": view.newest().and_then(|record| record.error).map(|e| number(e.into())),
        "weights_norm": number(view.weights_norm.into()),
        "processes": processes.collect::<Value>(),
        "stages": stages.collect::<Value>(),
        "taken": view.taken,
        "passed_over": view.passed_over,
    })
}

fn curves(view: &RunView) -> Value {
    let columns = |curve: &Curve| -> Value {
        let (ticks, values): (Vec<u64>, Vec<Value>) = curve.points().map(|(tick, y)| (tick, number(y))).unzip();
        json!([ticks, values])
    };
    let targets =
        view.targets.iter().map(|target| json!([target.from, number(target.loss), target.end_error.map(number)]));
    let histogram = |stage: Stage| -> Value {
        view.stages[stage as usize].histogram().map(|(us, n)| json!([number(us), n])).collect()
    };
    json!({
        "loss": columns(&view.loss),
        "error": columns(&view.error),
        "targets": targets.collect::<Value>(),
        "answer": histogram(Stage::Answer),
        "sensing": histogram(Stage::Sensing),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run_view::tests::{facts, take_tick};

    #[test]
    fn the_page_is_whole_and_names_no_other_place() {
        let page = page();
        assert!(page.contains("new uPlot(") && !page.contains("/*page.js*/") && !page.contains("/*uplot.css*/"));
        for word in ["src=", "@import", "url(", "http://", "cdn"] {
            assert!(!page.contains(word), "{word}");
        }
        assert_eq!(page.matches("</script>").count(), 3);
    }

    #[test]
    fn a_reader_gets_each_tick_once_and_a_new_run_from_its_begin() {
        let mut view = RunView::new(facts());
        (0..10).for_each(|tick| take_tick(&mut view, tick));
        let mut cursor = PageCursor::default();
        let parse = |messages: Vec<String>| -> Vec<Value> {
            messages.iter().map(|message| serde_json::from_str(message).unwrap()).collect()
        };
        let first = parse(cursor.update(&view, 1, 0.0));
        assert_eq!((first.len(), &first[0]["kind"], &first[0]["scenario"]), (2, &json!("hello"), &json!("arm")));
        assert_eq!(first[1]["records"].as_array().unwrap().len(), 10);
        assert_eq!((&first[1]["curves"]["loss"][0][0], &first[1]["records"][0]["l"]), (&json!(0), &Value::Null));
        take_tick(&mut view, 10);
        view.say("hello");
        let second = parse(cursor.update(&view, 1, 0.1));
        let ticks: Vec<_> = second[0]["records"].as_array().unwrap().iter().map(|record| &record["t"]).collect();
        assert_eq!((ticks, &second[0]["events"][0]["text"]), (vec![&json!(10)], &json!("hello")));
        assert!(second[0].get("curves").is_none());
        let next = parse(cursor.update(&RunView::new(facts()), 2, 0.2));
        assert_eq!((next.len(), next[1]["records"].as_array().unwrap().len()), (2, 0));
    }

    #[test]
    fn numbers_are_short() {
        let texts = [0.1_f32, 1.0 / 3.0, f32::NAN, 12345.678].map(|x| number(x.into()).to_string());
        assert_eq!(texts, ["0.1", "0.33333", "null", "12346.0"]);
    }
}
