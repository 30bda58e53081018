//! The state of a component: everything that it needs to continue as if it had never stopped.
//!
//! A component lists its numbers to a [`StateVisitor`], in a fixed order and by name. The visitor decides what
//! happens to them: one visitor copies the numbers out, another overwrites them. Saving and restoring cannot
//! disagree, because both use the same list. Values that can be computed from the scenario (constants, scratch
//! memory) are not listed.
//!
//! ```
//! use tectum_core::policy::Exploration;
//! use tectum_core::state::{load, save, size};
//!
//! let mut original = Exploration::new(1, 0.1, 4);
//! original.draw();
//! let mut bytes = vec![0; size(&mut original)];
//! save(&mut original, &mut bytes);
//!
//! let mut restored = Exploration::new(1, 0.1, 4);
//! assert!(load(&mut restored, &bytes));
//! assert_eq!(restored.draw(), original.draw());
//! ```

use bytemuck::Pod;
use xxhash_rust::xxh3::Xxh3;

/// The type of a row's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NumberKind {
    /// `u32`
    U32,
    /// `u64`
    U64,
    /// `f32`
    F32,
    /// `f64`
    F64,
}

impl NumberKind {
    /// Bytes of one number.
    pub const fn size(self) -> usize {
        match self {
            Self::U32 | Self::F32 => 4,
            Self::U64 | Self::F64 => 8,
        }
    }
}

/// An element of a row: a number, or a record of numbers of one kind.
pub trait Number: Pod {
    /// The type of the numbers.
    const KIND: NumberKind;
}

macro_rules! number {
    ($($ty:ty: $kind:ident),+) => { $(impl Number for $ty { const KIND: NumberKind = NumberKind::$kind; })+ };
}

number!(u32: U32, u64: U64, f32: F32, f64: F64, glam::Vec4: F32);

impl<T: Number, const N: usize> Number for [T; N]
where
    [T; N]: Pod,
{
    const KIND: NumberKind = T::KIND;
}

/// Receives the state of a component, row by row, and may overwrite it. Rows come in a fixed order; a repeated name
/// continues the row of that name.
pub trait StateVisitor {
    /// One row, which may be read or overwritten. `bytes` hold numbers of type `kind` in the machine's byte order.
    fn row(&mut self, name: &'static str, kind: NumberKind, bytes: &mut [u8]);

    /// The number of records in the row `name`, which comes next.
    fn count(&mut self, name: &'static str, count: &mut u64);

    /// The names that follow belong to the component `name`.
    fn enter(&mut self, _name: &'static str) {}

    /// Ends the component that was entered last.
    fn leave(&mut self) {}
}

impl dyn StateVisitor + '_ {
    /// A row of numbers.
    pub fn numbers<T: Number>(&mut self, name: &'static str, numbers: &mut [T]) {
        self.row(name, T::KIND, bytemuck::cast_slice_mut(numbers));
    }

    /// One number.
    pub fn number<T: Number>(&mut self, name: &'static str, number: &mut T) {
        self.numbers(name, std::slice::from_mut(number));
    }

    /// Plain data, as 32-bit words.
    pub fn words<P: Pod>(&mut self, name: &'static str, data: &mut P) {
        self.row(name, NumberKind::U32, bytemuck::bytes_of_mut(data));
    }

    /// A boolean, as a `u32`.
    pub fn boolean(&mut self, name: &'static str, value: &mut bool) {
        let mut word = u32::from(*value);
        self.number(name, &mut word);
        *value = word != 0;
    }

    /// An optional number, as two `u64`: 1 and the number, or 0 and 0.
    pub fn optional(&mut self, name: &'static str, number: &mut Option<u64>) {
        let mut words = number.map_or([0, 0], |n| [1, n]);
        self.number(name, &mut words);
        *number = (words[0] != 0).then_some(words[1]);
    }

    /// A list of variable length, of at most `max_len` records.
    pub fn list<T: Number>(&mut self, name: &'static str, list: &mut Vec<T>, max_len: usize) {
        let mut count = list.len() as u64;
        self.count(name, &mut count);
        // The limit keeps damaged data from causing a huge allocation.
        list.resize(usize::try_from(count).map_or(max_len, |count| count.min(max_len)), T::zeroed());
        self.numbers(name, list);
    }

    /// The component `name`, with its own list.
    pub fn nested(&mut self, name: &'static str, component: &mut dyn Persist) {
        self.enter(name);
        component.visit_state(self);
        self.leave();
    }
}

/// A component with state.
pub trait Persist {
    /// Passes all state of the component to `visitor`, in a fixed order.
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor);
}

/// Counts the bytes of a component's state.
struct SizeCounter(usize);

impl StateVisitor for SizeCounter {
    fn row(&mut self, _name: &'static str, _kind: NumberKind, bytes: &mut [u8]) {
        self.0 += bytes.len();
    }

