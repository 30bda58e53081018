//! The documentation for other languages matches the Rust processes. The texts of `docs/tectum.h` and of the tables in
//! `docs/wire.md` are made from the field tables of the samples and compared with the files. To write the files anew:
//! `TECTUM_BLESS=1 cargo test --test wire`.

#[path = "support/snapshot.rs"]
mod snapshot;

use std::fmt::Write as _;
use std::path::Path;
use std::process::Command as Process;

use snapshot::assert_snapshot;
use tectum::wire::{
    Ahead, Command, Control, Gap, Header, Learning, MAX_AHEAD, MAX_COLUMNS, MAX_INPUTS, MAX_MEASURES, MAX_OUTPUTS,
    Observation, Phase, ProcessState, Role, Sample, Status, Vision, flag::FLAGS, schema_hash,
};

/// The parts of a sample that a table shows.
struct Layout {
    name: &'static str,
    doc: String,
    size: usize,
    /// C type of one element, name, count, offset, meaning.
    fields: Vec<(&'static str, &'static str, usize, usize, String)>,
}

impl Layout {
    fn of<S: Sample>() -> Self {
        let c = |element| match element {
            "uint32" => "uint32_t",
            "uint64" => "uint64_t",
            "float32" => "float",
            "tectum/Header" => "tectum_header",
            other => panic!("{other} has no C type"),
        };
        let fields = S::FIELDS.iter().map(|f| (c(f.element), f.name, f.count, f.offset, plain(f.doc))).collect();
        Self { name: S::NAME, doc: plain(S::DOC), size: size_of::<S>(), fields }
    }

    /// `tectum_observation` of `tectum.Observation.v1`.
    fn c_name(&self) -> String {
        let name = self.name.split('.').nth(1).unwrap();
        format!("tectum_{}", name.to_lowercase())
    }
}

/// Removes the links of rustdoc.
fn plain(doc: &str) -> String {
    doc.trim().replace("[`", "`").replace("`]", "`").replace("Phase::", "")
}

fn layouts() -> Vec<Layout> {
    vec![
        Layout::of::<Header>(),
        Layout::of::<Observation>(),
        Layout::of::<Command>(),
        Layout::of::<Ahead>(),
        Layout::of::<Learning>(),
        Layout::of::<Vision>(),
        Layout::of::<Control>(),
        Layout::of::<Status>(),
        Layout::of::<Gap>(),
    ]
}

/// Name, bit and meaning of every flag.
fn flags() -> Vec<(String, u32, String)> {
    FLAGS.iter().map(|flag| (flag.name.to_owned(), flag.bit.trailing_zeros(), plain(flag.doc))).collect()
}

