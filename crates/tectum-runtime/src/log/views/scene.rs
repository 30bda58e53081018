//! The simulator's arm in space: a frame for each link, the links, the target, and the path of the end-effector, as
//! `tf2_msgs/msg/TFMessage` and `visualization_msgs/msg/MarkerArray`.
//!
//! A viewer that begins in the middle, or jumps in a log, gets the last message of each topic. So each message holds
//! all that its topic shows, and what seldom changes is repeated every [`REPEATED`] ticks.

use std::collections::VecDeque;

use tectum_core::plant::posture;

use super::cdr::CdrMessage;
use crate::scenario::ArmConfig;
use crate::wire::{Observation, flag};

/// Ticks after which links and target are sent again.
const REPEATED: u32 = 20;
/// Ticks from one message with the path to the next.
const PATH_EVERY: u32 = 4;
/// Most points of a path, the newest ones.
const PATH_POINTS: usize = 64;
/// Sizes as shares of the arm's reach: thickness of a link, diameters of a joint and of the target, width of the path.
const THICKNESS: f64 = 0.03;
const JOINT: f64 = 0.045;
const TARGET: f64 = 0.06;
const PATH_WIDTH: f64 = 0.01;
/// Steps of a unit, to which positions (m) and the rotations' quaternions are rounded. The steps are powers of two, so
/// that a rounded number has few bits, and a log with them stays small.
const POSITION_STEPS: f64 = 16_384.0;
const ROTATION_STEPS: f64 = 131_072.0;
/// The frame in which positions are.
const WORLD: &str = "world";

/// A marker's shape. The numbers are those of `visualization_msgs/msg/Marker`.
#[derive(Debug, Clone, Copy)]
enum Shape {
    Cube = 1,
    Sphere = 2,
    LineStrip = 4,
}

/// A marker of a fixed size, along its frame.
#[derive(Debug, Clone, Copy)]
struct Marker<'a> {
    /// The frame in which its position is.
    frame: &'a str,
    /// Together with `id` the name under which a later message replaces it.
    namespace: &'a str,
    id: usize,
    shape: Shape,
    /// Position of its centre, m.
    at: [f64; 2],
    /// Lengths along x, y and z, m; of a line strip, its width, 0 and 0.
    size: [f64; 3],
    rgb: [f32; 3],
    /// The points of a line strip, m.
    points: &'a VecDeque<[f64; 2]>,
}

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
    cdr: CdrMessage,
    no_points: VecDeque<[f64; 2]>,
    /// The names of the frames, one a link and the end's.
    frames: Vec<String>,
}

impl ArmScene {
    pub fn new(arm: ArmConfig) -> Self {
        let reach = arm.lengths.iter().sum();
        let links = (1..=arm.lengths.len()).map(|link| format!("link_{link}"));
        Self {
            frames: links.chain(["end_effector".to_owned()]).collect(),
            arm,
            reach,
            since: REPEATED,
            since_path: PATH_EVERY,
            lengths: Vec::new(),
            path: VecDeque::new(),
            cdr: CdrMessage::default(),
            no_points: VecDeque::new(),
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
        send(0, self.transforms(&points, ns))?;
        self.since += 1;
        if self.lengths != now.lengths || self.since >= REPEATED {
            self.lengths.clone_from(&now.lengths);
            send(1, self.links(ns))?;
        }
        let new_target = observation.header.flags & flag::NEW_TARGET != 0;
        if new_target || self.since >= REPEATED {
            let target = self.arm.reported_target(tick, [inputs[0], inputs[1]]).map(f64::from);
            send(2, self.target(target, ns))?;
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
            send(3, self.path(ns))?;
        }
        Ok(())
    }

    /// A frame at the begin of each link, along it, and one at the end of the last.
    fn transforms(&mut self, points: &[[f64; 2]], ns: u64) -> &[u8] {
        self.cdr.begin();
        self.cdr.length(points.len());
        let mut angle = 0.0_f64;
        for (i, (point, frame)) in points.iter().zip(&self.frames).enumerate() {
            if let Some(next) = points.get(i + 1) {
                angle = (next[1] - point[1]).atan2(next[0] - point[0]);
            }
            self.cdr.header(ns, WORLD);
            self.cdr.text(frame);
            self.cdr.doubles(&position(*point));
            let (sin, cos) = (0.5 * angle).sin_cos();
            self.cdr.doubles(&[0.0, 0.0, rounded(sin, ROTATION_STEPS), rounded(cos, ROTATION_STEPS)]);
        }
        self.cdr.bytes()
    }

    /// Each link is a box along its own frame, with a ball at its joint.
    fn links(&mut self, ns: u64) -> &[u8] {
        let (thick, joint) = (THICKNESS * self.reach, JOINT * self.reach);
        self.cdr.begin();
        self.cdr.length(2 * self.lengths.len());
        for (id, (length, frame)) in self.lengths.iter().zip(&self.frames).enumerate() {
            let link = Marker {
                frame,
                namespace: "links",
                id,
                shape: Shape::Cube,
                at: [0.5 * length, 0.0],
                size: [*length, thick, thick],
                rgb: [0.25, 0.25, 0.28],
                points: &self.no_points,
            };
            let (rgb, at) = ([0.34, 0.71, 0.91], [0.0, 0.0]);
            let ball = Marker { namespace: "joints", shape: Shape::Sphere, at, size: [joint; 3], rgb, ..link };
            [link, ball].iter().for_each(|marker| append(&mut self.cdr, marker, ns));
        }
        self.cdr.bytes()
    }

    fn target(&mut self, at: [f64; 2], ns: u64) -> &[u8] {
        let marker = Marker {
            frame: WORLD,
            namespace: "target",
            id: 0,
            shape: Shape::Sphere,
            at,
            size: [TARGET * self.reach; 3],
            rgb: [0.84, 0.37, 0.0],
            points: &self.no_points,
        };
        single(&mut self.cdr, &marker, ns)
    }

    /// The way of the end-effector since its target appeared.
    fn path(&mut self, ns: u64) -> &[u8] {
        let marker = Marker {
            frame: WORLD,
            namespace: "path",
            id: 0,
            shape: Shape::LineStrip,
            at: [0.0, 0.0],
            size: [PATH_WIDTH * self.reach, 0.0, 0.0],
            rgb: [0.34, 0.71, 0.91],
            points: &self.path,
        };
        single(&mut self.cdr, &marker, ns)
    }
}

/// A message with one marker.
fn single<'a>(cdr: &'a mut CdrMessage, marker: &Marker, ns: u64) -> &'a [u8] {
    cdr.begin();
    cdr.length(1);
    append(cdr, marker, ns);
    cdr.bytes()
}

