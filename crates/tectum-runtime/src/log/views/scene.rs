//! The simulator's arm in space: a frame for each link, the links, the target, and the path of the end-effector, as
//! JSON messages of the types `foxglove.FrameTransforms` and `foxglove.SceneUpdate`.
//!
//! A viewer that begins in the middle, or jumps in a log, gets the last message of each topic. So each message holds
//! all that its topic shows, and what seldom changes is repeated every [`REPEATED`] ticks.

use std::collections::VecDeque;
use std::fmt::Write as _;

use tectum_core::plant::posture;

use crate::scenario::ArmConfig;
use crate::wire::{Observation, flag};

/// Ticks after which links and target are sent again.
const REPEATED: u32 = 20;
/// Ticks from one message with the path to the next.
const PATH_EVERY: u32 = 4;
/// Most points of a path, the newest ones.
const PATH_POINTS: usize = 64;
/// Sizes as shares of the arm's reach: thickness of a link, diameters of a joint and of the target.
const THICKNESS: f64 = 0.03;
const JOINT: f64 = 0.045;
const TARGET: f64 = 0.06;

/// What is shown of an arm. Its messages have the indices 0 (transforms), 1 (links), 2 (target) and 3 (path).
#[derive(Debug)]
pub(super) struct ArmScene {
    arm: ArmConfig,
    reach: f64,
    /// Observations since links and target were sent.
    since: u32,
    since_path: u32,
    lengths: Vec<f64>,
    path: VecDeque<[f64; 2]>,
    text: String,
}

impl ArmScene {
    pub fn new(arm: ArmConfig) -> Self {
        let reach = arm.lengths.iter().sum();
        Self {
            arm,
            reach,
            since: REPEATED,
            since_path: PATH_EVERY,
            lengths: Vec::new(),
            path: VecDeque::new(),
            text: String::new(),
        }
    }

    /// Makes the messages of an observation. With an input that is not a number there is no posture to show.
    pub fn take<E>(
        &mut self,
        observation: &Observation,
        ns: u64,
        mut send: impl FnMut(usize, &[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let (tick, n) = (observation.header.tick, self.arm.lengths.len());
        let inputs = &observation.inputs[..2 + n];
        if !inputs.iter().all(|x| x.is_finite()) {
            return Ok(());
        }
        let now = self.arm.at(tick);
        let points = posture(&now, &inputs[2..]);
        send(0, self.transforms(&points, ns).as_bytes())?;
        self.since += 1;
        if self.lengths != now.lengths || self.since >= REPEATED {
            self.lengths.clone_from(&now.lengths);
            send(1, self.links(ns).as_bytes())?;
        }
        let new_target = observation.header.flags & flag::NEW_TARGET != 0;
        if new_target || self.since >= REPEATED {
            let target = self.arm.reported_target(tick, [inputs[0], inputs[1]]).map(f64::from);
            send(2, self.target(target, ns).as_bytes())?;
        }
        if self.since >= REPEATED {
            self.since = 0;
        }
        if new_target {
            self.path.clear();
        }
        if self.path.len() == PATH_POINTS {
            self.path.pop_front();
        }
        self.path.extend(points.last());
        self.since_path += 1;
        if new_target || self.since_path >= PATH_EVERY {
            self.since_path = 0;
            send(3, self.path(ns).as_bytes())?;
        }
        Ok(())
    }

    /// A frame at the begin of each link, along it, and one at the end of the last.
    fn transforms(&mut self, points: &[[f64; 2]], ns: u64) -> &str {
        let text = start(&mut self.text, "{\"transforms\":[");
        let mut angle = 0.0_f64;
        for (i, point) in points.iter().enumerate() {
            if let Some(next) = points.get(i + 1) {
                angle = (next[1] - point[1]).atan2(next[0] - point[0]);
            }
            let comma = if i > 0 { "," } else { "" };
            let child = match points.len() - i {
                1 => "end_effector".to_owned(),
                _ => format!("link_{}", i + 1),
            };
            let (sin, cos) = (0.5 * angle).sin_cos();
            let _ = write!(
                text,
                "{comma}{{\"timestamp\":{},\"parent_frame_id\":\"world\",\"child_frame_id\":\"{child}\",\
                 \"translation\":{},\"rotation\":{{\"x\":0,\"y\":0,\"z\":{sin:.5},\"w\":{cos:.5}}}}}",
                time(ns),
                vector(*point),
            );
        }
        text.push_str("]}");
        text
    }

    /// Each link is a box along its own frame, with a ball at its joint.
    fn links(&mut self, ns: u64) -> &str {
        let text = start(&mut self.text, "{\"deletions\":[],\"entities\":[");
        for (i, length) in self.lengths.iter().enumerate() {
            let thick = THICKNESS * self.reach;
            let cube = format!(
                "{{\"pose\":{},\"size\":{{\"x\":{length:.4},\"y\":{thick:.4},\"z\":{thick:.4}}},\"color\":{}}}",
                pose([0.5 * length, 0.0]),
                colour([0.25, 0.25, 0.28])
            );
            let ball = sphere([0.0, 0.0], JOINT * self.reach, [0.34, 0.71, 0.91]);
            let name = format!("link_{}", i + 1);
            text.push_str(if i > 0 { "," } else { "" });
            entity(text, ns, &name, &name, &[("cubes", &cube), ("spheres", &ball)]);
        }
        text.push_str("]}");
        text
    }

    fn target(&mut self, at: [f64; 2], ns: u64) -> &str {
        let text = start(&mut self.text, "{\"deletions\":[],\"entities\":[");
        let ball = sphere(at, TARGET * self.reach, [0.84, 0.37, 0.0]);
        entity(text, ns, "world", "target", &[("spheres", &ball)]);
        text.push_str("]}");
        text
    }

    /// The way of the end-effector since its target appeared.
    fn path(&mut self, ns: u64) -> &str {
        let points: Vec<String> = self.path.iter().map(|point| vector(*point)).collect();
        let line = format!(
            "{{\"type\":0,\"pose\":{},\"thickness\":2,\"scale_invariant\":true,\"points\":[{}],\"color\":{},\
             \"colors\":[],\"indices\":[]}}",
            pose([0.0, 0.0]),
            points.join(","),
            colour([0.34, 0.71, 0.91])
        );
        let text = start(&mut self.text, "{\"deletions\":[],\"entities\":[");
        entity(text, ns, "world", "path", &[("lines", &line)]);
        text.push_str("]}");
        text
    }
}

fn start<'a>(text: &'a mut String, begin: &str) -> &'a mut String {
    text.clear();
    text.push_str(begin);
    text
}

