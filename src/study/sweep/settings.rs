//! The settings of a sweep: `KEY=VALUE,VALUE,...`, and a scenario for each combination of values.

use std::str::FromStr;

use toml::{Table, Value};

use super::Sweep;
use crate::scenario::{Plan, Scenario};
use crate::study::StudyError;
use crate::study::compare::without_line;

/// Most combinations of a sweep.
const MOST: usize = 10_000;

/// A key of a scenario with the values that it is to have.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SweepSetting {
    /// The key, such as `learner.beta` or `encoder.maps.0.radius`.
    pub key: String,
    /// The values in TOML. A word need not be in quotes.
    pub values: Vec<String>,
}

impl FromStr for SweepSetting {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let form = "write KEY=VALUE,VALUE,..., such as learner.beta=0.5,0.9";
        let (key, values) = text.split_once('=').ok_or(form)?;
        let values: Vec<String> = split(values).into_iter().map(|value| value.trim().to_owned()).collect();
        let fine = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
        let key = key.trim();
        if key.is_empty() || !key.chars().all(fine) || values.iter().any(String::is_empty) {
            return Err(form.to_owned());
        }
        Ok(Self { key: key.to_owned(), values })
    }
}

impl SweepSetting {
    /// As on the command line.
    pub(super) fn text(&self) -> String {
        format!("{}={}", self.key, self.values.join(","))
    }
}

/// The parts between commas that stand in no list, table or quotes.
fn split(text: &str) -> Vec<&str> {
    let (mut parts, mut begin, mut depth, mut quote) = (Vec::new(), 0, 0_i32, None);
    for (at, c) in text.char_indices() {
        match (quote, c) {
            (Some(open), c) if c == open => quote = None,
            (Some(_), _) => {}
            (None, '"' | '\'') => quote = Some(c),
            (None, '[' | '{') => depth += 1,
            (None, ']' | '}') => depth -= 1,
            (None, ',') if depth == 0 => {
                parts.push(&text[begin..at]);
                begin = at + 1;
            }
            _ => {}
        }
    }
    parts.push(&text[begin..]);
    parts
}

/// A combination of values.
#[derive(Debug)]
pub(super) struct Combination {
    /// `learner.beta=0.5 policy.sigma=0.003`; empty without settings.
    pub name: String,
    /// Key and value of each setting.
    pub values: Vec<(String, String)>,
    /// The scenario with them.
    pub plan: Plan,
}

/// All combinations, the last setting changing fastest.
pub(super) fn combinations(sweep: &Sweep) -> Result<Vec<Combination>, StudyError> {
    let count = sweep.settings.iter().try_fold(1_usize, |n, one| n.checked_mul(one.values.len()));
    if count.is_none_or(|count| count > MOST) {
        return Err(StudyError::Asked(format!("--set makes more than {MOST} combinations; give fewer values")));
    }
    let mut all: Vec<Vec<(String, String)>> = vec![Vec::new()];
    for (i, SweepSetting { key, values }) in sweep.settings.iter().enumerate() {
        if sweep.settings[..i].iter().any(|before| before.key == *key) || key == "seed" {
            let why = if key == "seed" { "give --seeds" } else { "give all its values at once" };
            return Err(StudyError::Asked(format!("--set {key}: {why}")));
        }
        let with = |before: &Vec<(String, String)>, value: &String| {
            before.iter().cloned().chain([(key.clone(), value.clone())]).collect()
        };
        all = all.iter().flat_map(|before| values.iter().map(move |value| with(before, value))).collect();
    }
    let plan = |values: Vec<(String, String)>| {
        let name = values.iter().map(|(key, value)| format!("{key}={value}")).collect::<Vec<_>>().join(" ");
        Ok(Combination { plan: plan_of(sweep, &values, &name)?, name, values })
    };
    all.into_iter().map(plan).collect()
}