/// Appends a `visualization_msgs/msg/Marker` that stays until another one replaces it.
fn append(cdr: &mut CdrMessage, marker: &Marker, ns: u64) {
    cdr.header(ns, marker.frame);
    cdr.text(marker.namespace);
    // The action is to add or to replace, the orientation that of the frame.
    cdr.integers(&[marker.id as i32, marker.shape as i32, 0]);
    cdr.doubles(&position(marker.at));
    cdr.doubles(&[0.0, 0.0, 0.0, 1.0]);
    cdr.doubles(&marker.size.map(|length| rounded(length, POSITION_STEPS)));
    let [r, g, b] = marker.rgb;
    cdr.floats(&[r, g, b, 1.0]);
    // The lifetime has no end; the marker moves with its frame.
    cdr.integers(&[0, 0]);
    cdr.boolean(true);
    // A line of a single point is an error to RViz.
    let again = marker.points.back().filter(|_| marker.points.len() == 1);
    cdr.length(marker.points.len() + usize::from(again.is_some()));
    marker.points.iter().chain(again).for_each(|point| cdr.doubles(&position(*point)));
    // No colours of points, and no texture: its resource, image (header, format, data) and coordinates.
    cdr.length(0);
    cdr.text("");
    cdr.header(0, "");
    cdr.text("");
    cdr.length(0);
    cdr.length(0);
    // No text and no mesh: its resource, file (name, data) and materials.
    cdr.text("");
    cdr.text("");
    cdr.text("");
    cdr.length(0);
    cdr.boolean(false);
}

/// A point in the plane of the arm, m.
fn position([x, y]: [f64; 2]) -> [f64; 3] {
    [rounded(x, POSITION_STEPS), rounded(y, POSITION_STEPS), 0.0]
}

fn rounded(x: f64, steps: f64) -> f64 {
    (x * steps).round() / steps
}

#[cfg(test)]
mod tests {
    use super::super::cdr::CdrReader;
    use super::*;

    /// A transform: seconds and nanoseconds, the child's frame, x, y, and z and w of the quaternion.
    type Transform = ([u32; 2], String, [f64; 2], [f64; 2]);

    fn transforms(data: &[u8]) -> Vec<Transform> {
        let mut cdr = CdrReader::new(data);
        let transforms = (0..cdr.u32()).map(|_| {
            let stamp = [cdr.u32(), cdr.u32()];
            assert_eq!(cdr.text(), WORLD);
            let child = cdr.text();
            let [x, y, z, i, j, k, w] = [(); 7].map(|()| cdr.f64());
            assert_eq!([z, i, j], [0.0; 3]);
            (stamp, child, [x, y], [k, w])
        });
        let transforms = transforms.collect();
        assert!(cdr.at_end());
        transforms
    }

    /// The messages put the arm's end where the frames say that it is.
    #[test]
    fn the_end_of_the_last_link_is_the_end_effector() {
        let arm = ArmConfig::default();
        let (lengths, mut scene) = (arm.lengths.clone(), ArmScene::new(arm));
        let mut observation = Observation::default();
        observation.inputs[..6].copy_from_slice(&[0.5, -0.25, 0.3, -0.2, 0.4, 0.1]);
        let mut messages = Vec::new();
        let mut keep = |i: usize, data: &[u8]| -> Result<(), ()> {
            messages.push((i, data.to_vec()));
            Ok(())
        };
        (0..8).for_each(|_| scene.take(&observation, 1_500_000_000, &mut keep).unwrap());
        let count = |i: usize| messages.iter().filter(|(channel, _)| *channel == i).count();
        assert_eq!([count(0), count(1), count(2), count(3)], [8, 1, 1, 2]);
        let frames = transforms(&messages[0].1);
        assert_eq!(frames.len(), lengths.len() + 1);
        assert_eq!((frames[0].0, frames[4].1.as_str()), ([1, 500_000_000], "end_effector"));
        for (i, pair) in frames.windows(2).enumerate() {
            let angle = 2.0 * pair[0].3[0].atan2(pair[0].3[1]);
            let end = [pair[0].2[0] + lengths[i] * angle.cos(), pair[0].2[1] + lengths[i] * angle.sin()];
            assert!((0..2).all(|axis| (end[axis] - pair[1].2[axis]).abs() < 1e-3), "{i}: {pair:?}");
        }
        let target = &messages.iter().find(|(channel, _)| *channel == 2).unwrap().1;
        let mut cdr = CdrReader::new(target);
        assert_eq!([(); 3].map(|()| cdr.u32()), [1, 1, 500_000_000]);
        assert_eq!([cdr.text(), cdr.text()], ["world", "target"]);
        assert_eq!([(); 3].map(|()| cdr.u32()), [0, 2, 0]);
        assert_eq!([(); 3].map(|()| cdr.f64()), [0.5, -0.25, 0.0]);
    }
}