/// An entity in the frame `frame`, whose lists are empty but for these.
fn entity(text: &mut String, ns: u64, frame: &str, id: &str, filled: &[(&str, &str)]) {
    let _ = write!(
        text,
        "{{\"timestamp\":{},\"frame_id\":\"{frame}\",\"id\":\"{id}\",\"lifetime\":{{\"sec\":0,\"nsec\":0}},\
         \"frame_locked\":true,\"metadata\":[]",
        time(ns)
    );
    for list in super::schemas::PRIMITIVES {
        let of = filled.iter().find(|(name, _)| *name == list).map_or("", |(_, content)| content);
        let _ = write!(text, ",\"{list}\":[{of}]");
    }
    text.push('}');
}

fn sphere(at: [f64; 2], size: f64, rgb: [f64; 3]) -> String {
    let size = format!("{{\"x\":{size:.4},\"y\":{size:.4},\"z\":{size:.4}}}");
    format!("{{\"pose\":{},\"size\":{size},\"color\":{}}}", pose(at), colour(rgb))
}

fn pose(at: [f64; 2]) -> String {
    format!("{{\"position\":{},\"orientation\":{{\"x\":0,\"y\":0,\"z\":0,\"w\":1}}}}", vector(at))
}

/// A point in the plane of the arm, m, to a tenth of a millimetre.
fn vector([x, y]: [f64; 2]) -> String {
    format!("{{\"x\":{x:.4},\"y\":{y:.4},\"z\":0}}")
}

fn colour([r, g, b]: [f64; 3]) -> String {
    format!("{{\"r\":{r},\"g\":{g},\"b\":{b},\"a\":1}}")
}

fn time(ns: u64) -> String {
    format!("{{\"sec\":{},\"nsec\":{}}}", ns / 1_000_000_000, ns % 1_000_000_000)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each message is JSON, and puts the arm's end where the frames say that it is.
    #[test]
    fn the_end_of_the_last_link_is_the_end_effector() {
        let arm = ArmConfig::default();
        let (lengths, mut scene) = (arm.lengths.clone(), ArmScene::new(arm));
        let mut observation = Observation::default();
        observation.inputs[..6].copy_from_slice(&[0.5, -0.25, 0.3, -0.2, 0.4, 0.1]);
        let mut messages = Vec::new();
        let mut keep = |i: usize, data: &[u8]| -> Result<(), ()> {
            messages.push((i, serde_json::from_slice::<serde_json::Value>(data).unwrap()));
            Ok(())
        };
        (0..8).for_each(|_| scene.take(&observation, 1_500_000_000, &mut keep).unwrap());
        let count = |i: usize| messages.iter().filter(|(channel, _)| *channel == i).count();
        assert_eq!([count(0), count(1), count(2), count(3)], [8, 1, 1, 2]);
        let frames = messages[0].1["transforms"].as_array().unwrap();
        assert_eq!(frames.len(), lengths.len() + 1);
        assert_eq!(frames[0]["timestamp"], serde_json::json!({"sec": 1, "nsec": 500_000_000}));
        let number = |frame: &serde_json::Value, part: &str, key: &str| frame[part][key].as_f64().unwrap();
        for (i, pair) in frames.windows(2).enumerate() {
            let angle = 2.0 * number(&pair[0], "rotation", "z").atan2(number(&pair[0], "rotation", "w"));
            for (key, along) in [("x", angle.cos()), ("y", angle.sin())] {
                let end = number(&pair[0], "translation", key) + lengths[i] * along;
                assert!((end - number(&pair[1], "translation", key)).abs() < 1e-3, "{i} {key}: {pair:?}");
            }
        }
        let target = &messages.iter().find(|(channel, _)| *channel == 2).unwrap().1["entities"][0]["spheres"][0];
        assert_eq!(target["pose"]["position"], serde_json::json!({"x": 0.5, "y": -0.25, "z": 0}));
    }
}
