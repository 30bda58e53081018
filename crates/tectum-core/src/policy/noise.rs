//! The distribution of the exploration noise.

use serde::{Deserialize, Serialize};

/// Distributions of the exploration noise. Outputs are independent, with mean 0 and standard deviation `sigma`
/// each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Noise {
    /// The paper's normal distribution.
    Gaussian,
    /// The Laplace distribution (paper section 5): many small deviations, a few large ones.
    Laplace,
}
