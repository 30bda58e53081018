//! Every rule against a numerical gradient: in a small task with a known expected reward, the mean of many
//! updates from the same weights points along the gradient.
//!
//! The task: one of three overlapping contexts `g`, a command `u` with two outputs, the reward `-|u - t|^2` at
//! once and `-|u - s|^2` a tick later, where `t` and `s` depend on the context. The command of the second tick
//! has no effect. A rule with trace decay `beta` follows `J = E[r_0 + beta r_1]`.

use super::*;
use crate::policy::Exploration;

const CONTEXTS: [[f32; 4]; 3] = [[0.8, 0.6, 0.0, 0.0], [0.0, 0.8, 0.6, 0.0], [0.6, 0.0, 0.2, 0.0]];
const WAIT: [f32; 4] = [0.0, 0.0, 0.0, 1.0];
/// `t` and `s`, by context and output.
const NOW: [[f32; 2]; 3] = [[0.5, -0.2], [0.1, 0.6], [-0.4, 0.3]];
const LATER: [[f32; 2]; 3] = [[-0.6, 0.4], [0.7, 0.1], [0.2, -0.8]];
const BETA: f32 = 0.6;
const SIGMA: f32 = 0.3;
const EPISODES: usize = 60_000;
/// Offset of rewards, so that a baseline matters.
const OFFSET: f32 = 0.3;

type Weights = [[f64; 4]; 2];

fn reward(u: [f64; 2], target: [f32; 2]) -> f64 {
    f64::from(OFFSET) - (0..2).map(|i| (u[i] - f64::from(target[i])).powi(2)).sum::<f64>()
}

/// `J` for weights `w`, without the constant cost of the noise.
fn expected(w: &Weights) -> f64 {
    let mean = |g: &[f32; 4]| [0, 1].map(|i| (0..4).map(|k| w[i][k] * f64::from(g[k])).sum::<f64>());
    let contexts = CONTEXTS.iter().zip(NOW.iter().zip(LATER));
    contexts.map(|(g, (now, later))| reward(mean(g), *now) + f64::from(BETA) * reward(mean(g), later)).sum::<f64>()
        / 3.0
}

/// The gradient of `J` at `w`, by central differences.
fn numerical(w: &Weights) -> Weights {
    let mut gradient = [[0.0; 4]; 2];
    for (i, row) in gradient.iter_mut().enumerate() {
        for (k, slope) in row.iter_mut().enumerate() {
            let (mut more, mut less) = (*w, *w);
            more[i][k] += 1e-4;
            less[i][k] -= 1e-4;
            *slope = (expected(&more) - expected(&less)) / 2e-4;
        }
    }
    gradient
}

/// The sum of all updates of `rule`, which has a tiny step size, from weights 0.
fn update(rule: &mut dyn LearningRule) -> Weights {
    let mut policy = LinearPolicy::new(4, (0..4).collect(), 2);
    let mut exploration = Exploration::new(5, SIGMA, 2);
    for episode in 0..EPISODES {
        let context = episode % 3;
        let command = exploration.draw();
        let at = |target: [f32; 2]| reward([f64::from(command[0]), f64::from(command[1])], target) as f32;
        let next = &CONTEXTS[(episode + 1) % 3];
        let ticks = [
            (&CONTEXTS[context], command, at(NOW[context]), &WAIT),
            (&WAIT, exploration.draw(), at(LATER[context]), next),
        ];
        for (features, noise, reward, next_features) in ticks {
            let (noise, applied) = (&noise, &noise);
            rule.learn(
                &mut policy,
                &Transition {
                    features,
                    inputs: &[],
                    noise,
                    applied,
                    reward,
                    next_features,
                    next_inputs: &[],
                    new_target: false,
                },
            );
        }
        rule.cut_trace();
    }
    assert!(policy.norm() < 1e-2, "the weights are too far from 0, where the gradient is taken: {}", policy.norm());
    [0, 1].map(|i| std::array::from_fn(|k| f64::from(policy.weight(i, k))))
}

/// Cosine of the angle between two directions, over features 0 to 2, which the contexts use.
fn cosine(a: &Weights, b: &Weights) -> f64 {
    let product = |a: &Weights, b: &Weights| {
        (0..2).flat_map(|i| (0..3).map(move |k| (i, k))).map(|(i, k)| a[i][k] * b[i][k]).sum::<f64>()
    };
    product(a, b) / (product(a, a) * product(b, b)).sqrt()
}

const STEP: f32 = 1e-6;

fn actor_critic() -> ActorCritic {
    let critic = CriticConstants {
        step: 0.05,
        discount: 0.9,
        decay: 0.5,
        reward_feature: 0.0,
        bound: 1e9,
        half_life: f32::INFINITY,
        floor: 1.0,
        warm_up: 0.0,
        noise_step: 0.01,
        sigma: SIGMA,
    };
    ActorCritic::new(4, 2, BETA, STEP, critic)
}

#[test]
fn first_order_rules_follow_the_gradient() {
    let gradient = numerical(&[[0.0; 4]; 2]);
    let paper = || PaperRule::new(4, 2, BETA, STEP);
    let rules: [(&str, Box<dyn LearningRule>); 3] = [
        ("paper", Box::new(paper())),
        ("baseline", Box::new(BaselineRule::new(paper(), 100.0))),
        ("actor-critic", Box::new(actor_critic())),
    ];
    for (name, mut rule) in rules {
        let cosine = cosine(&update(&mut *rule), &gradient);
        assert!(cosine > 0.98, "{name}: {cosine}");
    }
}

#[test]
fn the_natural_rule_follows_the_gradient_times_the_inverse_of_the_moments() {
    let mut moments = vec![0.0; 16];
    for context in CONTEXTS.iter().chain([WAIT, WAIT, WAIT].iter()) {
        for (m, (a, b)) in moments.iter_mut().zip(context.iter().flat_map(|a| context.iter().map(move |b| (a, b)))) {
            *m += f64::from(a * b) / 6.0;
        }
    }
    let (len, share) = (4, 0.05);
    let ridge = share * (0..len).map(|i| moments[i * len + i]).sum::<f64>() / len as f64;
    let metric = NaturalMetric::from_moments(moments.clone(), len, len, share);
    let update = update(&mut actor_critic().with(None, Some(metric)));
    let gradient = numerical(&[[0.0; 4]; 2]);
    // Without the metric: (M + ridge) times the update.
    let undone = update.map(|row| {
        std::array::from_fn(|k| ridge * row[k] + (0..len).map(|j| moments[k * len + j] * row[j]).sum::<f64>())
    });
    let (natural, plain) = (cosine(&undone, &gradient), cosine(&update, &gradient));
    assert!(natural > 0.98 && plain < 0.95, "{natural} {plain}");
}
