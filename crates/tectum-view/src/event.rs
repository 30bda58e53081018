//! What happened in a run, newest last, in bounded memory. What goes on tick after tick is one entry that counts.

use std::collections::VecDeque;

/// Entries that are kept.
const KEPT: usize = 200;
/// Characters of a text that are kept.
const LONGEST: usize = 400;

/// What kind of event it is; faces give each a colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunEventKind {
    /// A flag of a sample: something was late, missed or limited.
    Flag,
    /// A process died or was started again.
    Restart,
    /// A process said it.
    Message,
    /// The scenario changes the plant.
    Change,
    /// The run began or ended.
    Run,
}

impl RunEventKind {
    /// Name, for the page.
    pub const fn name(self) -> &'static str {
        ["flag", "restart", "message", "change", "run"][self as usize]
    }
}

/// An event.
#[derive(Debug, Clone, PartialEq)]
pub struct RunEvent {
    /// Number of the event, from 0; an entry that counts on gets a new one.
    pub number: u64,
    /// The tick at which it was seen first.
    pub tick: u64,
    /// The tick at which it was seen last.
    pub last_tick: u64,
    /// How often it was seen.
    pub count: u64,
    /// Its kind.
    pub kind: RunEventKind,
    /// What happened.
    pub text: String,
}

impl RunEvent {
    /// One line without the tick.
    pub fn line(&self) -> String {
        if self.count > 1 {
            format!("{} ({} times since tick {})", self.text, crate::thousands(self.count), crate::thousands(self.tick))
        } else {
            self.text.clone()
        }
    }
}

/// The last events.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EventLog {
    events: VecDeque<RunEvent>,
    next: u64,
}

impl EventLog {
    /// Adds an event. If an entry with the same text is less than `gap` ticks old, that one counts it.
    pub fn add(&mut self, tick: u64, kind: RunEventKind, text: &str, gap: u64) {
        let number = self.next;
        self.next += 1;
        let text: String = text.chars().filter(|c| !c.is_control()).take(LONGEST).collect();
        let known = self.events.iter().rposition(|event| event.kind == kind && event.text == text);
        if let Some(i) = known.filter(|&i| tick.saturating_sub(self.events[i].last_tick) < gap)
            && let Some(mut event) = self.events.remove(i)
        {
            (event.number, event.last_tick, event.count) = (number, tick, event.count + 1);
            self.events.push_back(event);
            return;
        }
        if self.events.len() == KEPT {
            self.events.pop_front();
        }
        self.events.push_back(RunEvent { number, tick, last_tick: tick, count: 1, kind, text });
    }

    /// The events, oldest first.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &RunEvent> {
        self.events.iter()
    }

    /// The number that the next event gets.
    pub fn next_number(&self) -> u64 {
        self.next
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_goes_on_is_one_entry_and_control_characters_are_left_out() {
        let mut log = EventLog::default();
        (10..20).for_each(|tick| log.add(tick, RunEventKind::Flag, "missed", 5));
        log.add(40, RunEventKind::Flag, "missed", 5);
        log.add(41, RunEventKind::Message, "\x1b[31mred\n", 0);
        log.add(41, RunEventKind::Message, "\x1b[31mred\n", 0);
        let lines: Vec<_> = log.iter().map(|event| (event.last_tick, event.line())).collect();
        let expected = [(19, "missed (10 times since tick 10)"), (40, "missed"), (41, "[31mred"), (41, "[31mred")];
        assert_eq!(lines, expected.map(|(tick, line)| (tick, line.to_owned())));
        (0..1000).for_each(|tick| log.add(tick * 10, RunEventKind::Flag, "late", 5));
        assert_eq!((log.iter().count(), log.next_number()), (KEPT, 1013));
    }
}
