//! The pass of the linear critic over its features: update, trace and two values in one pass, because there are
//! many features.

use tectum_encoder::simd::{F32x8, Kernel, LANES, filled};

/// Applies the pending step, `v += step e`, updates the trace, `e = decay e + h`, and returns the values of two
/// sets of features afterwards. All slices have the same length.
pub(super) struct CriticKernel<'a> {
    pub values: &'a mut [f32],
    pub trace: &'a mut [f32],
    pub here: &'a [f32],
    pub next: &'a [f32],
    /// Added to the trace, `h`.
    pub direction: &'a [f32],
    /// Factor of the old trace.
    pub decay: f32,
    /// Factor with which the old trace is added to the weights.
    pub step: f32,
}

impl Kernel for CriticKernel<'_> {
    type Output = [f32; 2];

    #[inline(always)]
    fn run<L: F32x8>(self) -> [f32; 2] {
        let (decay, step) = (L::splat(self.decay), L::splat(self.step));
        let mut sums = [L::splat(0.0); 2];
        let (values, values_rest) = self.values.as_chunks_mut();
        let (trace, trace_rest) = self.trace.as_chunks_mut();
        let (here, here_rest) = self.here.as_chunks();
        let (next, next_rest) = self.next.as_chunks();
        let (direction, direction_rest) = self.direction.as_chunks();
        let features = here.iter().zip(next).zip(direction);
        for ((v, e), ((here, next), h)) in values.iter_mut().zip(trace).zip(features) {
            update_and_add((v, e), [decay, step], [here, next, h], &mut sums);
        }
        if !here_rest.is_empty() {
            let (mut v, mut e) = (filled(values_rest), filled(trace_rest));
            let features = [&filled(here_rest), &filled(next_rest), &filled(direction_rest)];
            update_and_add((&mut v, &mut e), [decay, step], features, &mut sums);
            values_rest.copy_from_slice(&v[..values_rest.len()]);
            trace_rest.copy_from_slice(&e[..trace_rest.len()]);
        }
        let mut result = [0.0; 2];
        for i in 0..2 {
            let [low, high] = sums[i].halves();
            result[i] = (low + high).element_sum();
        }
        result
    }
}

/// Updates eight weights and their trace, and adds their products with both sets of features to `sums`.
#[inline(always)]
fn update_and_add<L: F32x8>(
    (v, e): (&mut [f32; LANES], &mut [f32; LANES]),
    [decay, step]: [L; 2],
    [here, next, h]: [&[f32; LANES]; 3],
    sums: &mut [L; 2],
) {
    let (value, trace) = (L::load(v) + L::load(e) * step, L::load(e) * decay + L::load(h));
    (*v, *e) = (value.store(), trace.store());
    *sums = [sums[0] + value * L::load(here), sums[1] + value * L::load(next)];
}
