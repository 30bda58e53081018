//! The cost of encoding, with criterion: the arm's 320 features by every version and on every SIMD path, and
//! how the cost grows with the number of units along a line and on a plane. The cases are those of `tectum
//! bench encoder`.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use tectum::timing::InputRing;

fn versions(criterion: &mut Criterion) {
    let ring = InputRing::default();
    let mut group = criterion.benchmark_group("encode/arm320");
    for mut case in ring.versions().unwrap() {
        let (_, version) = case.key.clone();
        group.bench_function(version, |b| b.iter_custom(|calls| case.time(calls)));
    }
    group.finish();
}

/// Lines and planes of 32 to 32,768 units.
fn growth(criterion: &mut Criterion) {
    let ring = InputRing::default();
    for what in ["encode a line", "encode a plane"] {
        let mut group = criterion.benchmark_group(what);
        let cases = (5..=15).step_by(2).flat_map(|power| ring.growth(power));
        for mut case in cases.filter(|case| case.key.what == what) {
            let (path, features) = (case.key.path.to_string(), case.key.features);
            group.throughput(Throughput::Elements(features));
            group.bench_function(BenchmarkId::new(path, features), |b| b.iter_custom(|calls| case.time(calls)));
        }
        group.finish();
    }
}

criterion_group!(benches, versions, growth);
criterion_main!(benches);
