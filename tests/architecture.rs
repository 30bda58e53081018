//! Holds the layout that ARCHITECTURE.md states: which module may use which, which crate needs what, and the form of
//! the files.
//!
//! The table of modules lists them from the bottom up. A module may use only modules that stand above its own row (so
//! there is no circle), only those that its row names, and its row names no module that it does not use.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Widest line, in characters.
const COLUMNS: usize = 120;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// All files below `folder` with one of these endings, in order.
fn files(folder: &Path, endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display())) {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                if !matches!(name.as_str(), "target" | "runs" | ".git" | "corpus" | "artifacts" | "__pycache__") {
                    folders.push(path);
                }
            } else if endings.iter().any(|ending| name.ends_with(ending)) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// The rows of the table in ARCHITECTURE.md whose head begins with `first`: name, and the names in its second cell.
fn table(first: &str) -> Vec<(String, BTreeSet<String>)> {
    let text = fs::read_to_string(root().join("ARCHITECTURE.md")).unwrap();
    let rows = text.lines().skip_while(|line| !line.starts_with(&format!("| {first} |"))).skip(2);
    let rows: Vec<_> = rows
        .take_while(|line| line.starts_with('|'))
        .map(|line| {
            let cells: Vec<&str> = line.split('|').map(str::trim).collect();
            let names = |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>();
            (names(cells[1])[0].clone(), names(cells[2]).into_iter().collect())
        })
        .collect();
    assert!(!rows.is_empty(), "ARCHITECTURE.md has no table that begins with | {first} |");
    rows
}

/// A file's code without comments and without its test modules.
fn code(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap();
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
    let mut code = String::new();
    let mut i = 0;
    while i < lines.len() {
        // An inline test module ends with the brace that stands as far to the left as its first line.
        if lines[i].trim() == "#[cfg(test)]" && lines.get(i + 1).is_some_and(|line| line.trim_end().ends_with('{')) {
            let indent = lines[i].len() - lines[i].trim_start().len();
            i += 2;
            while i < lines.len() && lines[i] != format!("{}}}", " ".repeat(indent)) {
                i += 1;
            }
        } else {
            code.push_str(lines[i]);
            code.push('\n');
        }
        i += 1;
    }
    code
}

/// The names that follow `crate::` in `code`, those in `use crate::{a, b}` included.
fn used(code: &str) -> BTreeSet<String> {
    let word = |text: &str| text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    let mut names = BTreeSet::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        if code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_') {
            continue;
        }
        match rest.strip_prefix('{') {
            Some(list) => names.extend(list.split('}').next().unwrap_or("").split(',').map(|item| word(item.trim()))),
            None => drop(names.insert(word(rest))),
        }
    }
    names
}

/// The folders that hold modules: the lower ones are the crate `tectum-runtime`.
const MODULES: [&str; 2] = ["crates/tectum-runtime/src", "src"];

/// What each module under [`MODULES`] uses of the others.
fn arrows(modules: &BTreeSet<String>) -> BTreeMap<String, BTreeSet<String>> {
    let mut arrows: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    let sources = MODULES.map(|folder| root().join(folder));
    for (src, file) in sources.iter().flat_map(|src| files(src, &[".rs"]).into_iter().map(move |file| (src, file))) {
        let inside = file.strip_prefix(src).unwrap();
        let module = inside.components().next().unwrap().as_os_str().to_string_lossy().replace(".rs", "");
        let tests = file.file_name().unwrap().to_string_lossy().ends_with("tests.rs");
        if matches!(module.as_str(), "lib" | "build") || tests {
            continue;
        }
        let mut uses = used(&code(&file));
        uses.retain(|name| *name != module && modules.contains(name));
        arrows.entry(module).or_default().extend(uses);
    }
    arrows
}

