//! The mistakes that an author of a plant or controller in Python may make, and what they see: one sentence with file
//! and line, once, with the right exit code, and no pointless restart. The table of docs/python.md is made from these
//! rows (`TECTUM_BLESS=1` writes it). Ignored by default, because they need a Python with the package `tectum`:
//!
//! ```text
//! TECTUM_PYTHON=path/to/python cargo test --locked --test python_mistakes -- --ignored
//! ```

mod support;

use std::fmt::Write as _;

use support::TestFolder;
use support::python::{python, script};

/// A plant without mistakes. Its lines are counted in the messages.
const PLANT: &str = "\
import tectum
class Body(tectum.Plant):
    def __init__(self, run):
        self.x = 0.0
    def sense(self, tick, inputs):
        inputs[:] = self.x, 0.5
        return tick == 0
    def advance(self, tick, applied):
        self.x += 0.01 * applied[0]
        return -abs(self.x), [abs(self.x)]
tectum.main(Body)
";

/// A controller without mistakes.
const CONTROLLER: &str = "\
import tectum
class Mine(tectum.Controller):
    def __init__(self, run):
        self.n = 0
    def act(self, percept):
        self.n += 1
        return [0.1]
    def learn(self, transition):
        pass
    def state(self):
        return {\"n\": self.n}
    def restore(self, state):
        self.n = state[\"n\"]
tectum.main(Mine)
";

/// The scenario of both.
const SCENARIO: &str = "\
name = \"body\"
ticks = 200
[plant]
program = \"PYTHON\"
args = [\"body.py\"]
measures = [{ name = \"distance\", role = \"error\" }]
inputs = [{ name = \"position\", min = -1, max = 1 }, { name = \"target\", min = -1, max = 1 }]
outputs = [{ name = \"speed\", min = -1, max = 1 }]
[controller]
program = \"PYTHON\"
args = [\"mine.py\"]
[gate]
max_command = 1
";

/// A mistake: in words, the change of a file that makes it, the sentence, and the exit code. `\n` in the change
/// is a line's end. The sentence begins after `the plant ended: ` or `the controller ended: `.
struct Mistake {
    what: &'static str,
    file: &'static str,
    change: (&'static str, &'static str),
    sentence: &'static str,
    code: i32,
}

const fn mistake(
    what: &'static str,
    file: &'static str,
    change: (&'static str, &'static str),
    sentence: &'static str,
    code: i32,
) -> Mistake {
    Mistake { what, file, change, sentence, code }
}

const IN_PLACE: &str = "Body.sense (body.py:5) left all inputs unset, or not a number; it sets them in place: \
                        `inputs[:] = a, b` (`inputs = ..` or `return [..]` sets nothing), at tick 0";

const MISTAKES: [Mistake; 27] = [
    mistake(
        "an exception",
        "body.py",
        ("self.x += 0.01", "self.x += 1 / tick"),
        "ZeroDivisionError: division by zero, at body.py:9, in Body.advance, tick 0; \
         the traceback is in runs/body-1/plant.stderr",
        4,
    ),
    mistake(
        "an exception, later",
        "mine.py",
        ("return [0.1]", "return [[0.1][self.n // 50]]"),
        "IndexError: list index out of range, at mine.py:7, in Mine.act, tick 49; the traceback is in \
         runs/body-1/controller.stderr",
        4,
    ),
    mistake(
        "an exception before the first tick",
        "body.py",
        ("self.x = 0.0", "self.x = {}['a']"),
        "KeyError: 'a', at body.py:4, in Body, before the first tick; the traceback is in runs/body-1/plant.stderr",
        4,
    ),
    mistake(
        "an error of syntax, or a module that is missing",
        "body.py",
        ("import tectum\n", "import tectum, no_such_module\n"),
        "ModuleNotFoundError: No module named 'no_such_module', at body.py:1; \
         the traceback is in plant.stderr in the run's folder",
        4,
    ),
    mistake(
        "a reward that is not a number",
        "body.py",
        ("return -abs(self.x),", "return float('nan'),"),
        "Body.advance (body.py:8) gave nan as reward; it must be finite, at tick 0",
        4,
    ),
    mistake(
        "an input that is not a number",
        "body.py",
        ("self.x, 0.5", "self.x, float('nan')"),
        "Body.sense (body.py:5) left the input `target` unset, or not a finite number, at tick 0",
        4,
    ),
    mistake(
        "an input that is not set",
        "body.py",
        ("inputs[:] = self.x, 0.5", "inputs[0] = self.x"),
        "Body.sense (body.py:5) left the input `target` unset, or not a finite number, at tick 0",
        4,
    ),
    mistake(
        "too many inputs, or too few",
        "body.py",
        ("self.x, 0.5", "self.x, 0.5, 0.7"),
        "Body.sense sets 3 inputs, at body.py:6; the scenario has 2: position, target",
        4,
    ),
    mistake("a list that is bound anew", "body.py", ("inputs[:] =", "inputs ="), IN_PLACE, 4),
    mistake("inputs that are returned", "body.py", ("inputs[:] =", "return"), IN_PLACE, 4),
    mistake(
        "something else than whether a target is new",
        "body.py",
        ("return tick == 0", "return 'new'"),
        "Body.sense (body.py:5) gave 'new'; it returns True when a new target begins, else False, at tick 0",
        4,
    ),
    mistake(
        "a number instead of a pair",
        "body.py",
        ("return -abs(self.x), [abs(self.x)]", "return -1.0"),
        "Body.advance (body.py:8) gave -1.0; it returns a pair: (reward, [distance]), at tick 0",
        4,
    ),
    mistake(
        "a forgotten `return`",
        "body.py",
        ("return -abs(self.x), [abs(self.x)]", "pass"),
        "Body.advance (body.py:8) gave None; it returns a pair: (reward, [distance]), at tick 0",
        4,
    ),
    mistake(
        "a text for a number",
        "body.py",
        ("return -abs(self.x),", "return 'good',"),
        "Body.advance (body.py:8) gave 'good' as reward, which is no number, at tick 0",
        4,
    ),
    mistake(
        "too many measures, or too few",
        "body.py",
        ("[abs(self.x)]", "[1.0, 2.0]"),
        "Body.advance (body.py:8) gave 2 measures; the scenario has 1: distance, at tick 0",
        4,
    ),
    mistake(
        "a method that is missing",
        "body.py",
        ("def advance", "def go_on"),
        "Body (body.py:2) has no method advance(); add it",
        2,
    ),
    mistake(
        "a method with other arguments",
        "body.py",
        ("def sense(self, tick, inputs)", "def sense(self, inputs)"),
        "Body.sense (body.py:5) is sense(inputs); it is called as sense(tick, inputs)",
        2,
    ),
    mistake(
        "a class that does not take the run",
        "body.py",
        ("def __init__(self, run)", "def __init__(self)"),
        "Body is made with one argument, the run: Body.__init__() takes 1 positional argument but 2 were given",
        2,
    ),
    mistake(
        "position limits for a plant that does not tell its joints",
        "scenario.toml",
        ("max_command = 1\n", "max_command = 1\npositions = [[-1, 1]]\n"),
        "Body has no method joints(), so that the gate cannot limit positions; add it, or take positions out of [gate]",
        2,
    ),
    mistake(
        "the scenario of another plant",
        "scenario.toml",
        (
            "{ name = \"target\", min = -1, max = 1 }",
            "{ name = \"target\", min = -1, max = 1 }, { name = \"x\", min = 0, max = 1 }",
        ),
        "Body.sense sets 2 inputs, at body.py:6; the scenario has 3: position, target, x",
        4,
    ),
    mistake(
        "outputs that are not numbers",
        "mine.py",
        ("return [0.1]", "return [float('inf')]"),
        "Mine.act (mine.py:5) gave inf as `speed`; it must be finite, at tick 0",
        4,
    ),
    mistake(
        "too many outputs, or too few",
        "mine.py",
        ("return [0.1]", "return [0.1, 0.2]"),
        "Mine.act (mine.py:5) gave 2 outputs; the scenario has 1: speed, at tick 0",
        4,
    ),
    mistake(
        "no outputs",
        "mine.py",
        ("return [0.1]", "pass"),
        "Mine.act (mine.py:5) gave None as outputs; give a list of 1: speed, at tick 0",
        4,
    ),
    mistake(
        "a state that cannot be kept",
        "mine.py",
        ("{\"n\": self.n}", "{\"n\": self}"),
        "Mine.state (mine.py:10) gave a state in which it['n'] is a Mine; a state holds numbers, texts, bytes, numpy \
         arrays, and lists and dicts of these, at tick 0",
        4,
    ),
    mistake(
        "`state` without `restore`",
        "mine.py",
        ("def restore", "def reset"),
        "Mine has state() and no restore(); give both, or neither",
        2,
    ),
    mistake(
        "iceoryx2 is not installed",
        "missing",
        ("", ""),
        "this Python has no iceoryx2; install it: PYTHON -m pip install iceoryx2==0.10.0",
        2,
    ),
    mistake(
        "iceoryx2 in another version",
        "0.9.1",
        ("", ""),
        "this Python has iceoryx2 0.9.1, and the run needs 0.10.0; install it: PYTHON -m pip install iceoryx2==0.10.0",
        3,
    ),
];

impl Mistake {
    /// Makes the mistake in a run, and requires the sentence, once, the exit code, and no restart.
    fn check(&self) {
        let test_folder = TestFolder::new();
        for (name, text) in [("body.py", PLANT), ("mine.py", CONTROLLER), ("scenario.toml", SCENARIO)] {
            let (from, to) = self.change;
            assert!(name != self.file || text.contains(from), "{}: no {from} in {name}", self.what);
            let text = if name == self.file { text.replacen(from, to, 1) } else { text.to_owned() };
            test_folder.write_file(name, text.replace("PYTHON", &python()));
        }
        let mut command = vec!["/usr/bin/env".to_owned()];
        if !self.file.contains(".py") && !self.file.contains("toml") {
            let hidden = script("hidden");
            command.extend([format!("PYTHONPATH={hidden}"), format!("TECTUM_TEST_ICEORYX2={}", self.file)]);
        }
        command.extend([support::TECTUM, "run", "scenario.toml", "--json"].map(str::to_owned));
        let arguments: Vec<_> = command[1..].iter().map(String::as_str).collect();
        let outcome = test_folder.start(&command[0], &arguments).wait().expect(self.code);
        let folder = test_folder.path().to_str().unwrap();
        let said = outcome.stderr.replace(&format!("{folder}/"), "");
        let (_, said) = said.trim_end().split_once(" ended: ").unwrap_or_else(|| panic!("{}: {outcome:#?}", self.what));
        let interpreter = python();
        let expected = self.sentence.replace("PYTHON", &interpreter);
        assert_eq!(said, expected, "{}: {outcome:#?}", self.what);
        if let Some((_, file)) = expected.split_once("the traceback is in runs/body-1/") {
            let path = test_folder.path().join("runs/body-1").join(file);
            let traceback = std::fs::read_to_string(path).unwrap();
            assert!(traceback.contains("Traceback (most recent call last)"), "{traceback}");
        }
        if !outcome.stdout.is_empty() {
            assert_eq!(outcome.json()["restarts"], serde_json::json!([]), "{}", self.what);
        }
    }
}

#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn each_mistake_is_one_clear_sentence() {
    MISTAKES.iter().for_each(Mistake::check);
}

/// The table of docs/python.md.
#[test]
fn the_page_lists_every_mistake() {
    let mut table = "| mistake | what the author sees | exit code |\n|---|---|---|\n".to_owned();
    for Mistake { what, sentence, code, .. } in &MISTAKES {
        let sentence = sentence.replace("PYTHON", "python").replace('|', "\\|");
        let _ = writeln!(table, "| {what} | {sentence} | {code} |");
    }
    let path = "docs/python.md";
    let text = std::fs::read_to_string(path).unwrap();
    let (open, close) = ("<!-- mistakes -->\n\n", "\n<!-- end of mistakes -->\n");
    let (head, rest) = text.split_once(open).unwrap();
    let (_, tail) = rest.split_once(close).unwrap();
    support::snapshot::assert_snapshot(path, &format!("{head}{open}{table}{close}{tail}"));
}

/// A plant without mistakes runs, and of one whose inputs leave their range the summary says so.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn inputs_outside_their_range_are_counted_and_said() {
    for (inputs, warnings) in [
        ("self.x, 0.01 * (tick % 50)", vec![]),
        ("self.x, 0.01 * (tick % 50) + tick // 190", vec![("input-outside-range", "target", 10)]),
    ] {
        let test_folder = TestFolder::new();
        test_folder.write_file("body.py", PLANT.replace("self.x, 0.5", inputs));
        test_folder.write_file("mine.py", CONTROLLER);
        test_folder.write_file("scenario.toml", SCENARIO.replace("PYTHON", &python()));
        let summary = test_folder.run(&["scenario.toml", "--json"]).wait().expect(0).json();
        let found: Vec<_> = summary["warnings"].as_array().unwrap().iter().collect();
        assert_eq!(found.len(), warnings.len(), "{summary}");
        for (found, (name, signal, count)) in found.into_iter().zip(warnings) {
            assert_eq!((&found["name"], &found["signal"]), (&name.into(), &signal.into()), "{summary}");
            assert_eq!(found["count"], count, "{summary}");
        }
    }
}

/// A program that no launcher started says how it is started.
#[test]
#[ignore = "needs a Python with the packages of examples/python/requirements.txt, named by TECTUM_PYTHON"]
fn a_program_that_no_launcher_started_says_how() {
    let test_folder = TestFolder::new();
    test_folder.write_file("body.py", PLANT);
    let outcome = test_folder.start(python(), &["body.py"]).wait().expect(2);
    assert_eq!(
        outcome.stderr.trim(),
        "body.py: is one process of a run and was given none; start the run: `tectum run SCENARIO`, where body.py \
         stands under [plant] or [controller], or join one with --run RUN (--by-hand)"
    );
}
