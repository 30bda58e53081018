//! Views: what a packed log holds beside its samples, for programs that draw curves by name.
//!
//! A sample is an array of numbers, and replay needs it as it was. A person looks for `theta_1` and its unit. So a
//! packed log repeats the numbers on topics whose messages have the scenario's names as fields:
//!
//! | topic | type | content, at the time of the sample |
//! |---|---|---|
//! | `/inputs` | `tectum/msg/Inputs` | the inputs of an observation |
//! | `/applied` | `tectum/msg/Applied` | the applied command of the tick before |
//! | `/measures` | `tectum/msg/Measures` | reward and measures of the tick before |
//! | `/outputs` | `tectum/msg/Outputs` | mean and drawn command |
//! | `/joint_states` | `sensor_msgs/msg/JointState` | the inputs in rad, as ROS programs expect them |
//!
//! Readers of samples pass over them.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::McapResult;
use mcap::records::MessageHeader;

use super::{ENCAPSULATION, LogReader, LogRecord};
use crate::scenario::SignalConfig;
use crate::wire::Header;

const JOINT_STATE: &str = "\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";

/// The views of a log, and the channels of the file to which they are written.
pub(super) struct LogViews {
    inputs: usize,
    outputs: usize,
    measures: usize,
    /// Names and indices of the inputs in rad.
    joints: Vec<(String, usize)>,
    /// Channels of inputs, applied commands, measures, outputs and joint states.
    channels: [u16; 5],
    /// Offset from the run's clock to wall time, ns.
    shift_ns: i128,
    data: Vec<u8>,
}

/// A field of a message: its name, as ROS allows it, and a comment.
type Field = (String, String);

impl LogViews {
    /// Declares the views of `log` in `mcap`.
    pub fn declare<W: Write + Seek>(log: &LogReader, mcap: &mut mcap::Writer<W>) -> McapResult<Self> {
        let signals = |key: &str| log.run(key).and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default();
        let (inputs, outputs): (Vec<SignalConfig>, Vec<SignalConfig>) = (signals("inputs"), signals("outputs"));
        let measures: Vec<String> =
            log.run("measures").and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default();
        let named = |signals: &[SignalConfig], after: &str| -> Vec<Field> {
            signals.iter().map(|s| (format!("{}{after}", s.name), s.unit.clone())).collect()
        };
        let reward = std::iter::once(("reward".to_owned(), String::new()));
        let of_measures = reward.chain(measures.iter().map(|name| (name.clone(), String::new()))).collect();
        let of_outputs = [named(&outputs, "_mean"), named(&outputs, "_drawn")].concat();
        let mut declare = |topic: &str, name: &str, fields: Vec<Field>| {
            let schema = mcap.add_schema(name, "ros2msg", definition(fields).as_bytes())?;
            mcap.add_channel(schema, topic, "cdr", &BTreeMap::new())
        };
        let channels = [
            declare("/inputs", "tectum/msg/Inputs", named(&inputs, ""))?,
            declare("/applied", "tectum/msg/Applied", named(&outputs, ""))?,
            declare("/measures", "tectum/msg/Measures", of_measures)?,
            declare("/outputs", "tectum/msg/Outputs", of_outputs)?,
        ];
        let schema = mcap.add_schema("sensor_msgs/msg/JointState", "ros2msg", JOINT_STATE.as_bytes())?;
        let joint_states = mcap.add_channel(schema, "/joint_states", "cdr", &BTreeMap::new())?;
        let [a, b, c, d] = channels;
        let instant = |key: &str| log.run(key).and_then(|ns| ns.parse::<i128>().ok()).unwrap_or(0);
        let joints = inputs.iter().enumerate().filter(|(_, input)| input.unit == "rad");
        Ok(Self {
            inputs: inputs.len(),
            outputs: outputs.len(),
            measures: measures.len(),
            joints: joints.map(|(i, input)| (input.name.clone(), i)).collect(),
            channels: [a, b, c, d, joint_states],
            shift_ns: instant("wall_at_t0_ns") - instant("t0_ns"),
            data: Vec::new(),
        })
    }

