//! What a model looks at, and the scales that it learns.
//!
//! Every model sees the same vector `q` of a tick, scaled to about [-1, 1]: inputs `z` (n), their last changes `d`
//! (n), the commands of the two ticks before (m each), the command `u` (m); `D = 2 n + 3 m` numbers. A model sees
//! some of them as *units*: a number itself, an angle as cosine and sine, whose frequency is learned unless it is
//! known, or the sum of some angles as its cosine and sine. Its prior covariance (a kernel, Rasmussen & Williams 2006)
//! is a sum of six parts, with `z_g = sum_{i in g} v_i x_i.x_i'` for each group of units `g`, and `e_k`, the sum of all
//! products of `k` of them:
//!
//! ```text
//! k(q, q') = b + sum_i a_i x_i.x_i' + sum_i c_i (x_i x_i')^2         linear terms and squares
//!          + p e_2 + t e_3                                           products of two inputs, and of three
//!          + s (prod_g (1 + z_g) - 1 - e_1 - e_2 - e_3)              multilinear products of four or more
//!          + f exp(-1/2 sum_i rho_i |x_i - x_i'|^2)                  anything smooth
//! ```
//!
//! with `x_i` the value of unit `i` (one number, or cosine and sine). All of `b, a, c, p, t, s, v, f, rho`, the noise
//! and the frequencies are scales, learned as logarithms.

/// Where the parts of `q` begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Places {
    /// Number of inputs.
    pub inputs: usize,
    /// Number of commands.
    pub commands: usize,
}

impl Places {
    /// Numbers of a state of the plan: inputs, changes, two commands before.
    pub fn state(self) -> usize {
        2 * self.inputs + 2 * self.commands
    }

    /// Numbers of `q`.
    pub fn len(self) -> usize {
        self.state() + self.commands
    }

    /// The change of input `i`.
    pub fn change(self, i: usize) -> usize {
        self.inputs + i
    }

    /// Command `j`, `ago` ticks before the command of the tick.
    pub fn command(self, j: usize, ago: usize) -> usize {
        match ago {
            0 => self.state() + j,
            _ => 2 * self.inputs + (ago - 1) * self.commands + j,
        }
    }
}

/// Most angles of a sum.
pub const MOST_TERMS: usize = 4;

/// What a unit's value is: a place of `q`, or a sum of angles, each a place times its frequency, with a sign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Terms {
    terms: [(usize, f64); MOST_TERMS],
    len: usize,
}

impl Terms {
    /// Place `at` itself.
    pub fn one(at: usize) -> Self {
        Self { terms: [(at, 1.0); MOST_TERMS], len: 1 }
    }

    /// A sum of at most [`MOST_TERMS`] places with their factors.
    pub fn sum(of: &[(usize, f64)]) -> Self {
        let mut terms = [(0, 0.0); MOST_TERMS];
        terms[..of.len()].copy_from_slice(of);
        Self { terms, len: of.len() }
    }

    /// The places and their factors.
    #[inline]
    pub fn each(&self) -> &[(usize, f64)] {
        &self.terms[..self.len]
    }

    /// The factor of place `at`; 0 if it is none of them.
    #[inline]
    pub fn factor(&self, at: usize) -> f64 {
        self.each().iter().find(|(place, _)| *place == at).map_or(0.0, |(_, factor)| *factor)
    }

    /// The value at `q`.
    #[inline]
    pub fn value(&self, q: &[f64]) -> f64 {
        self.each().iter().fold(0.0, |sum, (at, factor)| sum + factor * q[*at])
    }
}

/// One unit: a number of `q`, as it is or as an angle, or a sum of angles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit {
    /// Its place in `q`; of a sum the first.
    pub at: usize,
    /// What its value is.
    pub terms: Terms,
    /// Whether it is seen as cosine and sine.
    pub circle: bool,
    /// The first of its components.
    pub component: usize,
    /// The group of the products to which it belongs.
    pub group: Option<usize>,
    /// Which of the scales are learned (by [`ScaleKind`]).
    pub scales: [bool; ScaleKind::COUNT],
}

/// The scales of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScaleKind {
    /// Prior variance of linear weights.
    Linear,
    /// Prior variance of the square's weight.
    Square,
    /// Factor in the products.
    Product,
    /// Inverse squared length of the smooth part.
    Smooth,
    /// Frequency of an angle.
    Frequency,
}

impl ScaleKind {
    /// Number of scales of a unit.
    pub const COUNT: usize = 5;
}

/// Scales of the whole model, before those of the units.
pub const BIAS: usize = 0;
/// Amplitude of the products of two: distances in a plane need no others, and a model that has found so extrapolates.
pub const PAIRS: usize = 1;
/// Amplitude of the products of three: distances in space need these, too.
pub const TRIPLES: usize = 2;
/// Amplitude of the products of four or more.
pub const PRODUCTS: usize = 3;
/// Amplitude of the smooth part.
pub const SMOOTH: usize = 4;
/// Noise, as a part of the prior's scale.
pub const NOISE: usize = 5;
const GLOBAL: usize = 6;

