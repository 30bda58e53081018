//! Two ledgers by name: one collects rows into tensors, one gives them back.

use std::collections::BTreeMap;

use crate::state::{NumberKind, StateVisitor};

/// Numbers of one type, in rows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Tensor {
    pub kind: NumberKind,
    pub shape: Vec<usize>,
    pub bytes: Vec<u8>,
}

/// Where we are among parts within parts.
#[derive(Debug, Default)]
struct TensorPath(Vec<&'static str>);

impl TensorPath {
    fn name(&self, row: &str) -> String {
        let mut name = self.0.join(".");
        if !name.is_empty() {
            name.push('.');
        }
        name + row
    }
}

/// Collects a part's rows. A name that comes again adds a row to its tensor; rows of different length make it a line.
#[derive(Debug, Default)]
pub(super) struct TensorCollector {
    place: TensorPath,
    pub tensors: BTreeMap<String, Tensor>,
}

impl TensorCollector {
    fn add(&mut self, name: String, kind: NumberKind, bytes: &[u8]) {
        let len = bytes.len() / kind.size();
        let tensor = self.tensors.entry(name).or_insert(Tensor { kind, shape: Vec::new(), bytes: Vec::new() });
        tensor.shape = match tensor.shape[..] {
            [] => vec![len],
            [first] if first == len => vec![2, len],
            [rows, first] if first == len => vec![rows + 1, len],
            _ => vec![tensor.bytes.len() / kind.size() + len],
        };
        tensor.bytes.extend_from_slice(bytes);
    }
}

impl StateVisitor for TensorCollector {
    fn row(&mut self, name: &'static str, kind: NumberKind, bytes: &mut [u8]) {
        self.add(self.place.name(name), kind, bytes);
    }

    fn count(&mut self, name: &'static str, count: &mut u64) {
        self.add(self.place.name(name) + ".count", NumberKind::U64, &count.to_ne_bytes());
    }

    fn enter(&mut self, name: &'static str) {
        self.place.0.push(name);
    }

    fn leave(&mut self) {
        self.place.0.pop();
    }
}

/// Gives a part its rows back, and knows at the end whether all was there and all was taken.
#[derive(Debug)]
pub(super) struct TensorRestorer<'a> {
    place: TensorPath,
    /// The tensors, and what is left of each.
    left: BTreeMap<&'a str, (NumberKind, &'a [u8])>,
    wrong: Option<String>,
}

impl<'a> TensorRestorer<'a> {
    /// Over `tensors`, of which those called `besides` are nobody's state.
    pub fn new(tensors: &'a BTreeMap<String, Tensor>, besides: &[&str]) -> Self {
        let own = tensors.iter().filter(|(name, _)| !besides.contains(&name.as_str()));
        let left = own.map(|(name, t)| (name.as_str(), (t.kind, t.bytes.as_slice()))).collect();
        Self { place: TensorPath::default(), left, wrong: None }
    }

    fn take(&mut self, name: &str, kind: NumberKind, bytes: &mut [u8]) {
        let wrong = match self.left.get_mut(name) {
            None => format!("{name} is not in it"),
            Some((there, _)) if *there != kind => format!("{name} is of another type"),
            Some((_, left)) => match left.split_at_checked(bytes.len()) {
                None => format!("{name} is too short"),
                Some((row, rest)) => {
                    bytes.copy_from_slice(row);
                    *left = rest;
                    return;
                }
            },
        };
        self.wrong.get_or_insert(wrong);
    }

    /// What was wrong, if anything was.
    pub fn finish(self) -> Result<(), String> {
        let over = self.left.iter().find(|(_, (_, left))| !left.is_empty());
        let over = over.map(|(name, _)| format!("{name} is too long, or nobody's"));
        self.wrong.or(over).map_or(Ok(()), Err)
    }
}

impl StateVisitor for TensorRestorer<'_> {
    fn row(&mut self, name: &'static str, kind: NumberKind, bytes: &mut [u8]) {
        let name = self.place.name(name);
        self.take(&name, kind, bytes);
    }

    fn count(&mut self, name: &'static str, count: &mut u64) {
        let name = self.place.name(name) + ".count";
        self.take(&name, NumberKind::U64, bytemuck::bytes_of_mut(count));
    }

    fn enter(&mut self, name: &'static str) {
        self.place.0.push(name);
    }

    fn leave(&mut self) {
        self.place.0.pop();
    }
}