#[test]
fn modules_use_exactly_what_the_table_lists() {
    let table = table("module");
    let modules: BTreeSet<String> = table.iter().map(|(module, _)| module.clone()).collect();
    let arrows = arrows(&modules);
    let mut wrong = Vec::new();
    for module in arrows.keys().filter(|module| !modules.contains(*module)) {
        wrong.push(format!("the module {module} is not in the table"));
    }
    for (i, (module, allowed)) in table.iter().enumerate() {
        let Some(uses) = arrows.get(module) else {
            wrong.push(format!("the table has {module}, and src has not"));
            continue;
        };
        wrong.extend(
            uses.difference(allowed).map(|other| format!("{module} uses {other}, which its row does not name")),
        );
        wrong.extend(
            allowed.difference(uses).map(|other| format!("{module} does not use {other}, which its row names")),
        );
        let below: BTreeSet<String> = table[..i].iter().map(|(module, _)| module.clone()).collect();
        wrong.extend(allowed.difference(&below).map(|other| format!("{module} stands above {other} in the table")));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn crates_need_exactly_what_the_table_lists() {
    for (name, allowed) in table("crate") {
        let path = root().join("crates").join(&name).join("Cargo.toml");
        let manifest: toml::Table = fs::read_to_string(&path).unwrap().parse().unwrap();
        let needs: BTreeSet<String> =
            manifest["dependencies"].as_table().unwrap().iter().map(|(name, _)| name.clone()).collect();
        assert_eq!(needs, allowed, "{}", path.display());
    }
}

#[test]
fn no_line_exceeds_the_limit() {
    let mut wide = Vec::new();
    let mut all = vec![root().join("Cargo.toml")];
    for folder in ["src", "bins", "crates", "tests", "benches", "examples", "scenarios"] {
        all.extend(files(&root().join(folder), &[".rs", ".py", ".toml"]));
    }
    for file in all {
        let text = fs::read_to_string(&file).unwrap();
        let lines = text.lines().enumerate().filter(|(_, line)| line.chars().count() > COLUMNS);
        wide.extend(lines.map(|(i, line)| format!("{}:{}: {}", file.display(), i + 1, line.chars().count())));
    }
    assert!(wide.is_empty(), "lines of more than {COLUMNS} characters:\n{}", wide.join("\n"));
}

/// The public and crate-wide types of a folder by name, and where each is defined.
fn types(folder: &Path) -> BTreeMap<String, Vec<String>> {
    let mut types: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for file in files(folder, &[".rs"]) {
        for line in code(&file).lines() {
            let Some(rest) = line.trim_start().strip_prefix("pub") else { continue };
            let rest = match rest.strip_prefix('(') {
                Some(rest) => rest.split_once(')').map_or("", |(_, rest)| rest),
                None => rest,
            };
            let mut words = rest.split_whitespace();
            if !matches!(words.next(), Some("struct" | "enum" | "trait" | "type" | "union")) {
                continue;
            }
            let name: String = words.next().unwrap_or("").chars().take_while(|c| c.is_alphanumeric()).collect();
            types.entry(name).or_default().push(file.display().to_string());
        }
    }
    types
}

#[test]
fn no_two_types_share_a_name() {
    let mut all = types(&root().join("src"));
    for (name, places) in types(&root().join("crates")) {
        all.entry(name).or_default().extend(places);
    }
    let shared: Vec<_> = all.iter().filter(|(_, places)| places.len() > 1).collect();
    assert!(shared.is_empty(), "{shared:#?}");
}

/// Every function in `text` that has a body: its first line, its name, and its number of lines.
fn functions(text: &str) -> Vec<(usize, String, usize)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    for (i, line) in lines.iter().enumerate() {
        let start = line.trim_start();
        let indent = line.len() - start.len();
        let Some(at) = start.find("fn ") else { continue };
        let qualifiers = start[..at].split_whitespace().all(|word| {
            matches!(word, "const" | "unsafe" | "async" | "extern") || word.starts_with("pub") || word.ends_with(')')
        });
        if start.starts_with("//") || !qualifiers {
            continue;
        }
        let close = format!("{}}}", " ".repeat(indent));
        let end = lines[i..].iter().position(|line| *line == close || line.trim_end().ends_with(';'));
        let name = start[at + 3..].chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
        if let Some(length) = end.filter(|&end| lines[i + end] == close) {
            found.push((i + 1, name, length + 1));
        } else if let Some(length) = lines[i..].iter().position(|line| *line == close) {
            found.push((i + 1, name, length + 1));
        }
    }
    found
}

/// Longest function, in lines.
const LONGEST: usize = 60;

#[test]
fn functions_stay_below_the_limit() {
    let mut long = Vec::new();
    for folder in ["src", "bins", "crates"] {
        for file in files(&root().join(folder), &[".rs"]) {
            if file.to_string_lossy().contains("tests") {
                continue;
            }
            for (line, name, length) in functions(&code(&file)) {
                if length > LONGEST {
                    long.push(format!("{} (about line {line}): {name} has {length} lines", file.display()));
                }
            }
        }
    }
    assert!(long.is_empty(), "functions of more than {LONGEST} lines:\n{}", long.join("\n"));
}
