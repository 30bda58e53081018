//! Matrices of outputs by features, in the memory layout of policy and learning rules: the weights, and traces
//! of the same shape.
//!
//! A [`Tile`] holds four outputs of eight neighbouring features, output by output. A pass therefore reads eight
//! features once for four outputs, as whole vectors that need no broadcast, and reads and writes memory
//! sequentially. Up to four outputs take one group of tiles, up to eight take two; unused elements stay zero.

use bytemuck::{Pod, Zeroable};

use crate::state::{Persist, StateVisitor};
use tectum_encoder::simd::{F32x8, F32x16, Kernel, LANES, SimdPath, WIDE_LANES, filled};

/// Number of outputs in a group.
pub(super) const ROWS: usize = 4;

/// Number of pairs of outputs in a group. A register of sixteen lanes, where there is one, holds the rows of a pair.
const PAIRS: usize = ROWS / 2;

/// Eight features of four outputs.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C, align(64))]
pub(super) struct Tile(pub [[f32; LANES]; ROWS]);

impl Tile {
    /// The rows of two outputs at a time.
    #[inline(always)]
    fn pairs(&self) -> &[[f32; WIDE_LANES]; PAIRS] {
        bytemuck::cast_ref(&self.0)
    }

    /// [`pairs`](Self::pairs), mutable.
    #[inline(always)]
    fn pairs_mut(&mut self) -> &mut [[f32; WIDE_LANES]; PAIRS] {
        bytemuck::cast_mut(&mut self.0)
    }
}

/// A matrix of outputs by (padded) features.
#[derive(Debug, Clone, PartialEq)]
pub struct Tiles {
    pub(super) groups: Vec<Vec<Tile>>,
}

impl Tiles {
    /// All zero, for `len` features, including padding, and `outputs` outputs.
    pub fn zeroed(len: usize, outputs: usize) -> Self {
        Self { groups: vec![vec![Tile::zeroed(); len.div_ceil(LANES)]; outputs.div_ceil(ROWS)] }
    }

    /// The element of `output` and of the feature at `position`.
    #[inline]
    pub fn get(&self, output: usize, position: usize) -> f32 {
        self.groups[output / ROWS][position / LANES].0[output % ROWS][position % LANES]
    }

    /// The element of `output` and of the feature at `position`, mutable.
    #[inline]
    pub fn get_mut(&mut self, output: usize, position: usize) -> &mut f32 {
        &mut self.groups[output / ROWS][position / LANES].0[output % ROWS][position % LANES]
    }

    /// All elements in memory order, group by group.
    pub fn as_slices(&self) -> impl Iterator<Item = &[f32]> {
        self.groups.iter().map(|group| bytemuck::cast_slice(group))
    }

    /// Sets all elements to zero.
    pub fn clear(&mut self) {
        for group in &mut self.groups {
            group.fill(Tile::zeroed());
        }
    }

    /// Euclidean norm.
    pub fn norm(&self) -> f32 {
        self.norm_on(SimdPath::best())
    }

    /// Euclidean norm, computed on `path`: the same bits on every path.
    pub(super) fn norm_on(&self, path: SimdPath) -> f32 {
        path.run(NormKernel(&self.groups))
    }
}

impl Persist for Tiles {
    /// In memory order: tile after tile, and within a tile output after output.
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        for group in &mut self.groups {
            visitor.numbers::<f32>("tiles", bytemuck::cast_slice_mut(group));
        }
    }
}

/// The Euclidean norm of all tiles. Squares are summed by output and lane, then over outputs, then over lanes.
struct NormKernel<'a>(&'a [Vec<Tile>]);

impl Kernel for NormKernel<'_> {
    type Output = f32;
    const IS_WIDE: bool = true;

    #[inline(always)]
    fn run<L: F32x8>(self) -> f32 {
        let mut sums = [L::Wide::splat(0.0); PAIRS];
        for tile in self.0.iter().flatten() {
            for (sum, pair) in sums.iter_mut().zip(tile.pairs()) {
                let x = L::Wide::load(pair);
                *sum = *sum + x * x;
            }
        }
        let ([a, b], [c, d]) = (sums[0].halves(), sums[1].halves());
        ((a + b) + (c + d)).store().iter().sum::<f32>().sqrt()
    }
}

/// One update of a learning rule with a trace: `z = decay z + gain g^T`, and then `W += rate z`.
#[derive(Debug, Clone, Copy)]
pub struct TraceStep<'a> {
    /// The features `g`, in the encoder's padded layout.
    pub features: &'a [f32],
    /// Factor of the features for each output.
    pub gain: &'a [f32],
    /// Factor of the old trace.
    pub decay: f32,
    /// Factor with which the trace is added to the weights.
    pub rate: f32,
}

