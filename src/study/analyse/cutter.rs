//! Cuts a log's observations into movements, each from one target's appearance to the next.

use super::AnalyseError;
use super::movement::RecordedMovement;
use crate::scenario::Plan;
use crate::wire::{Observation, flag};

/// Numbers of movements that were left out, by reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub(super) struct LeftOut {
    /// The position at their beginning was not measured: the run's first movement.
    pub without_start: u64,
    /// Samples are missing, ticks were missed or passed over, or a measure is not a number.
    pub gaps: u64,
    /// The log ends before they do: the run's last movement.
    pub unfinished: u64,
}

impl LeftOut {
    /// The sum of all reasons.
    pub fn total(self) -> u64 {
        self.without_start + self.gaps + self.unfinished
    }
}

/// A movement from a log.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MovementCut {
    /// The tick at which its target appeared.
    pub from: u64,
    /// Its recorded path.
    pub movement: RecordedMovement,
}

/// Cuts observations, in the order of ticks, into movements.
#[derive(Debug, Clone)]
pub(super) struct MovementCutter {
    /// Index of the measure `error`.
    pub error: usize,
    /// Indices of the measures `end_x` and `end_y`.
    end: [usize; 2],
    /// Indices of the inputs `target_x` and `target_y`, if the plant has them.
    target: Option<[usize; 2]>,
    current: Option<MovementCut>,
    /// The start of the current movement was not measured.
    without_start: bool,
    /// Something of the current movement is missing.
    gap: bool,
    last: Option<u64>,
    /// Movements that were left out so far.
    pub left_out: LeftOut,
}

/// Flags of a tick in which the plant did not follow the policy, so that the movement is not the policy's
/// own.
const BROKEN: u32 = flag::MISSED | flag::SKIPPED | flag::NON_FINITE;

impl MovementCutter {
    /// A cutter for the observations of `plan`.
    ///
    /// # Errors
    /// [`AnalyseError::NoMeasures`] if the plant does not measure error and end-effector.
    pub fn new(plan: &Plan) -> Result<Self, AnalyseError> {
        let measure = |name: &&str| match *name {
            "error" => plan.error,
            other => plan.measures.iter().position(|m| m == other),
        };
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

    /// The position of the end-effector, m.
    pub fn end(&self, measures: &[f32]) -> [f64; 2] {
        self.end.map(|i| f64::from(measures[i]))
    }

    /// Takes the next observation. Gives the movement that ended with it, if one ended and is complete.
    pub fn take(&mut self, observation: &Observation) -> Option<MovementCut> {
        let header = &observation.header;
        let first = header.flags & flag::FIRST != 0;
        let end = self.end(&observation.measures);
        let error = f64::from(observation.measures[self.error]);
        let consecutive = self.last.is_none_or(|last| last + 1 == header.tick);
        self.last = Some(header.tick);
        if let Some(cut) = &mut self.current {
            self.gap |= first || !consecutive || header.flags & BROKEN != 0;
            self.gap |= !(end[0].is_finite() && end[1].is_finite() && error.is_finite());
            cut.movement.points.push(end);
            cut.movement.errors.push(error);
        }
        if header.flags & (flag::NEW_TARGET | flag::EPISODE_END) == 0 {
            return None;
        }
        let done = self.close();
        let target = self.target.map(|t| t.map(|i| f64::from(observation.inputs[i])));
        // Without the target's position, the error after the first tick stands for the distance.
        let distance = target.map_or(f64::NAN, |t| (t[0] - end[0]).hypot(t[1] - end[1]));
        let movement = RecordedMovement { points: vec![end], errors: Vec::new(), distance };
        self.current = Some(MovementCut { from: header.tick, movement });
        self.without_start = first;
        self.gap = !(end[0].is_finite() && end[1].is_finite());
        done
    }

    /// For the current movement, the distance from the target when it appeared, m. `None` if the target's
    /// position is not known.
    pub fn distance(&self) -> Option<f64> {
        self.current.as_ref().map(|cut| cut.movement.distance).filter(|distance| distance.is_finite())
    }

    /// Ends the current movement. Gives it if it is complete; otherwise counts the reason.
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
        if cut.movement.distance.is_nan() {
            cut.movement.distance = cut.movement.errors[0];
        }
        Some(cut)
    }

    /// Ends the log: a movement in progress is left out.
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

    type LogChange = fn(&mut Vec<Observation>);

    fn cutter() -> MovementCutter {
        MovementCutter::new(&Scenario::find("paper").unwrap().plan().unwrap()).unwrap()
    }

    fn cut(cutter: &mut MovementCutter, observations: &[Observation]) -> Vec<u64> {
        observations.iter().filter_map(|o| cutter.take(o)).map(|cut| cut.from).collect()
    }

    /// The position at a target's appearance ends the old movement and begins the new one.
    #[test]
    fn a_movement_is_from_target_to_target() {
        let mut cutter = cutter();
        let cuts: Vec<MovementCut> = observations(0..35).iter().filter_map(|o| cutter.take(o)).collect();
        cutter.finish();
        assert_eq!(cuts.iter().map(|c| c.from).collect::<Vec<_>>(), [10, 20]);
        let movement = &cuts[0].movement;
        assert_eq!((movement.points.len(), movement.errors.len()), (11, 10));
        assert_eq!((movement.points[0], movement.points[10]), ([10.0, 0.0], [20.0, 0.0]));
        assert_eq!(movement.distance, 7_f64.hypot(4.0));
        assert_eq!(cutter.left_out, LeftOut { without_start: 1, gaps: 0, unfinished: 1 });
    }

    #[test]
    fn movements_with_gaps_are_left_out_and_counted() {
        let whole = observations(0..100);
        let broken: [LogChange; 5] = [
            |all| {
                all.remove(33);
            },
            |all| all[33].header.flags |= flag::MISSED | flag::HELD,
            |all| all[40].header.flags |= flag::SKIPPED,
            |all| all[33].measures[1] = f32::NAN,
            |all| all[33].measures[0] = f32::INFINITY,
        ];
        for (i, change) in broken.iter().enumerate() {
            let (mut all, mut cutter) = (whole.clone(), cutter());
            change(&mut all);
            assert_eq!(cut(&mut cutter, &all), [10, 20, 40, 50, 60, 70, 80], "{i}");
            assert_eq!(cutter.left_out.gaps, 1, "{i}");
        }
        // A limited command still belongs to the policy. A log may begin at any tick.
        let (mut all, mut cutter) = (whole[15..].to_vec(), cutter());
        all[20].header.flags |= flag::CLAMPED;
        assert_eq!(cut(&mut cutter, &all).len(), 7);
    }

    #[test]
    fn missing_measures_are_named() {
        let error = MovementCutter::new(&Scenario::find("eye").unwrap().plan().unwrap()).unwrap_err().to_string();
        assert!(error.contains("\"eye\"") && error.contains("`end_x and end_y`"), "{error}");
    }
}
