//! Starts Python programs: the interpreter that `TECTUM_PYTHON` names, scripts of `tests/python`, and the examples and
//! scenarios of `examples/python`.

use std::fs;
use std::path::Path;

use super::{TECTUM, TestFolder};

/// The interpreter.
pub fn python() -> String {
    std::env::var("TECTUM_PYTHON").unwrap_or_else(|_| "python3".to_owned())
}

/// The file name of the interpreter: that of a Python process of a run.
pub fn python_name() -> String {
    Path::new(&python()).file_name().unwrap().to_str().unwrap().to_owned()
}

fn in_package(path: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path).to_str().unwrap().to_owned()
}

/// The path of a script in `tests/python`.
pub fn script(name: &str) -> String {
    in_package(&format!("tests/python/{name}"))
}

/// The path of a file in `examples/python`.
pub fn example(name: &str) -> String {
    in_package(&format!("examples/python/{name}"))
}

/// The folder of the programs under test, for `TECTUM_BIN`.
pub fn programs() -> String {
    Path::new(TECTUM).parent().unwrap().to_str().unwrap().to_owned()
}

/// A scenario of `examples/python` with some texts replaced and `more` appended. Its paths are made absolute, so that
/// it runs in any folder.
#[track_caller]
pub fn scenario(test_folder: &TestFolder, name: &str, changes: &[(&str, &str)], more: &str) -> String {
    let text = fs::read_to_string(example(name)).unwrap();
    let folder = format!("\"{}/", example("").trim_end_matches('/'));
    let mut text = text.replace("\"target/python/bin/python\"", &format!("{:?}", python()));
    text = text.replace("\"examples/python/", &folder);
    for (from, to) in changes {
        assert!(text.contains(from), "{name} has no {from}");
        text = text.replacen(from, to, 1);
    }
    test_folder.write_file("scenario.toml", text + more).to_str().unwrap().to_owned()
}
