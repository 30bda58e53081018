//! The distribution of the exploration noise.

use serde::{Deserialize, Serialize};

/// Distributions of the exploration noise, each of mean 0 and standard deviation `sigma` on every output by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Noise {
    /// The paper's normal distribution.
    Gaussian,
    /// The double exponential one, of which the paper's section 5 speaks: many small deviations, a few large ones.
    Laplace,
}