/// An update of one group and, in the same pass, the mean output for `next`. Most of the time of a tick is
/// spent on loading and storing weights and trace, so they are loaded once.
pub(super) struct StepKernel<'a, const WITH_MEAN: bool> {
    pub weights: &'a mut [Tile],
    pub trace: &'a mut [Tile],
    pub step: TraceStep<'a>,
    pub next: &'a [f32],
    pub mean: &'a mut [f32; ROWS],
}

impl<const WITH_MEAN: bool> Kernel for StepKernel<'_, WITH_MEAN> {
    type Output = ();
    const IS_WIDE: bool = true;

    #[inline(always)]
    fn run<L: F32x8>(self) {
        let mut gain = [0.0; ROWS];
        gain[..self.step.gain.len()].copy_from_slice(self.step.gain);
        let [a, b, c, d] = gain;
        let constants = StepConstants::<L> {
            gains: [L::Wide::joined([L::splat(a), L::splat(b)]), L::Wide::joined([L::splat(c), L::splat(d)])],
            decay: L::Wide::splat(self.step.decay),
            rate: L::Wide::splat(self.step.rate),
        };
        let features = self.step.features;
        let next = if WITH_MEAN { self.next } else { features };
        let mut sums = [L::Wide::splat(0.0); PAIRS];
        let ((whole, rest), (whole_next, rest_next)) = (features.as_chunks(), next.as_chunks());
        let tiles = self.weights.iter_mut().zip(self.trace.iter_mut());
        for ((tile, g), next) in tiles.zip(whole).zip(whole_next) {
            constants.advance::<WITH_MEAN>(tile, g, next, &mut sums);
        }
        let last = whole.len();
        if let (Some(w), Some(z)) = (self.weights.get_mut(last), self.trace.get_mut(last)) {
            constants.advance::<WITH_MEAN>((w, z), &filled(rest), &filled(rest_next), &mut sums);
        }
        *self.mean = totals::<L>(sums);
    }
}

/// The constants of an update, broadcast to all lanes.
struct StepConstants<L: F32x8> {
    gains: [L::Wide; PAIRS],
    decay: L::Wide,
    rate: L::Wide,
}

impl<L: F32x8> StepConstants<L> {
    /// Updates one tile.
    #[inline(always)]
    fn advance<const WITH_MEAN: bool>(
        &self,
        (w, z): (&mut Tile, &mut Tile),
        g: &[f32; LANES],
        next: &[f32; LANES],
        sums: &mut [L::Wide; PAIRS],
    ) {
        let (g, next) = (L::load(g), L::load(next));
        let (g, next) = (L::Wide::joined([g, g]), L::Wide::joined([next, next]));
        let (z, w) = (z.pairs_mut(), w.pairs_mut());
        for i in 0..PAIRS {
            let trace = L::Wide::load(&z[i]) * self.decay + self.gains[i] * g;
            z[i] = trace.store();
            let weight = L::Wide::load(&w[i]) + trace * self.rate;
            w[i] = weight.store();
            if WITH_MEAN {
                sums[i] = sums[i] + weight * next;
            }
        }
    }
}

/// The sums over the lanes of each output's half of a pair.
#[inline(always)]
fn totals<L: F32x8>([ab, cd]: [L::Wide; PAIRS]) -> [f32; ROWS] {
    let ([a, b], [c, d]) = (ab.halves(), cd.halves());
    L::totals([a, b, c, d])
}

/// The mean output of one group.
pub(super) struct MeanKernel<'a> {
    pub weights: &'a [Tile],
    pub features: &'a [f32],
    pub mean: &'a mut [f32; ROWS],
}

impl Kernel for MeanKernel<'_> {
    type Output = ();
    const IS_WIDE: bool = true;

    #[inline(always)]
    fn run<L: F32x8>(self) {
        let mut sums = [L::Wide::splat(0.0); PAIRS];
        let (whole, rest) = self.features.as_chunks();
        for (w, g) in self.weights.iter().zip(whole) {
            add_products::<L>(w, g, &mut sums);
        }
        if let Some(w) = self.weights.get(whole.len()) {
            add_products::<L>(w, &filled(rest), &mut sums);
        }
        *self.mean = totals::<L>(sums);
    }
}

/// Adds the products of one tile's weights with the features.
#[inline(always)]
fn add_products<L: F32x8>(w: &Tile, g: &[f32; LANES], sums: &mut [L::Wide; PAIRS]) {
    let g = L::load(g);
    let g = L::Wide::joined([g, g]);
    for (sum, pair) in sums.iter_mut().zip(w.pairs()) {
        *sum = *sum + L::Wide::load(pair) * g;
    }
}
