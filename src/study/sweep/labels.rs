//! Names of a sweep's combinations that are short enough for a figure.

use std::collections::BTreeMap;

use super::SweepRow;

/// One name a row: `learner.beta=0.5 policy.sigma=0.003`. Of lists, such as the arguments of a program, only those
/// items are written that come after what all of them begin with: `plant.args=.. --gravity 0`.
pub(super) fn labels(rows: &[SweepRow]) -> Vec<String> {
    let settings: Vec<&BTreeMap<String, String>> = rows.iter().map(|row| &row.settings).collect();
    let common: BTreeMap<&String, usize> = settings
        .first()
        .into_iter()
        .flat_map(|first| first.keys())
        .filter_map(|key| Some((key, common_items(settings.iter().map(|one| one.get(key)))?)))
        .collect();
    let label = |one: &BTreeMap<String, String>| {
        let words = one.iter().map(|(key, value)| match (common.get(key), list(value)) {
            (Some(&common), Some(items)) => format!("{key}=.. {}", items[common..].join(" ")),
            _ => format!("{key}={value}"),
        });
        words.map(|word| word.trim_end().to_owned()).collect::<Vec<_>>().join(" ")
    };
    settings.into_iter().map(label).collect()
}

/// The number of items with which all these lists begin; `None` if one is no list, or nothing is common.
fn common_items<'a>(values: impl Iterator<Item = Option<&'a String>>) -> Option<usize> {
    let mut lists = values.map(|value| list(value?));
    let first = lists.next()??;
    let same = |a: &[String], b: &[String]| a.iter().zip(b).take_while(|(a, b)| a == b).count();
    let common = lists.try_fold(first.len(), |common, other| Some(common.min(same(&first, &other?))))?;
    (common > 0).then_some(common)
}

/// The items of a list in TOML.
fn list(value: &str) -> Option<Vec<String>> {
    let table: toml::Table = toml::from_str(&format!("list = {value}")).ok()?;
    let items = table.get("list")?.as_array()?;
    Some(items.iter().map(|item| item.as_str().map_or_else(|| item.to_string(), str::to_owned)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_lists_only_what_differs_is_written() {
        let labelled = |values: &[&str]| {
            let name = |value: &&str| BTreeMap::from([("plant.args".to_owned(), (*value).to_owned())]);
            labels(
                &values
                    .iter()
                    .map(|value| SweepRow { settings: name(value), ..SweepRow::default() })
                    .collect::<Vec<_>>(),
            )
        };
        let args = [r#"["a.py"]"#, r#"["a.py", "--gravity", "0"]"#];
        assert_eq!(labelled(&args), ["plant.args=..", "plant.args=.. --gravity 0"]);
        assert_eq!(labelled(&["[1, 2]", "[2, 2]"]), ["plant.args=[1, 2]", "plant.args=[2, 2]"]);
        assert_eq!(labelled(&["0.5", "[2]"]), ["plant.args=0.5", "plant.args=[2]"]);
        assert_eq!(labelled(&["paper", "actor-critic"]), ["plant.args=paper", "plant.args=actor-critic"]);
    }
}
