//! From a log's observations to movements: each from one target's appearance to the next.

use super::AnalyseError;
use super::movement::RecordedMovement;
use crate::scenario::Plan;
use crate::wire::{Observation, flag};

/// Why movements were left out, and how many.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct LeftOut {
    /// The place that they began at was not measured: the run's first.
    pub without_start: u64,
    /// Samples are missing in them, ticks were missed or passed over, or a measure is not a number.
    pub gaps: u64,
    /// The log ends in them: the run's last.
    pub unfinished: u64,
}

impl LeftOut {
    /// All together.
    pub fn total(self) -> u64 {
        self.without_start + self.gaps + self.unfinished
    }
}

/// A movement cut out of a log.
#[derive(Debug, Clone, PartialEq)]
pub struct MovementCut {
    /// The tick at which its target appeared.
    pub from: u64,
    /// What was recorded of it.
    pub track: RecordedMovement,
}

/// Cuts observations, in their order, into movements.
#[derive(Debug, Clone)]
pub struct MovementCutter {
    /// Where the measures `error`, `end_x` and `end_y` stand.
    pub(super) error: usize,
    pub(super) end: [usize; 2],
    /// Where the inputs `target_x` and `target_y` stand, if the plant has them.
    target: Option<[usize; 2]>,
    current: Option<MovementCut>,
    /// What is wrong with it.
    without_start: bool,
    gap: bool,
    last: Option<u64>,
    /// Movements that were not given out.
    pub left_out: LeftOut,
}

/// What happened in the tick before an observation that makes a movement another than the policy's own.
const BROKEN: u32 = flag::MISSED | flag::SKIPPED | flag::NON_FINITE;

impl MovementCutter {
    /// A cutter for the observations of `plan`.
    ///
    /// # Errors
    /// [`AnalyseError::NoMeasures`] if the plant does not measure what movements are made of.
    pub fn new(plan: &Plan) -> Result<Self, AnalyseError> {
        let measure = |name: &&str| plan.measures.iter().position(|m| m == name);
        let (found, missing): (Vec<&str>, Vec<&str>) =
            ["error", "end_x", "end_y"].into_iter().partition(|name| measure(name).is_some());
        if !missing.is_empty() {
            return Err(AnalyseError::NoMeasures {
                scenario: plan.scenario.name.clone(),
                missing: missing.join(" and "),
                found: if found.is_empty() { "none of what is needed".to_owned() } else { found.join(" and ") },
            });
        }
        let at = |name: &str| measure(&name).unwrap_or_default();
        let input = |name: &str| plan.inputs.iter().position(|i| i.name == name);
        Ok(Self {
            error: at("error"),
            end: [at("end_x"), at("end_y")],
            target: input("target_x").zip(input("target_y")).map(|(x, y)| [x, y]),
            current: None,
            without_start: false,
            gap: false,
            last: None,
            left_out: LeftOut::default(),
        })
    }

    /// Where the end-effector was, m.
    pub(super) fn end(&self, measures: &[f32]) -> [f64; 2] {
        self.end.map(|i| f64::from(measures[i]))
    }

    /// Takes the next observation. Gives the movement that ended with it, if one did and is whole.
    pub fn take(&mut self, observation: &Observation) -> Option<MovementCut> {
        let header = &observation.header;
        let first = header.flags & flag::FIRST != 0;
        let end = self.end(&observation.measures);
        let error = f64::from(observation.measures[self.error]);
        let in_a_row = self.last.is_none_or(|last| last + 1 == header.tick);
        self.last = Some(header.tick);
        if let Some(cut) = &mut self.current {
            self.gap |= first || !in_a_row || header.flags & BROKEN != 0;
            self.gap |= !(end[0].is_finite() && end[1].is_finite() && error.is_finite());
            cut.track.points.push(end);
            cut.track.errors.push(error);
        }
        if header.flags & flag::NEW_TARGET == 0 {
            return None;
        }
        let done = self.close();
        let target = self.target.map(|t| t.map(|i| f64::from(observation.inputs[i])));
        // Without the target's place, the distance is what the first tick leaves of it.
        let distance = target.map_or(f64::NAN, |t| (t[0] - end[0]).hypot(t[1] - end[1]));
        let track = RecordedMovement { points: vec![end], errors: Vec::new(), distance };
        self.current = Some(MovementCut { from: header.tick, track });
        self.without_start = first;
        self.gap = !(end[0].is_finite() && end[1].is_finite());
        done
    }