/// The scenario with these values.
fn plan_of(sweep: &Sweep, values: &[(String, String)], name: &str) -> Result<Plan, StudyError> {
    let source = &sweep.scenario.source;
    // The file as it stands: what it leaves out is a default, which may depend on what is set.
    let written =
        if source.text().is_empty() { sweep.scenario.text().unwrap_or_default() } else { source.text().into() };
    let mut file: Table = toml::from_str(&written).unwrap_or_default();
    for (key, value) in values {
        let value = value_of(value);
        set(&mut file, key, value).map_err(|why| StudyError::Asked(format!("--set {key}: {why}")))?;
    }
    if let Some(ticks) = sweep.ticks {
        file.insert("ticks".to_owned(), Value::Integer(i64::try_from(ticks).unwrap_or(i64::MAX)));
    }
    let text = toml::to_string(&file).unwrap_or_default();
    let whose = if name.is_empty() { source.name() } else { name };
    let scenario = Scenario::parse(&text, source.name()).map_err(|error| without_line(error, whose))?;
    let plan = scenario.plan().map_err(|error| without_line(error, whose))?;
    let plan = plan.with_origin(source.name(), source.folder());
    if plan.scenario.is_endless() {
        return Err(StudyError::Asked("the scenario is endless, and a sweep is not; give --ticks".to_owned()));
    }
    if plan.scenario.plant.servos.is_some() {
        return Err(StudyError::Asked("a plant on servos runs in real time, and a sweep does not".to_owned()));
    }
    Ok(plan)
}

/// A value in TOML; what is none is a word.
fn value_of(text: &str) -> Value {
    let parsed: Result<Table, _> = toml::from_str(&format!("value = {text}"));
    let value = parsed.ok().filter(|table| table.len() == 1).and_then(|mut table| table.remove("value"));
    value.unwrap_or_else(|| Value::String(text.to_owned()))
}

/// Sets a key such as `gate.max_command`. Tables that are missing on the way are made; in a list, a number selects the
/// entry, from 0.
fn set(file: &mut Table, key: &str, value: Value) -> Result<(), String> {
    let mut steps = key.split('.').peekable();
    let first = steps.next().unwrap_or_default();
    let mut at = file.entry(first).or_insert_with(|| Value::Table(Table::new()));
    for step in steps {
        at = match at {
            Value::Table(table) => table.entry(step).or_insert_with(|| Value::Table(Table::new())),
            Value::Array(list) => {
                let count = list.len();
                let entry = step.parse().ok().and_then(|i: usize| list.get_mut(i));
                entry.ok_or_else(|| format!("{step:?} is no entry of a list of {count}; they count from 0"))?
            }
            _ => return Err(format!("{step:?} stands in a value that is no table")),
        };
    }
    *at = value;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setting(text: &str) -> SweepSetting {
        text.parse().unwrap()
    }

    #[test]
    fn values_are_separated_by_commas_outside_of_lists() {
        assert_eq!(setting("learner.beta=0.5, 0.9").values, ["0.5", "0.9"]);
        assert_eq!(setting("plant.arm.lengths=[1, 0.5],[1,1]").values, ["[1, 0.5]", "[1,1]"]);
        assert_eq!(setting("name='a,b',c").values, ["'a,b'", "c"]);
        for text in ["learner.beta", "=3", "a b=3", "learner.beta=", "learner.beta=1,,2"] {
            assert!(text.parse::<SweepSetting>().unwrap_err().contains("write KEY=VALUE"), "{text}");
        }
    }

    #[test]
    fn every_combination_is_a_scenario() {
        let settings = ["learner.rule=paper,actor-critic", "encoder.maps.0.radius=0.4,0.5", "policy.sigma=0.002"];
        let sweep = Sweep {
            scenario: Scenario::find("arm").unwrap(),
            settings: settings.map(setting).to_vec(),
            seeds: super::super::SeedRange { first: 1, end: 3 },
            ticks: Some(100),
            out: None,
            place: super::super::StudyPlace::Folder,
            progress: false,
        };
        let all = combinations(&sweep).unwrap();
        assert_eq!(all.len(), 4);
        assert_eq!(all[1].name, "learner.rule=paper encoder.maps.0.radius=0.5 policy.sigma=0.002");
        assert!(all[2].plan.scenario.learner.critic.is_some(), "the preset of the rule that was set");
        assert!(all.iter().all(|one| one.plan.scenario.ticks == 100 && one.plan.scenario.policy.sigma == 0.002));
        let refused = |text: &str| {
            let sweep = Sweep { settings: vec![setting(text)], ..sweep.clone() };
            combinations(&sweep).err().map(|error| error.to_string()).unwrap_or_default()
        };
        assert!(
            refused("learner.bta=1").contains("learner.bta=1: unknown key \"learner.bta\""),
            "{}",
            refused("learner.bta=1")
        );
        assert!(refused("encoder.maps.9.radius=1").contains("is no entry of a list of"));
        assert!(refused("ticks.x=1").contains("stands in a value that is no table"));
        assert!(refused("seed=1,2").contains("give --seeds"));
    }
}
