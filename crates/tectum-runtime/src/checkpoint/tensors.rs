//! Two state visitors: one collects rows into named tensors, the other restores rows from them.

use std::collections::BTreeMap;

use crate::state::{NumberKind, StateVisitor};

/// The name of every random stream in a part's list.
const STREAM: &str = "rng";

/// Numbers of one type, in rows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Tensor {
    pub kind: NumberKind,
    pub shape: Vec<usize>,
    pub bytes: Vec<u8>,
}

/// The names of the nested parts that are being visited.
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

/// Collects a part's rows. A repeated name adds a row to its tensor. Rows of equal length make it a matrix,
/// rows of different lengths a vector.
#[derive(Debug, Default)]
pub(super) struct TensorCollector {
    path: TensorPath,
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
        self.add(self.path.name(name), kind, bytes);
    }

    fn count(&mut self, name: &'static str, count: &mut u64) {
        self.add(self.path.name(name) + ".count", NumberKind::U64, &count.to_ne_bytes());
    }

    fn enter(&mut self, name: &'static str) {
        self.path.0.push(name);
    }

    fn leave(&mut self) {
        self.path.0.pop();
    }
}

/// Restores a part's rows, and checks that every row was found and all data was used.
#[derive(Debug)]
pub(super) struct TensorRestorer<'a> {
    path: TensorPath,
    /// The tensors, each with its bytes that have not been used yet.
    unused: BTreeMap<&'a str, (NumberKind, &'a [u8])>,
    /// Whether random streams are left as they are.
    keeps_streams: bool,
    /// The first error.
    error: Option<String>,
}

impl<'a> TensorRestorer<'a> {
    /// Restores from `tensors`. Those called `ignored` are not part of the state.
    pub fn new(tensors: &'a BTreeMap<String, Tensor>, ignored: &[&str]) -> Self {
        let state = tensors.iter().filter(|(name, _)| !ignored.contains(&name.as_str()));
        let unused = state.map(|(name, t)| (name.as_str(), (t.kind, t.bytes.as_slice()))).collect();
        Self { path: TensorPath::default(), unused, keeps_streams: false, error: None }
    }

    /// The same restorer, which leaves random streams ([`crate::seed::Rng`], called `rng` everywhere) as they are.
    pub fn keeping_streams(self) -> Self {
        Self { keeps_streams: true, ..self }
    }

    /// Like [`finish`](Self::finish), where only a part of what was written is restored: rows below `part` must all
    /// have been used, and any other row that was used must have been used up.
    pub fn finish_part(mut self, part: &str) -> Result<(), String> {
        self.unused.retain(|name, _| name.starts_with(part));
        self.finish()
    }

    fn take(&mut self, name: &str, kind: NumberKind, bytes: &mut [u8]) {
        let error = match self.unused.get_mut(name) {
            None => format!("{name} is not in it"),
            Some((stored, _)) if *stored != kind => format!("{name} is of another type"),
            Some((_, unused)) => match unused.split_at_checked(bytes.len()) {
                None => format!("{name} is too short"),
                Some((row, rest)) => {
                    if !(self.keeps_streams && self.path.0.last() == Some(&STREAM)) {
                        bytes.copy_from_slice(row);
                    }
                    *unused = rest;
                    return;
                }
            },
        };
        self.error.get_or_insert(error);
    }

    /// The first error, or the first tensor with unused data.
    pub fn finish(self) -> Result<(), String> {
        let superfluous = self.unused.iter().find(|(_, (_, unused))| !unused.is_empty());
        let superfluous =
            superfluous.map(|(name, _)| format!("{name} is too long, or belongs to no part of the state"));
        self.error.or(superfluous).map_or(Ok(()), Err)
    }
}

impl StateVisitor for TensorRestorer<'_> {
    fn row(&mut self, name: &'static str, kind: NumberKind, bytes: &mut [u8]) {
        let name = self.path.name(name);
        self.take(&name, kind, bytes);
    }

    fn count(&mut self, name: &'static str, count: &mut u64) {
        let name = self.path.name(name) + ".count";
        self.take(&name, NumberKind::U64, bytemuck::bytes_of_mut(count));
    }

    fn enter(&mut self, name: &'static str) {
        self.path.0.push(name);
    }

    fn leave(&mut self) {
        self.path.0.pop();
    }
}
