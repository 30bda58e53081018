//! The models of a learner, and how they are fitted anew.

use super::super::config::ModelPredictiveSpec;
use super::super::dynamics::Dynamics;
use super::super::layout::Places;
use super::super::layouts::reward_layout;
use super::super::model::{Model, ModelSize};
use super::super::refit::RefitSettings;
use crate::seed::Rng;

/// Features of a reward model beside its products, about.
const OTHER_FEATURES: usize = 260;

/// So many features leave nine tenths of a tick's operations (millions; 0 for no limit) when two models learn from it,
/// `4 F^2` operations each. A refit takes some hundred times as many as that, so that a larger model is fitted too
/// rarely.
fn affordable_features(operations: f64) -> usize {
    if operations > 0.0 { (operations * 1e6 / 80.0).sqrt() as usize } else { usize::MAX }
}

/// The models of a learner that knows nothing: movement, reward before the tick, reward after it.
pub(super) fn models(spec: &ModelPredictiveSpec, places: Places, rng: &mut Rng) -> (Dynamics, [Model; 2]) {
    let config = &spec.config;
    let settings = RefitSettings {
        points: config.points / 2,
        steps: config.steps,
        extra_steps: 50_000_000,
        step: 0.25,
        width: 2.5,
        noise_floor: config.noise_floor,
        standardise: false,
        robust: true,
        spread: false,
        memory: config.memory,
    };
    let dynamics = Dynamics::new(spec, places, settings, rng);
    let layout = reward_layout(places, &spec.inputs);
    // Rewards of many joints need products of many inputs: their number grows with the square of that of the inputs.
    let or = |value: usize, usual: usize| if value > 0 { value } else { usual };
    let (wanted, affordable) = (8 * places.inputs * places.inputs, affordable_features(config.operations));
    let products = or(config.reward_products, wanted.min(affordable.saturating_sub(OTHER_FEATURES)));
    let size =
        ModelSize::within(&layout, 1, products, or(config.reward_features, products + OTHER_FEATURES.min(affordable)));
    let size = ModelSize { samples: 6, ..size };
    let settings = RefitSettings {
        points: config.points,
        extra_steps: 150_000_000,
        standardise: true,
        robust: false,
        spread: true,
        ..settings
    };
    let rewards = [0, 1].map(|_| Model::new(layout.clone(), size, settings, rng));
    (dynamics, rewards)
}