fn phases() -> [(&'static str, u32); 5] {
    [Phase::SetUp, Phase::Connect, Phase::Run, Phase::Stop, Phase::Abort].map(|phase| {
        let name = match phase {
            Phase::SetUp => "SET_UP",
            Phase::Connect => "CONNECT",
            Phase::Run => "RUN",
            Phase::Stop => "STOP",
            Phase::Abort => "ABORT",
        };
        (name, phase as u32)
    })
}

fn states() -> [(&'static str, u32); 7] {
    [
        ProcessState::Absent,
        ProcessState::Ready,
        ProcessState::Connected,
        ProcessState::Running,
        ProcessState::Finished,
        ProcessState::Failed,
        ProcessState::Closing,
    ]
    .map(|state| {
        let name = match state {
            ProcessState::Absent => "ABSENT",
            ProcessState::Ready => "READY",
            ProcessState::Connected => "CONNECTED",
            ProcessState::Running => "RUNNING",
            ProcessState::Finished => "FINISHED",
            ProcessState::Failed => "FAILED",
            ProcessState::Closing => "CLOSING",
        };
        (name, state as u32)
    })
}

const HEAD: &str = "\
/* Samples and boards of a Tectum run, for C and C++. docs/wire.md describes their use.
 *
 * Made from the field tables of the Rust processes by tests/wire.rs; do not edit. Little endian, IEEE 754, no
 * padding. The constants that begin with TECTUM_TYPE_ are the payloads' type names, which iceoryx2 compares. */
#ifndef TECTUM_H
#define TECTUM_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
#define TECTUM_ASSERT(what) static_assert(what, #what)
#else
#define TECTUM_ASSERT(what) _Static_assert(what, #what)
#endif

";

fn comment(text: &mut String, indent: &str, doc: &str) {
    let mut line = format!("{indent}/*");
    for word in doc.split_whitespace() {
        // The last line also needs room for the closing mark.
        if line.len() + 1 + word.len() + " */".len() > 120 {
            let _ = writeln!(text, "{line}");
            line = format!("{indent} *");
        }
        let _ = write!(line, " {word}");
    }
    let _ = writeln!(text, "{line} */");
}

fn header() -> String {
    let mut text = HEAD.to_owned();
    for (name, value) in [
        ("INPUTS", MAX_INPUTS),
        ("OUTPUTS", MAX_OUTPUTS),
        ("MEASURES", MAX_MEASURES),
        ("COLUMNS", MAX_COLUMNS),
        ("AHEAD", MAX_AHEAD),
    ] {
        let _ = writeln!(text, "#define TECTUM_MAX_{name} {value}");
    }
    for layout in layouts() {
        let c = layout.c_name();
        text.push('\n');
        comment(&mut text, "", &layout.doc);
        let _ = writeln!(text, "typedef struct {c} {{");
        for (kind, name, count, _, doc) in &layout.fields {
            comment(&mut text, "    ", doc);
            let many = if *count == 1 { String::new() } else { format!("[{count}]") };
            let _ = writeln!(text, "    {kind} {name}{many};");
        }
        let _ = writeln!(text, "}} {c};\n#define TECTUM_TYPE_{} \"{}\"", c[7..].to_uppercase(), layout.name);
        let _ = writeln!(text, "TECTUM_ASSERT(sizeof({c}) == {});", layout.size);
        for (_, name, _, offset, _) in &layout.fields {
            let _ = writeln!(text, "TECTUM_ASSERT(offsetof({c}, {name}) == {offset});");
        }
    }
    text.push_str("\n/* Bits of a header's flags. */\nenum tectum_flag {\n");
    for (name, bit, doc) in flags() {
        comment(&mut text, "    ", &doc);
        let _ = writeln!(text, "    TECTUM_{name} = 1 << {bit},");
    }
    text.push_str("};\n\n/* Phases of a run, in order; a number beyond them reads as ABORT. */\nenum tectum_phase {\n");
    for (name, value) in phases() {
        let _ = writeln!(text, "    TECTUM_PHASE_{name} = {value},");
    }
    text.push_str(
        "};\n\n/* States of a process, in order; a number beyond them reads as FAILED. */\nenum tectum_state {\n",
    );
    for (name, value) in states() {
        let _ = writeln!(text, "    TECTUM_STATE_{name} = {value},");
    }
    text.push_str("};\n\n/* Places in `incarnations`. */\nenum tectum_role {\n");
    for role in Role::ALL {
        let _ = writeln!(text, "    TECTUM_ROLE_{} = {},", role.name().to_uppercase(), role as u32);
    }
    text.push_str("};\n\n#endif\n");
    text
}

/// The tables of `docs/wire.md`, each with the name of its mark in the page.
fn tables() -> Vec<(&'static str, String)> {
    let mut samples = String::new();
    for layout in layouts() {
        let _ = writeln!(samples, "\n**`{}`**, {} bytes. {}\n", layout.name, layout.size, layout.doc);
        samples.push_str("| offset | field | type | meaning |\n|---|---|---|---|\n");
        for (kind, name, count, offset, doc) in &layout.fields {
            let kind = match *kind {
                "uint32_t" => "u32",
                "uint64_t" => "u64",
                "float" => "f32",
                _ => "Header",
            };
            let many = if *count == 1 { String::new() } else { format!(" x {count}") };
            let _ = writeln!(samples, "| {offset} | `{name}` | {kind}{many} | {doc} |");
        }
    }
    samples.push('\n');
    let mut bits = "\n| bit | flag | meaning |\n|---|---|---|\n".to_owned();
    for (name, bit, doc) in flags() {
        let _ = writeln!(bits, "| {bit} | `{name}` | {doc} |");
    }
    bits.push('\n');
    let list = |pairs: &[(&str, u32)]| {
        let text: Vec<_> = pairs.iter().map(|(name, value)| format!("{value} `{name}`")).collect();
        format!("\n{}\n\n", text.join(", "))
    };
    vec![("samples", samples), ("flags", bits), ("phases", list(&phases())), ("states", list(&states()))]
}

#[test]
fn the_c_header_matches_the_rust_layout() {
    assert_snapshot("docs/tectum.h", &header());
}

#[test]
fn the_wire_tables_match_the_rust_layout() {
    let path = "docs/wire.md";
    let mut text = std::fs::read_to_string(path).unwrap();
    for (name, table) in tables() {
        let (open, close) = (format!("<!-- {name} -->\n"), format!("<!-- end of {name} -->\n"));
        let (head, rest) = text.split_once(&open).unwrap_or_else(|| panic!("{path} has no mark {open}"));
        let (_, tail) = rest.split_once(&close).unwrap_or_else(|| panic!("{path} has no mark {close}"));
        text = format!("{head}{open}{table}{close}{tail}");
    }
    assert_snapshot(path, &text);
}

/// Flags and schema of the Python package, and its names of phases, states and roles. What lies where is compared by
/// `tests/python.rs`, which needs a Python.
#[test]
fn the_python_package_has_the_rust_flags() {
    let path = "python/src/tectum/layouts.py";
    let text = std::fs::read_to_string(path).unwrap();
    let (head, rest) = text.split_once("class Flag(IntFlag):\n").unwrap();
    let (doc, rest) = rest.split_once("\n\n").unwrap();
    let (_, tail) = rest.split_once("\n\n\n").unwrap();
    let (before, after) = head.split_once("SCHEMA = \"").unwrap();
    let (_, after) = after.split_once('"').unwrap();
    let bits: Vec<_> = flags().iter().map(|(name, bit, _)| format!("    {name} = 1 << {bit}")).collect();
    let head = format!("{before}SCHEMA = \"{:016x}\"{after}", schema_hash());
    let text = format!("{head}class Flag(IntFlag):\n{doc}\n\n{}\n\n\n{tail}", bits.join("\n"));
    for (class, names) in [("Phase", phases().map(|p| p.0).join(", ")), ("State", states().map(|s| s.0).join(", "))] {
        let (_, of_class) = text.split_once(&format!("class {class}(IntEnum):")).unwrap();
        assert!(of_class.lines().nth(3).unwrap().contains(&format!("{names} = range(")), "{class} is {names}");
    }
    assert_snapshot(path, &text);
}

/// The header's assertions of sizes and offsets hold in C and in C++. A missing compiler is skipped.
#[test]
fn c_and_cpp_compilers_confirm_sizes_and_offsets() {
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/tectum.h");
    for (compiler, name, language) in [("cc", "check.c", "-std=c11"), ("c++", "check.cpp", "-std=c++17")] {
        if Process::new(compiler).arg("--version").output().is_err() {
            println!("skipped: there is no {compiler} here to compile docs/tectum.h with");
            continue;
        }
        let check = |text: &str| {
            let source = folder.path().join(name);
            std::fs::write(&source, text).unwrap();
            let strict = [language, "-Wall", "-Wextra", "-Werror", "-fsyntax-only"];
            Process::new(compiler).args(strict).arg(&source).output().unwrap()
        };
        let good = format!("#include \"{}\"\nint main(void) {{ return 0; }}\n", path.display());
        let output = check(&good);
        assert!(output.status.success(), "{compiler}: {}", String::from_utf8_lossy(&output.stderr));
        // The assertions do fail for a wrong size.
        let wrong = check(&format!("{good}TECTUM_ASSERT(sizeof(tectum_observation) == 180);\n"));
        assert!(!wrong.status.success(), "{compiler} accepted a wrong size");
    }
}