    /// Distance from the target when it appeared, of the movement in progress, m; `None` if the target's place is not known.
    pub(super) fn distance(&self) -> Option<f64> {
        self.current.as_ref().map(|cut| cut.track.distance).filter(|distance| distance.is_finite())
    }

    fn close(&mut self) -> Option<MovementCut> {
        let mut cut = self.current.take()?;
        if self.without_start {
            self.left_out.without_start += 1;
            return None;
        }
        if self.gap {
            self.left_out.gaps += 1;
            return None;
        }
        if cut.track.distance.is_nan() {
            cut.track.distance = cut.track.errors[0];
        }
        Some(cut)
    }

    /// The log is over.
    pub fn finish(&mut self) {
        if self.current.take().is_some() {
            self.left_out.unfinished += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;

    fn observations(ticks: std::ops::Range<u64>) -> Vec<Observation> {
        ticks
            .map(|tick| {
                let mut o = Observation::default();
                o.header.tick = tick;
                let fresh = if tick.is_multiple_of(10) { flag::NEW_TARGET } else { 0 };
                o.header.flags = fresh | if tick == 0 { flag::FIRST } else { 0 };
                o.inputs[..2].copy_from_slice(&[3.0, 4.0]);
                o.measures[..3].copy_from_slice(&[0.5, tick as f32, 0.0]);
                o
            })
            .collect()
    }

    type Spoil = fn(&mut Vec<Observation>);

    fn cutter() -> MovementCutter {
        MovementCutter::new(&Scenario::find("paper").unwrap().plan().unwrap()).unwrap()
    }

    fn cut(cutter: &mut MovementCutter, observations: &[Observation]) -> Vec<u64> {
        observations.iter().filter_map(|o| cutter.take(o)).map(|cut| cut.from).collect()
    }

    /// The place at a target's appearance is the last of the old movement and the first of the new one.
    #[test]
    fn a_movement_is_from_target_to_target() {
        let mut cutter = cutter();
        let cuts: Vec<MovementCut> = observations(0..35).iter().filter_map(|o| cutter.take(o)).collect();
        cutter.finish();
        assert_eq!(cuts.iter().map(|c| c.from).collect::<Vec<_>>(), [10, 20]);
        let track = &cuts[0].track;
        assert_eq!((track.points.len(), track.errors.len()), (11, 10));
        assert_eq!((track.points[0], track.points[10]), ([10.0, 0.0], [20.0, 0.0]));
        assert_eq!(track.distance, 7_f64.hypot(4.0));
        assert_eq!(cutter.left_out, LeftOut { without_start: 1, gaps: 0, unfinished: 1 });
    }

    #[test]
    fn movements_with_gaps_are_left_out_and_counted() {
        let whole = observations(0..100);
        let broken: [Spoil; 5] = [
            |all| {
                all.remove(33);
            },
            |all| all[33].header.flags |= flag::MISSED | flag::HELD,
            |all| all[40].header.flags |= flag::SKIPPED,
            |all| all[33].measures[1] = f32::NAN,
            |all| all[33].measures[0] = f32::INFINITY,
        ];
        for (i, spoil) in broken.iter().enumerate() {
            let (mut all, mut cutter) = (whole.clone(), cutter());
            spoil(&mut all);
            assert_eq!(cut(&mut cutter, &all), [10, 20, 40, 50, 60, 70, 80], "{i}");
            assert_eq!(cutter.left_out.gaps, 1, "{i}");
        }
        // A limited command is the policy's own all the same; a log may begin anywhere.
        let (mut all, mut cutter) = (whole[15..].to_vec(), cutter());
        all[20].header.flags |= flag::CLAMPED;
        assert_eq!(cut(&mut cutter, &all).len(), 7);
    }

    #[test]
    fn measures_that_are_missing_are_named() {
        let error = MovementCutter::new(&Scenario::find("eye").unwrap().plan().unwrap()).unwrap_err().to_string();
        assert!(error.contains("\"eye\"") && error.contains("`end_x and end_y`"), "{error}");
    }
}
