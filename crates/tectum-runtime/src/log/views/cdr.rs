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
        values.iter().for_each(|values| self.floats(values));
        &self.data
    }

    /// A `sensor_msgs/msg/JointState` with positions alone. `joints` are names and indices of inputs.
    pub fn joint_state(&mut self, ns: u64, joints: &[(String, usize)], inputs: &[f32]) -> &[u8] {
        self.begin();
        self.header(ns, "");
        self.length(joints.len());
        joints.iter().for_each(|(name, _)| self.text(name));
        self.length(joints.len());
        joints.iter().for_each(|(_, i)| self.doubles(&[f64::from(inputs[*i])]));
        // No velocities, no efforts.
        self.length(0);
        self.length(0);
        &self.data
    }

    /// Begins the next message; what follows is appended to it.
    pub fn begin(&mut self) {
        self.data.clear();
        self.data.extend(ENCAPSULATION);
    }

    /// The message so far.
    pub fn bytes(&self) -> &[u8] {
        &self.data
    }

    /// A `std_msgs/msg/Header`.
    pub fn header(&mut self, ns: u64, frame: &str) {
        self.align(4);
        self.data.extend(((ns / 1_000_000_000) as i32).to_le_bytes());
        self.data.extend(((ns % 1_000_000_000) as u32).to_le_bytes());
        self.text(frame);
    }

    /// The length of a sequence, whose elements follow.
    pub fn length(&mut self, n: usize) {
        self.align(4);
        self.data.extend((n as u32).to_le_bytes());
    }

    /// A string.
    pub fn text(&mut self, text: &str) {
        self.length(text.len() + 1);
        self.data.extend(text.as_bytes());
        self.data.push(0);
    }

    /// Fields of type `float64`.
    pub fn doubles(&mut self, values: &[f64]) {
        self.align(8);
        values.iter().for_each(|value| self.data.extend(value.to_le_bytes()));
    }

    /// Fields of type `float32`.
    pub fn floats(&mut self, values: &[f32]) {
        self.align(4);
        values.iter().for_each(|value| self.data.extend(value.to_le_bytes()));
    }

    /// Fields of type `int32`.
    pub fn integers(&mut self, values: &[i32]) {
        self.align(4);
        values.iter().for_each(|value| self.data.extend(value.to_le_bytes()));
    }

    /// A field of type `bool`.
    pub fn boolean(&mut self, value: bool) {
        self.data.push(value.into());
    }

    /// CDR aligns a number to its size, counted from behind the encapsulation.
    fn align(&mut self, size: usize) {
        while !(self.data.len() - ENCAPSULATION.len()).is_multiple_of(size) {
            self.data.push(0);
        }
    }
}

/// Reads a message's fields in order, for tests.
#[cfg(test)]
pub(super) struct CdrReader<'a> {
    data: &'a [u8],
    at: usize,
}

#[cfg(test)]
impl<'a> CdrReader<'a> {
    pub fn new(message: &'a [u8]) -> Self {
        Self { data: message.strip_prefix(&ENCAPSULATION).unwrap(), at: 0 }
    }

    pub fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    pub fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.take())
    }

    pub fn text(&mut self) -> String {
        let (length, begin) = (self.u32() as usize, self.at);
        self.at += length;
        String::from_utf8(self.data[begin..self.at - 1].to_vec()).unwrap()
    }

    pub fn at_end(&self) -> bool {
        self.at == self.data.len()
    }

    fn take<const N: usize>(&mut self) -> [u8; N] {
        let begin = self.at.next_multiple_of(N);
        self.at = begin + N;
        self.data[begin..self.at].try_into().unwrap()
    }
}
