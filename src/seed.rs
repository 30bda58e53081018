//! Random streams: every stream's seed derives from (scenario seed, stream name), so that adding a stream, or drawing
//! more from one, never shifts another.

use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use xxhash_rust::xxh3::xxh3_64_with_seed;

/// The generator of all random streams.
pub type Rng = Xoshiro256PlusPlus;

/// The stream `name` of the run with `seed`.
pub fn stream(seed: u64, name: &str) -> Rng {
    Rng::seed_from_u64(xxh3_64_with_seed(name.as_bytes(), seed))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;

    #[test]
    fn streams_are_reproducible_and_distinct() {
        let draw = |seed, name| stream(seed, name).next_u64();
        assert_eq!(draw(7, "targets"), draw(7, "targets"));
        assert_ne!(draw(7, "targets"), draw(7, "exploration"));
        assert_ne!(draw(7, "targets"), draw(8, "targets"));
    }
}
