//! Messages in CDR, as ROS 2 encodes them.

use super::super::ENCAPSULATION;

/// The bytes of a message; the memory is used again for the next one.
#[derive(Debug, Default)]
pub(super) struct CdrMessage {
    data: Vec<u8>,
}

impl CdrMessage {
    /// A message of 32-bit floating-point numbers.
    pub fn numbers(&mut self, values: &[&[f32]]) -> &[u8] {
        self.begin();
        for value in values.iter().flat_map(|values| values.iter()) {
            self.data.extend(value.to_le_bytes());
        }
        &self.data
    }

    /// A `sensor_msgs/msg/JointState` with positions alone. `joints` are names and indices of inputs.
    pub fn joint_state(&mut self, ns: u64, joints: &[(String, usize)], inputs: &[f32]) -> &[u8] {
        self.begin();
        self.data.extend(((ns / 1_000_000_000) as i32).to_le_bytes());
        self.data.extend(((ns % 1_000_000_000) as u32).to_le_bytes());
        self.text("");
        self.length(joints.len());
        joints.iter().for_each(|(name, _)| self.text(name));
        self.length(joints.len());
        self.align(8);
        joints.iter().for_each(|(_, i)| self.data.extend(f64::from(inputs[*i]).to_le_bytes()));
        // No velocities, no efforts.
        self.length(0);
        self.length(0);
        &self.data
    }

    fn begin(&mut self) {
        self.data.clear();
        self.data.extend(ENCAPSULATION);
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
