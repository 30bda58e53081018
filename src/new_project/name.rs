//! Names that a project may have: they become a package, a program, a folder and a scenario.

use super::NewProjectError;

/// Longest name, in characters.
const LONGEST: usize = 64;

/// Keywords of Rust.
const KEYWORDS: &str = "as async await break const continue crate dyn else enum extern false fn for gen if impl in \
    let loop match mod move mut pub ref return self static struct super trait true type unsafe use where while yield";

/// Crates that the compiler or the project needs, and folders in which cargo puts programs.
const TAKEN: &str = "alloc core proc_macro rand std tectum test build deps examples incremental tmp";

/// Checks that a project may have this name.
pub(super) fn check(name: &str) -> Result<(), NewProjectError> {
    let refuse = |why: &str| Err(NewProjectError::Name { name: name.to_owned(), why: why.to_owned() });
    if name.contains('/') {
        return refuse("give a name without a folder; the project is made in the current folder");
    }
    let valid = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
    if !name.chars().all(valid) || !name.starts_with(|c: char| c.is_ascii_lowercase()) {
        return refuse("give lower-case letters, digits, - and _, with a letter first");
    }
    if name.len() > LONGEST {
        return refuse(&format!("it has {} characters; give at most {LONGEST}", name.len()));
    }
    if KEYWORDS.split(' ').chain(TAKEN.split(' ')).any(|taken| taken == name) || name.starts_with("tectum-") {
        return refuse("Rust, cargo or Tectum use this name; give another one");
    }
    Ok(())
}

/// The name by which Rust code calls the package.
pub(super) fn crate_name(name: &str) -> String {
    name.replace('-', "_")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_packages_pass() {
        for name in ["cart", "my-arm", "arm_2", "a"] {
            assert!(check(name).is_ok(), "{name}");
        }
    }

    #[test]
    fn what_no_package_may_be_called_is_refused_with_the_reason() {
        let long = "a".repeat(65);
        for (name, why) in [
            ("", "letter first"),
            ("Cart", "lower-case"),
            ("2arm", "letter first"),
            ("-arm", "letter first"),
            ("my arm", "lower-case"),
            ("bräu", "lower-case"),
            ("../arm", "without a folder"),
            ("fn", "use this name"),
            ("test", "use this name"),
            ("tectum", "use this name"),
            ("tectum-plant", "use this name"),
            (long.as_str(), "65 characters"),
        ] {
            let error = check(name).unwrap_err().to_string();
            assert!(error.contains(why), "{name}: {error}");
        }
    }
}
