//! A scenario for a test: a file of the project or a built-in one, with other values for some keys.

use std::path::Path;

use tectum::scenario::{Plan, Preset, Scenario};
use toml::{Table, Value};

/// A scenario whose keys a test changes before it writes it into its folder.
///
/// ```
/// use tectum_testkit::ScenarioFile;
///
/// let plan = ScenarioFile::built_in("arm")
///     .set("ticks", 500)
///     .set("gate.max_command", 0.02)
///     .set("encoder.maps.0.radius", 0.4)
///     .plan();
/// assert_eq!(plan.scenario.ticks, 500);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct ScenarioFile {
    table: Table,
}

impl ScenarioFile {
    /// Reads a scenario file. A relative path counts from the current folder, which `cargo test` sets to the folder of
    /// the package.
    ///
    /// # Panics
    ///
    /// If there is no such file, or it is not TOML.
    #[track_caller]
    pub fn read(path: impl AsRef<Path>) -> Self {
        let path = path.as_ref();
        let text = std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        Self::named(&text, &path.display().to_string())
    }

    /// A scenario that is built into `tectum`, such as `arm`.
    ///
    /// # Panics
    ///
    /// If there is no such scenario.
    #[track_caller]
    pub fn built_in(name: &str) -> Self {
        let preset = Preset::named(name).unwrap_or_else(|error| panic!("{error}"));
        Self::named(preset.text, name)
    }

    /// A scenario from its text.
    ///
    /// # Panics
    ///
    /// If the text is not TOML.
    #[track_caller]
    pub fn from_text(text: &str) -> Self {
        Self::named(text, "scenario")
    }

    #[track_caller]
    fn named(text: &str, name: &str) -> Self {
        Self { table: text.parse().unwrap_or_else(|error| panic!("{name}: {error}")) }
    }

    /// The same scenario with another value for a key such as `gate.max_command`. Tables that are missing on the way
    /// are added. In a list of tables, a number selects the entry, from 0: `encoder.maps.0.radius`.
    ///
    /// # Panics
    ///
    /// If the path goes through a value that is neither a table nor a list with such an entry.
    #[must_use]
    #[track_caller]
    pub fn set(mut self, key: &str, value: impl Into<Value>) -> Self {
        let (mut table, mut rest) = (&mut self.table, key);
        while let Some((name, more)) = rest.split_once('.') {
            let mut inner = table.entry(name).or_insert_with(|| Value::Table(Table::new()));
            rest = more;
            while let Value::Array(list) = inner {
                let (index, more) = rest.split_once('.').unwrap_or((rest, ""));
                let length = list.len();
                let entry = index.parse().ok().and_then(|i: usize| list.get_mut(i));
                inner = entry.unwrap_or_else(|| panic!("{key}: {name} is a list of {length}, without entry {index:?}"));
                rest = more;
            }
            if rest.is_empty() {
                *inner = value.into();
                return self;
            }
            table = inner.as_table_mut().unwrap_or_else(|| panic!("{key}: {name} is a value, not a table"));
        }
        table.insert(rest.to_owned(), value.into());
        self
    }

    /// The scenario as TOML, without the comments of the file.
    pub fn to_toml(&self) -> String {
        self.table.to_string()
    }

    /// The validated plan, for a run in this process ([`tectum::runtime::in_process()`]).
    ///
    /// # Panics
    ///
    /// With the message that `tectum run` would print if the scenario is not valid.
    #[track_caller]
    pub fn plan(&self) -> Plan {
        let plan = Scenario::parse(&self.to_toml(), "scenario").and_then(Scenario::plan);
        plan.unwrap_or_else(|error| panic!("{error}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn changed(key: &str, value: impl Into<Value>) -> Table {
        let file = ScenarioFile::from_text("ticks = 1\n[gate]\nhold_ticks = 2\n[[encoder.maps]]\nunits = [4, 5]\n");
        file.set(key, value).table
    }

    #[test]
    fn keys_are_changed_and_added_at_any_depth() {
        assert_eq!(changed("ticks", 3)["ticks"].as_integer(), Some(3));
        assert_eq!(changed("gate.hold_ticks", 3)["gate"]["hold_ticks"].as_integer(), Some(3));
        assert_eq!(changed("restart.policy", "never")["restart"]["policy"].as_str(), Some("never"));
        assert_eq!(changed("encoder.maps.0.radius", 0.5)["encoder"]["maps"][0]["radius"].as_float(), Some(0.5));
        assert_eq!(changed("encoder.maps.0.units.1", 9)["encoder"]["maps"][0]["units"][1].as_integer(), Some(9));
    }

    #[test]
    #[should_panic(expected = "encoder.maps.3.radius: maps is a list of 1, without entry \"3\"")]
    fn a_missing_entry_of_a_list_is_named() {
        let _ = changed("encoder.maps.3.radius", 0.5);
    }

    #[test]
    #[should_panic(expected = "ticks.often: ticks is a value, not a table")]
    fn a_value_in_place_of_a_table_is_named() {
        let _ = changed("ticks.often", 1);
    }
}