    fn count(&mut self, _name: &'static str, _count: &mut u64) {
        self.0 += 8;
    }
}

/// Copies the state of a component out, one row after the other.
struct StateWriter<'a> {
    to: &'a mut [u8],
    at: usize,
}

impl StateVisitor for StateWriter<'_> {
    fn row(&mut self, _name: &'static str, _kind: NumberKind, bytes: &mut [u8]) {
        if let Some(to) = self.to.get_mut(self.at..self.at + bytes.len()) {
            to.copy_from_slice(bytes);
        }
        self.at += bytes.len();
    }

    fn count(&mut self, name: &'static str, count: &mut u64) {
        self.row(name, NumberKind::U64, bytemuck::bytes_of_mut(count));
    }
}

/// Copies saved state into a component, one row after the other.
struct StateReader<'a> {
    from: &'a [u8],
    at: usize,
}

impl StateVisitor for StateReader<'_> {
    fn row(&mut self, _name: &'static str, _kind: NumberKind, bytes: &mut [u8]) {
        if let Some(from) = self.from.get(self.at..self.at + bytes.len()) {
            bytes.copy_from_slice(from);
        }
        self.at += bytes.len();
    }

    fn count(&mut self, name: &'static str, count: &mut u64) {
        self.row(name, NumberKind::U64, bytemuck::bytes_of_mut(count));
    }
}

/// The current size of the state of `component`, in bytes.
pub fn size(component: &mut dyn Persist) -> usize {
    let mut counter = SizeCounter(0);
    component.visit_state(&mut counter);
    counter.0
}

/// Copies the state of `component` into `to` and returns its size, or `None` if `to` is too small. Does not
/// allocate.
pub fn save(component: &mut dyn Persist, to: &mut [u8]) -> Option<usize> {
    let mut writer = StateWriter { to, at: 0 };
    component.visit_state(&mut writer);
    (writer.at <= writer.to.len()).then_some(writer.at)
}

/// Feeds the state of a component into a hash, one row after the other.
struct StateHasher(Xxh3);

impl StateVisitor for StateHasher {
    fn row(&mut self, _name: &'static str, _kind: NumberKind, bytes: &mut [u8]) {
        self.0.update(bytes);
    }

    fn count(&mut self, _name: &'static str, count: &mut u64) {
        self.0.update(&count.to_ne_bytes());
    }
}

/// XXH3-64 of the state of `component`. Does not allocate.
pub fn hash(component: &mut dyn Persist) -> u64 {
    let mut hasher = StateHasher(Xxh3::new());
    component.visit_state(&mut hasher);
    hasher.0.digest()
}

/// Restores into `component`, built from the same scenario, the state that was saved in `from`. Returns false
/// if `from` has the wrong size; `component` is then partly overwritten and must not be used.
#[must_use]
pub fn load(component: &mut dyn Persist, from: &[u8]) -> bool {
    let mut reader = StateReader { from, at: 0 };
    component.visit_state(&mut reader);
    reader.at == from.len()
}
