//! Test bench of the model-predictive learner on the tasks: mean reward and end error of each trial.
use std::time::Instant;
use tectum_core::learner::model_predictive::*;
use tectum_core::plant::{Plant, task::Task};

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let (name, ticks) = (&args[1], args[2].parse::<u64>().unwrap());
    let (first, seeds) = (args[3].parse::<u64>().unwrap(), args[4].parse::<u64>().unwrap());
    let config: ModelPredictiveConfig = serde_json::from_str(args.get(5).map_or("{}", |s| s)).unwrap();
    let verbose = std::env::var("V").is_ok();
    let task = Task::named(name).unwrap();
    let signals = task.body.signals();
    let inputs: Vec<_> = signals
        .inputs
        .iter()
        .map(|s| InputRange {
            min: s.min,
            max: s.max,
            wraps: s.unit == "rad" && (s.max - s.min - std::f64::consts::TAU).abs() < 1e-6,
            radians: (s.unit == "rad").then_some(1.0),
        })
        .collect();
    let (n, m) = (inputs.len(), signals.outputs.len());
    let window: u64 = match name.as_str() {
        "pendulum" | "pendulum-random" | "cart-pole" => 200,
        "reacher" => 50,
        "furuta" => 500,
        _ => 80,
    };
    for seed in first..first + seeds {
        let mut plant = task.plant(seed);
        let spec = ModelPredictiveSpec {
            inputs: inputs.clone(),
            limits: vec![task.max_command; m],
            sigma: vec![task.sigma; m],
            seed,
            config: config.clone(),
        };
        let mut agent = ModelPredictive::new(&spec);
        let (mut x, mut u, mut applied) = (vec![0f32; 32], vec![0.0; m], vec![0.0; m]);
        let mut reward = 0.0;
        let (mut sum, mut end) = (0.0, 0.0);
        let mut line = String::new();
        let cpu = || {
            let s = std::fs::read_to_string("/proc/self/schedstat").unwrap();
            s.split(' ').next().unwrap().parse::<f64>().unwrap() / 1e6
        };
        let begin = cpu();
        let _ = Instant::now();
        let mut worst = 0f64;
        for tick in 0..ticks {
            let new_target = plant.sense(tick, &mut x);
            let wide: Vec<f64> = x[..n].iter().map(|&x| x as f64).collect();
            let at = cpu();
            let flags = TickFlags { new_target, ..TickFlags::default() };
            agent.act(&Observed { inputs: &wide, reward, applied: &applied, flags }, &mut u);
            applied.copy_from_slice(&u);
            agent.improve();
            worst = worst.max(cpu() - at);
            let v: Vec<f32> = u.iter().map(|&x| x as f32).collect();
            let o = plant.advance(tick, &v);
            reward = o.reward as f64;
            sum += reward;
            if tick % window >= window - window / 8 {
                end += o.measures[0] as f64 / (window / 8) as f64;
            }
            if (tick + 1) % window == 0 {
                line += &format!(" {:.4}({:.3})", sum / window as f64, end);
                if verbose {
                    println!("{tick} {:.4} end {end:.3} | {}", sum / window as f64, format!("{:?}", agent.columns()));
                }
                sum = 0.0;
                end = 0.0;
            }
        }
        println!("{name} {seed}: {:.1} ms max {worst:.1} {:?}{line}", (cpu() - begin) / ticks as f64, agent.counts);
    }
}
