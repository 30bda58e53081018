//! The pass of the linear critic over its features: step, trace and two values in one, for there are many features.

use tectum_encoder::simd::{F32x8, Kernel, LANES, filled};

/// Takes the step that is due, `v += due e`, adds to the trace, `e = kept e + h`, and says what two sets of features are
/// worth afterwards. All slices are of one length.
pub(super) struct CriticKernel<'a> {
    pub values: &'a mut [f32],
    pub trace: &'a mut [f32],
    pub here: &'a [f32],
    pub next: &'a [f32],
    /// What is added to the trace, `h`.
    pub direction: &'a [f32],
    pub kept: f32,
    pub due: f32,
}

impl Kernel for CriticKernel<'_> {
    type Output = [f32; 2];

    #[inline(always)]
    fn run<L: F32x8>(self) -> [f32; 2] {
        let (kept, due) = (L::splat(self.kept), L::splat(self.due));
        let mut sums = [L::splat(0.0); 2];
        let (values, values_rest) = self.values.as_chunks_mut();
        let (trace, trace_rest) = self.trace.as_chunks_mut();
        let (here, here_rest) = self.here.as_chunks();
        let (next, next_rest) = self.next.as_chunks();
        let (direction, direction_rest) = self.direction.as_chunks();
        let seen = here.iter().zip(next).zip(direction);
        for ((v, e), ((here, next), h)) in values.iter_mut().zip(trace).zip(seen) {
            judge((v, e), [kept, due], [here, next, h], &mut sums);
        }
        if !here_rest.is_empty() {
            let (mut v, mut e) = (filled(values_rest), filled(trace_rest));
            let seen = [&filled(here_rest), &filled(next_rest), &filled(direction_rest)];
            judge((&mut v, &mut e), [kept, due], seen, &mut sums);
            values_rest.copy_from_slice(&v[..values_rest.len()]);
            trace_rest.copy_from_slice(&e[..trace_rest.len()]);
        }
        let mut worth = [0.0; 2];
        for i in 0..2 {
            let [low, high] = sums[i].halves();
            worth[i] = (low + high).element_sum();
        }
        worth
    }
}

/// The same for eight features.
#[inline(always)]
fn judge<L: F32x8>(
    (v, e): (&mut [f32; LANES], &mut [f32; LANES]),
    [kept, due]: [L; 2],
    [here, next, h]: [&[f32; LANES]; 3],
    sums: &mut [L; 2],
) {
    let (value, trace) = (L::load(v) + L::load(e) * due, L::load(e) * kept + L::load(h));
    (*v, *e) = (value.store(), trace.store());
    *sums = [sums[0] + value * L::load(here), sums[1] + value * L::load(next)];
}