/// What a model looks at, with the first logarithms of its scales.
#[derive(Debug, Clone)]
pub struct Layout {
    /// Numbers of `q`.
    pub width: usize,
    /// The units, those that are angles first.
    pub units: Vec<Unit>,
    /// Number of angles.
    pub circles: usize,
    /// Number of components: two of an angle, one of any other unit.
    pub components: usize,
    /// The units of each group of the products.
    pub groups: Vec<Vec<usize>>,
    /// First logarithms of all scales.
    pub prior: Vec<f64>,
    /// Which of them are learned.
    pub learned: Vec<bool>,
}

/// The first values of a unit's scales; 0 leaves the part out.
#[derive(Debug, Clone, Copy, Default)]
pub struct Priors {
    /// See [`ScaleKind::Linear`].
    pub linear: f64,
    /// See [`ScaleKind::Square`].
    pub square: f64,
    /// See [`ScaleKind::Product`].
    pub product: f64,
    /// See [`ScaleKind::Smooth`].
    pub smooth: f64,
}

impl Layout {
    /// An empty layout for `width` numbers; amplitudes of bias, products of two, of three, and of more, the smooth
    /// part, and the noise.
    pub fn new(width: usize, amplitudes: [f64; GLOBAL]) -> Self {
        let prior = amplitudes.map(libm::log).to_vec();
        let learned = vec![true; GLOBAL];
        Self { width, units: Vec::new(), circles: 0, components: 0, groups: Vec::new(), prior, learned }
    }

    /// The place of a unit's scale among the scales.
    #[inline]
    pub fn scale(unit: usize, scale: ScaleKind) -> usize {
        GLOBAL + unit * ScaleKind::COUNT + scale as usize
    }

    /// Adds place `at` as an angle of `frequency`, which is learned if `learned`. All angles come before the other
    /// units.
    pub fn circle(&mut self, at: usize, frequency: f64, learned: bool, group: Option<usize>, priors: Priors) {
        assert_eq!(self.circles, self.units.len(), "angles come first");
        self.circles += 1;
        self.unit(Terms::one(at), Some((frequency, learned)), group, Priors { square: 0.0, ..priors });
    }

    /// Adds the sum of angles: places with the frequency of their angle, times its sign. It stands among the angles.
    pub fn angle_sum(&mut self, terms: Terms, group: Option<usize>, priors: Priors) {
        assert_eq!(self.circles, self.units.len(), "angles come first");
        self.circles += 1;
        self.unit(terms, Some((1.0, false)), group, Priors { square: 0.0, ..priors });
    }

    /// Adds place `at` as it is.
    pub fn number(&mut self, at: usize, group: Option<usize>, priors: Priors) {
        self.unit(Terms::one(at), None, group, priors);
    }

    fn unit(&mut self, terms: Terms, frequency: Option<(f64, bool)>, group: Option<usize>, priors: Priors) {
        let (w, learns) = frequency.unwrap_or((1.0, false));
        let group = group.filter(|_| priors.product > 0.0);
        let values = [priors.linear, priors.square, priors.product, priors.smooth, w];
        let mut scales = values.map(|v| v > 0.0);
        scales[ScaleKind::Product as usize] = group.is_some();
        scales[ScaleKind::Frequency as usize] = learns;
        if let Some(group) = group {
            self.groups.resize(self.groups.len().max(group + 1), Vec::new());
            self.groups[group].push(self.units.len());
        }
        self.prior.extend(values.map(|v| if v > 0.0 { libm::log(v) } else { 0.0 }));
        self.learned.extend(scales);
        let (at, circle) = (terms.each()[0].0, frequency.is_some());
        self.units.push(Unit { at, terms, circle, component: self.components, group, scales });
        self.components += if frequency.is_some() { 2 } else { 1 };
    }

    /// Has the model look at some of the inputs (bits) alone: the units of others are in no feature. For layouts whose
    /// units are of one input each.
    pub fn show_only(&mut self, inputs: u32) {
        for (u, unit) in self.units.iter_mut().enumerate() {
            let shown = inputs >> unit.at & 1 == 1;
            let first = Self::scale(u, ScaleKind::Linear);
            for (k, scale) in unit.scales.iter_mut().enumerate() {
                *scale = shown && self.learned[first + k];
            }
        }
    }

    /// Writes the components of `q` to `out`, and, where wanted, their first derivatives. The second derivative of
    /// cosine and sine is `-w^2` times themselves, that of a number 0. `frequencies` has one for each angle.
    pub fn components(&self, frequencies: &[f64], q: &[f64], out: &mut [f64], slopes: Option<&mut [f64]>) {
        for (unit, w) in self.units[..self.circles].iter().zip(frequencies) {
            let (sin, cos) = super::functions::sin_cos(w * unit.terms.value(q));
            out[unit.component] = cos;
            out[unit.component + 1] = sin;
        }
        for unit in &self.units[self.circles..] {
            out[unit.component] = q[unit.at];
        }
        if let Some(slopes) = slopes {
            for (unit, w) in self.units[..self.circles].iter().zip(frequencies) {
                slopes[unit.component] = -w * out[unit.component + 1];
                slopes[unit.component + 1] = w * out[unit.component];
            }
            for unit in &self.units[self.circles..] {
                slopes[unit.component] = 1.0;
            }
        }
    }
}
