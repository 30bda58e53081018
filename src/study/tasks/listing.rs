//! `tectum tasks --list`: the tasks with their levels, and the controllers.

use serde::Serialize;

use super::candidate::Candidate;
use super::levels::level;
use crate::plant::task::{self, Task};

/// One task of the list.
#[derive(Debug, Serialize)]
struct ListedTask {
    task: String,
    about: String,
    /// Whether it is measured when no task is named.
    usual: bool,
    period_ms: f64,
    ticks: u64,
    level: String,
    reason: &'static str,
}

/// The list: the object of `--list --json`.
#[derive(Debug, Serialize)]
struct TaskList {
    tasks: Vec<ListedTask>,
    learners: Vec<String>,
}

fn list() -> TaskList {
    let listed = |task: Task| ListedTask {
        level: level(&task, false).words(),
        reason: level(&task, false).reason,
        usual: task::USUAL.contains(&task.name.as_str()),
        about: task.about,
        period_ms: task.period_ms,
        ticks: task.ticks,
        task: task.name,
    };
    TaskList {
        tasks: task::names().iter().filter_map(|name| Task::named(name)).map(listed).collect(),
        learners: Candidate::all().iter().map(Candidate::name).collect(),
    }
}

/// The list as text.
pub fn listing() -> String {
    let list = list();
    let rows: Vec<Vec<String>> = list
        .tasks
        .iter()
        .map(|task| {
            let name = format!("{} {}", if task.usual { "*" } else { " " }, task.task);
            vec![name, task.level.clone(), task.about.clone()]
        })
        .collect();
    let mut text = "Tasks with their levels; those with a star are measured when none is named:\n\n".to_owned();
    let width = rows.iter().map(|row| row[0].chars().count()).max().unwrap_or(0);
    for row in &rows {
        text.push_str(&format!("{:<width$}  {:<15}  {}\n", row[0], row[1], row[2]));
    }
    text.push_str(&format!("\nLearners and reference controllers: {}\n", list.learners.join(", ")));
    text
}

/// The list as one JSON object.
pub fn listing_json() -> String {
    serde_json::to_string(&list()).unwrap_or_default()
}