    /// Writes the views of a sample.
    pub fn write<W: Write + Seek>(&mut self, record: &LogRecord, mcap: &mut mcap::Writer<W>) -> McapResult<()> {
        match record {
            LogRecord::Observation(s) => {
                self.numbers(mcap, 0, &s.header, &[&s.inputs[..self.inputs]])?;
                self.numbers(mcap, 1, &s.header, &[&s.applied[..self.outputs]])?;
                self.numbers(mcap, 2, &s.header, &[&[s.reward], &s.measures[..self.measures]])?;
                if self.joints.is_empty() { Ok(()) } else { self.joint_state(mcap, &s.header, &s.inputs) }
            }
            LogRecord::Command(s) => {
                self.numbers(mcap, 3, &s.header, &[&s.mean[..self.outputs], &s.drawn[..self.outputs]])
            }
            LogRecord::Learning(_) | LogRecord::Gap(_) => Ok(()),
        }
    }

    fn wall_ns(&self, header: &Header) -> u64 {
        (i128::from(header.published_ns) + self.shift_ns).clamp(0, i128::from(u64::MAX)) as u64
    }

    fn numbers<W: Write + Seek>(
        &mut self,
        mcap: &mut mcap::Writer<W>,
        view: usize,
        header: &Header,
        values: &[&[f32]],
    ) -> McapResult<()> {
        self.begin();
        for value in values.iter().flat_map(|values| values.iter()) {
            self.data.extend(value.to_le_bytes());
        }
        self.end(mcap, view, header)
    }

    fn joint_state<W: Write + Seek>(
        &mut self,
        mcap: &mut mcap::Writer<W>,
        header: &Header,
        inputs: &[f32],
    ) -> McapResult<()> {
        let ns = self.wall_ns(header);
        self.begin();
        self.data.extend(((ns / 1_000_000_000) as i32).to_le_bytes());
        self.data.extend(((ns % 1_000_000_000) as u32).to_le_bytes());
        let joints = std::mem::take(&mut self.joints);
        self.text("");
        self.length(joints.len());
        joints.iter().for_each(|(name, _)| self.text(name));
        self.length(joints.len());
        self.align(8);
        joints.iter().for_each(|(_, i)| self.data.extend(f64::from(inputs[*i]).to_le_bytes()));
        self.joints = joints;
        // No velocities, no efforts.
        self.length(0);
        self.length(0);
        self.end(mcap, 4, header)
    }

    fn begin(&mut self) {
        self.data.clear();
        self.data.extend(ENCAPSULATION);
    }

    fn end<W: Write + Seek>(&self, mcap: &mut mcap::Writer<W>, view: usize, header: &Header) -> McapResult<()> {
        let ns = self.wall_ns(header);
        let channel_id = self.channels[view];
        let header = MessageHeader { channel_id, sequence: header.sequence as u32, log_time: ns, publish_time: ns };
        mcap.write_to_known_channel(&header, &self.data)
    }

    /// CDR aligns a number to its size, counted from behind the encapsulation.
    fn align(&mut self, size: usize) {
        while !(self.data.len() - ENCAPSULATION.len()).is_multiple_of(size) {
            self.data.push(0);
        }
    }

    fn length(&mut self, n: usize) {
        self.align(4);
        self.data.extend((n as u32).to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.length(text.len() + 1);
        self.data.extend(text.as_bytes());
        self.data.push(0);
    }
}

/// A message of 32-bit floating-point numbers, in ROS 2's language. A field's name has lower-case letters, digits and
/// single underscores; the scenario's own name and the unit follow as a comment.
fn definition(fields: Vec<Field>) -> String {
    let mut names: Vec<String> = Vec::new();
    let mut text = String::new();
    for (name, unit) in fields {
        let words = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
        let mut field = words.collect::<Vec<_>>().join("_").to_ascii_lowercase();
        if !field.starts_with(|c: char| c.is_ascii_lowercase()) {
            field.insert_str(0, "value_");
        }
        while names.contains(&field) {
            field.push('x');
        }
        let comment = if field == name { unit } else { format!("{name} {unit}") };
        text += &format!("float32 {field} # {}\n", comment.replace('\n', " "));
        names.push(field);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_names_that_ros_allows() {
        let field = |name: &str, unit: &str| (name.to_owned(), unit.to_owned());
        let fields =
            vec![field("theta_1", "rad"), field("Speed (left)", "m/s"), field("2nd", ""), field("theta__1", "")];
        assert_eq!(
            definition(fields),
            "float32 theta_1 # rad\nfloat32 speed_left # Speed (left) m/s\nfloat32 value_2nd # 2nd \n\
             float32 theta_1x # theta__1 \n"
        );
    }
}
