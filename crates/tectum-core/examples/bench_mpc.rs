//! Test bench of the model-predictive learner (throw-away).
use std::time::Instant;
use tectum_core::learner::model_predictive::*;
use tectum_core::plant::{Angles, Arm, ArmConfig, Plant};

struct Task {
    inputs: Vec<InputRange>,
    limits: Vec<f64>,
    sigma: Vec<f64>,
    window: usize,
    sim: Box<dyn Sim>,
}
trait Sim {
    fn sense(&mut self, tick: u64, inputs: &mut [f64]) -> TickFlags;
    fn advance(&mut self, tick: u64, u: &[f64]) -> (f64, f64); // reward, error
}
struct ArmSim {
    arm: Arm,
    n: usize,
    delay: usize,
    queue: Vec<Vec<f64>>,
    lag: f64,
    state: Vec<f64>,
}
impl Sim for ArmSim {
    fn sense(&mut self, tick: u64, inputs: &mut [f64]) -> TickFlags {
        let mut x = [0f32; 16];
        let new = self.arm.sense(tick, &mut x);
        for i in 0..self.n {
            inputs[i] = x[i] as f64;
        }
        TickFlags { new_target: new, ..Default::default() }
    }
    fn advance(&mut self, tick: u64, u: &[f64]) -> (f64, f64) {
        self.queue.push(u.to_vec());
        let u = if self.queue.len() > self.delay { self.queue.remove(0) } else { vec![0.0; u.len()] };
        for (s, u) in self.state.iter_mut().zip(&u) {
            *s += self.lag * (u - *s);
        }
        let v: Vec<f32> = self.state.iter().map(|&x| x as f32).collect();
        let o = self.arm.advance(tick, &v);
        (o.reward as f64, o.measures[0] as f64)
    }
}
struct Pendulum {
    th: f64,
    w: f64,
}
impl Sim for Pendulum {
    fn sense(&mut self, _t: u64, x: &mut [f64]) -> TickFlags {
        x[0] = self.th.cos();
        x[1] = self.th.sin();
        x[2] = self.w;
        TickFlags::default()
    }
    fn advance(&mut self, _t: u64, u: &[f64]) -> (f64, f64) {
        let pi = std::f64::consts::PI;
        let u = u[0].clamp(-2.0, 2.0);
        let a = (self.th + pi).rem_euclid(2.0 * pi) - pi;
        let cost = a * a + 0.1 * self.w * self.w + 0.001 * u * u;
        self.w = (self.w + (15.0 * self.th.sin() + 3.0 * u) * 0.05).clamp(-8.0, 8.0);
        self.th += self.w * 0.05;
        (-cost, a.abs())
    }
}
/// dm_control-like cart-pole, 20 ms x 2.
struct CartPole {
    x: f64,
    v: f64,
    th: f64,
    w: f64,
}
impl Sim for CartPole {
    fn sense(&mut self, _t: u64, o: &mut [f64]) -> TickFlags {
        o[0] = self.x;
        o[1] = self.th.cos();
        o[2] = self.th.sin();
        o[3] = self.v;
        o[4] = self.w;
        TickFlags::default()
    }
    fn advance(&mut self, _t: u64, u: &[f64]) -> (f64, f64) {
        let f = 10.0 * u[0].clamp(-1.0, 1.0);
        for _ in 0..8 {
            let dt = 0.005;
            let (mc, mp, l, g) = (1.0, 0.1, 0.5, 9.81);
            let (s, c) = self.th.sin_cos();
            let inertia = 4.0 / 3.0;
            let tmp = (f + mp * l * self.w * self.w * s) / (mc + mp);
            let wa = (g * s - c * tmp) / (l * (inertia - mp * c * c / (mc + mp)));
            let xa = tmp - mp * l * wa * c / (mc + mp);
            self.v += dt * xa;
            self.x += dt * self.v;
            self.w += dt * wa;
            self.th += dt * self.w;
            if self.x.abs() > 1.8 {
                self.x = self.x.clamp(-1.8, 1.8);
                self.v = 0.0;
            }
        }
        let tol = |x: f64, m: f64| (-(10f64.ln()) * (x / m).powi(2)).exp(); // gaussian 0.1 at margin
        let upright = (self.th.cos() + 1.0) / 2.0;
        let centered = (1.0 + tol(self.x, 2.0)) / 2.0;
        let small = (4.0 + (1.0 - u[0] * u[0]).max(0.0)) / 5.0;
        let vel = (1.0 + tol(self.w, 5.0)) / 2.0;
        (upright * centered * small * vel, self.th.cos())
    }
}
fn task(name: &str, seed: u64) -> Task {
    let pi = std::f64::consts::PI;
    let r = |min, max, wraps| InputRange { min, max, wraps };
    if name.starts_with("arm") {
        let mut c = ArmConfig::default();
        let stops = name.contains("stops");
        if name.contains("rel") {
            c.angles = Angles::Relative;
        }
        if stops {
            c.limits = vec![[-2.0, 2.0]; 4];
        }
        if name.contains("block") {
            c.block = vec![tectum_core::plant::BlockConfig { joint: 3, tick: 1200, angle: 0.0 }];
        }
        let delay = if name.contains("delay1") {
            1
        } else if name.contains("delay2") {
            2
        } else {
            0
        };
        let lag = if name.contains("lag100") {
            1.0 - (-0.5f64).exp()
        } else if name.contains("lag200") {
            1.0 - (-0.25f64).exp()
        } else {
            1.0
        };
        let mut inputs = vec![r(-1.0, 1.0, false); 2];
        inputs.extend(vec![if stops { r(-2.0, 2.0, false) } else { r(-pi, pi, true) }; 4]);
        return Task {
            inputs,
            limits: vec![0.05; 4],
            sigma: vec![0.001; 4],
            window: 80,
            sim: Box::new(ArmSim {
                arm: Arm::new(&c, 0.05, seed),
                n: 6,
                delay,
                queue: vec![],
                lag,
                state: vec![0.0; 4],
            }),
        };
    }
    match name {
        "pendulum" => Task {
            inputs: vec![r(-1.0, 1.0, false), r(-1.0, 1.0, false), r(-8.0, 8.0, false)],
            limits: vec![2.0],
            sigma: vec![0.1],
            window: 40,
            sim: Box::new(Pendulum { th: pi, w: 0.0 }),
        },
        "cartpole" => Task {
            inputs: vec![
                r(-1.8, 1.8, false),
                r(-1.0, 1.0, false),
                r(-1.0, 1.0, false),
                r(-6.0, 6.0, false),
                r(-12.0, 12.0, false),
            ],
            limits: vec![1.0],
            sigma: vec![0.02],
            window: 100,
            sim: Box::new(CartPole { x: 0.0, v: 0.0, th: pi, w: 0.0 }),
        },
        _ => panic!(),
    }
}
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let (name, ticks) = (&args[1], args[2].parse::<u64>().unwrap());
    let (first, seeds) = (args[3].parse::<u64>().unwrap(), args[4].parse::<u64>().unwrap());
    let config: ModelPredictiveConfig = serde_json::from_str(args.get(5).map_or("{}", |s| s)).unwrap();
    let verbose = std::env::var("V").is_ok();
    for seed in first..first + seeds {
        let mut t = task(name, seed);
        let spec = ModelPredictiveSpec {
            inputs: t.inputs.clone(),
            limits: t.limits.clone(),
            sigma: t.sigma.clone(),
            seed,
            config: config.clone(),
        };
        let mut agent = ModelPredictive::new(&spec);
        let (n, m) = (t.inputs.len(), t.limits.len());
        let (mut x, mut u, mut applied) = (vec![0.0; n], vec![0.0; m], vec![0.0; m]);
        let mut reward = 0.0;
        let (mut sum, mut end) = (0.0, 0.0);
        let start = Instant::now();
        let mut worst_ms = 0f64;
        let mut line = String::new();
        for tick in 0..ticks {
            let flags = t.sim.sense(tick, &mut x);
            let at = Instant::now();
            agent.act(&Observed { inputs: &x, reward, applied: &applied, flags }, &mut u);
            applied.copy_from_slice(&u);
            agent.improve();
            worst_ms = worst_ms.max(at.elapsed().as_secs_f64() * 1e3);
            let (r, e) = t.sim.advance(tick, &u);
            reward = r;
            sum += r;
            if tick as usize % t.window >= t.window - 10 {
                end += e / 10.0;
            }
            if (tick as usize + 1) % t.window == 0 {
                line += &format!(" {:.4}({:.3})", sum / t.window as f64, end);
                if verbose {
                    println!("{tick} {:.4} end {end:.3} | {}", sum / t.window as f64, agent.describe());
                }
                sum = 0.0;
                end = 0.0;
            }
        }
        println!(
            "{name} {seed}: {:.1} ms max {worst_ms:.1} {:?}{line}",
            start.elapsed().as_secs_f64() * 1e3 / ticks as f64,
            agent.counts
        );
    }
}
