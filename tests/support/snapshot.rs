//! Comparison of a text with a file of the repository.

/// Requires that the file at `path` has this text. With `TECTUM_BLESS` in the environment, writes the file first.
#[track_caller]
pub fn assert_snapshot(path: &str, text: &str) {
    if std::env::var_os("TECTUM_BLESS").is_some() {
        std::fs::write(path, text).unwrap();
    }
    let kept = std::fs::read_to_string(path).unwrap_or_default();
    let changed: Vec<_> = text.lines().zip(kept.lines().chain(std::iter::repeat(""))).filter(|(a, b)| a != b).collect();
    assert!(kept == text, "{path} differs; TECTUM_BLESS=1 writes it anew: {changed:#?}");
}
