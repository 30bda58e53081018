//! A number for every output and feature, as policy and learning rules walk over them: the weights, and a trace laid out
//! like them.
//!
//! A [`Tile`] holds four outputs of eight neighbouring features, output by output. So a pass reads eight features once for
//! four outputs, as the lanes that they lie in (nothing has to be spread over lanes), and memory is read and written in one
//! run. Up to four outputs take one group of tiles, up to eight take two; what is not in use stays zero.

use bytemuck::{Pod, Zeroable};

use crate::state::{Persist, StateVisitor};
use tectum_encoder::simd::{F32x8, Kernel, LANES, SimdPath, filled};

/// Outputs of a group.
pub(super) const ROWS: usize = 4;

/// Eight features of four outputs.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C, align(64))]
pub(super) struct Tile(pub [[f32; LANES]; ROWS]);

/// A matrix of outputs by (padded) features.
#[derive(Debug, Clone, PartialEq)]
pub struct Tiles {
    pub(super) groups: Vec<Vec<Tile>>,
}

impl Tiles {
    /// All zero, for `len` (padded) features and `outputs` outputs.
    pub fn zeroed(len: usize, outputs: usize) -> Self {
        Self { groups: vec![vec![Tile::zeroed(); len.div_ceil(LANES)]; outputs.div_ceil(ROWS)] }
    }

    /// The number of `output` and of the feature that stands at `place`.
    #[inline]
    pub fn get(&self, output: usize, place: usize) -> f32 {
        self.groups[output / ROWS][place / LANES].0[output % ROWS][place % LANES]
    }

    /// The same, to be written.
    #[inline]
    pub fn get_mut(&mut self, output: usize, place: usize) -> &mut f32 {
        &mut self.groups[output / ROWS][place / LANES].0[output % ROWS][place % LANES]
    }

    /// All numbers in the order of memory, group by group.
    pub fn as_slices(&self) -> impl Iterator<Item = &[f32]> {
        self.groups.iter().map(|group| bytemuck::cast_slice(group))
    }

    /// Makes all of it zero.
    pub fn clear(&mut self) {
        for group in &mut self.groups {
            group.fill(Tile::zeroed());
        }
    }

    /// Euclidean norm.
    pub fn norm(&self) -> f32 {
        self.norm_on(SimdPath::best())
    }

    /// The same on any path: the same bits.
    pub fn norm_on(&self, path: SimdPath) -> f32 {
        path.run(NormKernel(&self.groups))
    }
}

impl Persist for Tiles {
    /// In the order of memory: tile after tile, and in a tile output after output.
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        for group in &mut self.groups {
            visitor.numbers::<f32>("tiles", bytemuck::cast_slice_mut(group));
        }
    }
}

/// The Euclidean norm of all tiles: by output and lane, then outputs, and the lanes last.
struct NormKernel<'a>(&'a [Vec<Tile>]);

impl Kernel for NormKernel<'_> {
    type Output = f32;

    #[inline(always)]
    fn run<L: F32x8>(self) -> f32 {
        let mut sums = [L::splat(0.0); ROWS];
        for tile in self.0.iter().flatten() {
            for (sum, row) in sums.iter_mut().zip(&tile.0) {
                let x = L::load(row);
                *sum = *sum + x * x;
            }
        }
        let [a, b, c, d] = sums;
        ((a + b) + (c + d)).store().iter().sum::<f32>().sqrt()
    }
}

/// What a learning rule with a trace does in a tick: `z = decay z + gain g^T`, and then `W += rate z`.
#[derive(Debug, Clone, Copy)]
pub struct TraceStep<'a> {
    /// The features `g`, in the encoder's padded layout.
    pub features: &'a [f32],
    /// For each output.
    pub gain: &'a [f32],
    /// What is left of the trace.
    pub decay: f32,
    /// The factor with which the trace is added to the weights.
    pub rate: f32,
}

/// A step of one group, and the mean output for `next` in the same pass: what a tick costs is mostly the way of weights and
/// trace through the cache, and so they make it once.
pub(super) struct StepKernel<'a, const ANSWER: bool> {
    pub weights: &'a mut [Tile],
    pub trace: &'a mut [Tile],
    pub step: TraceStep<'a>,
    pub next: &'a [f32],
    pub mean: &'a mut [f32; ROWS],
}

impl<const ANSWER: bool> Kernel for StepKernel<'_, ANSWER> {
    type Output = ();

    #[inline(always)]
    fn run<L: F32x8>(self) {
        let mut known = StepConstants {
            gains: [L::splat(0.0); ROWS],
            decay: L::splat(self.step.decay),
            rate: L::splat(self.step.rate),
        };
        for (to, gain) in known.gains.iter_mut().zip(self.step.gain) {
            *to = L::splat(*gain);
        }
        let features = self.step.features;
        let next = if ANSWER { self.next } else { features };
        let mut sums = [L::splat(0.0); ROWS];
        let ((whole, rest), (whole_next, rest_next)) = (features.as_chunks(), next.as_chunks());
        let tiles = self.weights.iter_mut().zip(self.trace.iter_mut());
        for ((tile, g), next) in tiles.zip(whole).zip(whole_next) {
            known.advance::<ANSWER>(tile, g, next, &mut sums);
        }
        let last = whole.len();
        if let (Some(w), Some(z)) = (self.weights.get_mut(last), self.trace.get_mut(last)) {
            known.advance::<ANSWER>((w, z), &filled(rest), &filled(rest_next), &mut sums);
        }
        *self.mean = L::totals(sums);
    }
}

/// What is the same for all tiles of a step.
struct StepConstants<L> {
    gains: [L; ROWS],
    decay: L,
    rate: L,
}

impl<L: F32x8> StepConstants<L> {
    /// A step of one tile.
    #[inline(always)]
    fn advance<const ANSWER: bool>(
        &self,
        (w, z): (&mut Tile, &mut Tile),
        g: &[f32; LANES],
        next: &[f32; LANES],
        sums: &mut [L; ROWS],
    ) {
        let (g, next) = (L::load(g), L::load(next));
        #[expect(
            clippy::needless_range_loop,
            reason = "half again as many instructions in the tests' profile otherwise"
        )]
        for i in 0..ROWS {
            let trace = L::load(&z.0[i]) * self.decay + self.gains[i] * g;
            z.0[i] = trace.store();
            let weight = L::load(&w.0[i]) + trace * self.rate;
            w.0[i] = weight.store();
            if ANSWER {
                sums[i] = sums[i] + weight * next;
            }
        }
    }
}

/// The mean output of one group.
pub(super) struct MeanKernel<'a> {
    pub weights: &'a [Tile],
    pub features: &'a [f32],
    pub mean: &'a mut [f32; ROWS],
}

impl Kernel for MeanKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: F32x8>(self) {
        let mut sums = [L::splat(0.0); ROWS];
        let (whole, rest) = self.features.as_chunks();
        for (w, g) in self.weights.iter().zip(whole) {
            answer(w, g, &mut sums);
        }
        if let Some(w) = self.weights.get(whole.len()) {
            answer(w, &filled(rest), &mut sums);
        }
        *self.mean = L::totals(sums);
    }
}

/// Adds what one tile says to the features.
#[inline(always)]
fn answer<L: F32x8>(w: &Tile, g: &[f32; LANES], sums: &mut [L; ROWS]) {
    let g = L::load(g);
    for (sum, row) in sums.iter_mut().zip(&w.0) {
        *sum = *sum + L::load(row) * g;
    }
}
