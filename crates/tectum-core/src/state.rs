//! What a part must remember to go on as if it had never stopped, told once for all purposes.
//!
//! A part with a memory lists its numbers to a [`StateVisitor`], in a fixed order and by name. Who keeps the ledger decides what
//! that is for: one copies the numbers out, another writes others in. Saving and restoring cannot disagree, because they
//! are the same list. What a part can work out again from its scenario (constants, scratch memory) is not in it.

use bytemuck::Pod;

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

/// What a ledger's rows are made of: numbers, or records of one kind of number.
pub trait Number: Pod {
    /// The numbers' type.
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

/// Where numbers are written down, or read from. Rows come in a fixed order; a name that comes again continues its row.
pub trait StateVisitor {
    /// One row: to be copied from, or written over. `bytes` hold numbers of type `kind` as this machine does.
    fn row(&mut self, name: &'static str, kind: NumberKind, bytes: &mut [u8]);

    /// How many records the row `name`, which follows, has.
    fn count(&mut self, name: &'static str, count: &mut u64);

    /// The names that follow belong to the part `name`.
    fn enter(&mut self, _name: &'static str) {}

    /// The part entered last is over.
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

    /// Plain data, as the 32-bit words that it consists of.
    pub fn words<P: Pod>(&mut self, name: &'static str, data: &mut P) {
        self.row(name, NumberKind::U32, bytemuck::bytes_of_mut(data));
    }

    /// Yes or no.
    pub fn boolean(&mut self, name: &'static str, yes: &mut bool) {
        let mut word = u32::from(*yes);
        self.number(name, &mut word);
        *yes = word != 0;
    }

    /// A number that may be missing.
    pub fn optional(&mut self, name: &'static str, number: &mut Option<u64>) {
        let mut words = number.map_or([0, 0], |n| [1, n]);
        self.number(name, &mut words);
        *number = (words[0] != 0).then_some(words[1]);
    }

    /// A list that grows, of at most `most` records.
    pub fn list<T: Number>(&mut self, name: &'static str, list: &mut Vec<T>, most: usize) {
        let mut count = list.len() as u64;
        self.count(name, &mut count);
        // A ledger that was damaged must not make anybody reserve memory without end.
        list.resize(usize::try_from(count).map_or(most, |count| count.min(most)), T::zeroed());
        self.numbers(name, list);
    }

    /// The part `name`, by its own list.
    pub fn nested(&mut self, name: &'static str, part: &mut dyn Persist) {
        self.enter(name);
        part.visit_state(self);
        self.leave();
    }
}

/// A part with a memory.
pub trait Persist {
    /// Lists everything that the part must remember.
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor);
}

/// Counts the bytes that a part needs.
struct SizeCounter(usize);

impl StateVisitor for SizeCounter {
    fn row(&mut self, _name: &'static str, _kind: NumberKind, bytes: &mut [u8]) {
        self.0 += bytes.len();
    }

    fn count(&mut self, _name: &'static str, _count: &mut u64) {
        self.0 += 8;
    }
}

/// Copies a part's numbers out, one row after the other.
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

/// Copies them in again.
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

/// Bytes that `part` needs now.
pub fn size(part: &mut dyn Persist) -> usize {
    let mut measure = SizeCounter(0);
    part.visit_state(&mut measure);
    measure.0
}

/// Copies the state of `part` into `to` and returns its size; `None` if there is no room. Allocates nothing.
pub fn save(part: &mut dyn Persist, to: &mut [u8]) -> Option<usize> {
    let mut save = StateWriter { to, at: 0 };
    part.visit_state(&mut save);
    (save.at <= save.to.len()).then_some(save.at)
}

/// Gives `part`, which is made from the same scenario, the state that was saved into `from`. False if `from` is not of the
/// right size: `part` is then neither old nor new, and of no use.
#[must_use]
pub fn load(part: &mut dyn Persist, from: &[u8]) -> bool {
    let mut load = StateReader { from, at: 0 };
    part.visit_state(&mut load);
    load.at == from.len()
}
