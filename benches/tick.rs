//! The cost of a tick on the controller's side, with criterion: the paper's rule by itself in every version and
//! by size, the part that the command waits for, the part after the command, and the whole tick of plant and
//! controller in one process. The scenarios `arm` and `eye` use the learned-reward rule, whose tick costs a
//! thousand times more. The cases are those of `tectum bench learner`.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use tectum::scenario::{Plan, Scenario};
use tectum::simd::SimdPath;
use tectum::timing::{ControlLoop, rule_growth, rule_versions};

fn plan(name: &str) -> Plan {
    Scenario::find(name).unwrap().plan().unwrap()
}

fn versions(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("learn and answer/4 x 320");
    for mut case in rule_versions() {
        let (_, version) = case.key.clone();
        group.bench_function(version, |b| b.iter_custom(|calls| case.time(calls)));
    }
    group.finish();
}

fn growth(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("learn and answer");
    let sizes = [4, 8].into_iter().flat_map(|outputs| (5..=15).step_by(2).map(move |power| (outputs, power)));
    for mut case in sizes.flat_map(|(outputs, power)| rule_growth(outputs, power)) {
        let key = case.key.clone();
        let size = format!("{} x {}", key.outputs, key.features);
        group.throughput(Throughput::Elements(key.features * key.outputs));
        group.bench_function(BenchmarkId::new(key.path.to_string(), size), |b| {
            b.iter_custom(|calls| case.time(calls));
        });
    }
    group.finish();
}

fn controller(criterion: &mut Criterion) {
    let plan = plan("paper");
    let mut group = criterion.benchmark_group("controller/arm320");
    for path in SimdPath::all() {
        let mut control_loop = ControlLoop::new(&plan, path).unwrap();
        group.bench_function(format!("learn, encode, act, {path}"), |b| b.iter(|| control_loop.respond()));
        group.bench_function(format!("statistics and learning record, {path}"), |b| {
            b.iter(|| control_loop.after_command());
        });
    }
    group.finish();
}

fn in_process(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("in process/tick of plant and controller");
    let paper = SimdPath::all().map(|path| ("paper", path));
    for (name, path) in paper.chain([("arm", SimdPath::best()), ("eye", SimdPath::best())]) {
        let mut control_loop = ControlLoop::new(&plan(name), path).unwrap();
        group.bench_function(format!("{name}, {path}"), |b| b.iter(|| control_loop.step()));
    }
    group.finish();
}

criterion_group!(benches, versions, growth, controller, in_process);
criterion_main!(benches);
