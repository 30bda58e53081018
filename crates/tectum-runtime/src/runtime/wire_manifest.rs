//! The part of a run's manifest that a program in another language needs to join the run. It is plain JSON, so
//! such a program need neither read TOML nor compute a hash. `docs/wire.md` describes its use.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::identity;
use crate::channel::DomainName;
use crate::scenario::Plan;
use crate::wire::Role;

/// The `wire` table of a run's manifest.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WireManifest {
    /// The version of iceoryx2 that all processes of the run must have.
    pub iceoryx2: String,
    /// Prefix of the names of the domain's shared-memory files.
    pub prefix: String,
    /// The domain's root folder.
    pub root: String,
    /// The file whose first word is the futex that wakes the controller.
    pub wake: String,
    /// Files of the log rings of observations, commands and learning records.
    pub log_rings: [String; 3],
    /// Hash over the layout of all samples, hexadecimal.
    pub schema: String,
    /// Hash of the scenario, hexadecimal.
    pub scenario: String,
    /// The run's build.
    pub build: String,
    /// Hash of the build, as the status boards have it, hexadecimal.
    pub build_hash: String,
    /// Names of the run's services.
    pub services: Services,
    /// Period of the tick, ns.
    pub period_ns: u64,
    /// Names of an observation's inputs, in order.
    pub inputs: Vec<String>,
    /// Names of a command's outputs, in order.
    pub outputs: Vec<String>,
    /// Names of an observation's measures, in order.
    pub measures: Vec<String>,
    /// Inputs and outputs with name, unit and range, in order, and the index of the measure with the role `error`.
    #[serde(default)]
    pub signals: Value,
    /// The scenario with every default filled in: the tables and keys of `scenario.toml`.
    pub settings: Value,
}

/// Names of a run's services.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Services {
    /// Observations.
    pub observation: String,
    /// Commands.
    pub command: String,
    /// Learning records.
    pub learning: String,
    /// Commands ahead; absent in a scenario without them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ahead: Option<String>,
    /// Measurements of trackers; absent in a scenario without trackers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vision: Option<String>,
    /// The service whose attributes identify the run.
    pub identity: String,
    /// The launcher's status board.
    pub control: String,
    /// The status boards of plant, controller and logger.
    pub boards: [String; 3],
}

/// What a controller in another language needs to know of a run of `plan` when there is no manifest: on a pipe.
pub(super) fn facts(plan: &Plan) -> Value {
    let names =
        |signals: &[crate::scenario::SignalConfig]| -> Vec<_> { signals.iter().map(|s| s.name.clone()).collect() };
    serde_json::json!({
        "period_ns": plan.period_ns,
        "inputs": names(&plan.inputs),
        "outputs": names(&plan.outputs),
        "measures": plan.measures,
        "signals": signals(plan),
        "settings": plan.scenario.to_json(),
    })
}

/// Inputs and outputs with name, unit and range, and the index of the measure with the role `error`.
fn signals(plan: &Plan) -> Value {
    serde_json::json!({ "inputs": plan.inputs, "outputs": plan.outputs, "error": plan.error })
}

impl WireManifest {
    /// The table for a run of `plan` in `domain`.
    pub fn of(plan: &Plan, domain: &DomainName) -> Self {
        let identity = identity(plan);
        let channels = &plan.scenario.channels;
        let names = |signals: &[crate::scenario::SignalConfig]| signals.iter().map(|s| s.name.clone()).collect();
        Self {
            iceoryx2: crate::channel::ICEORYX2.to_owned(),
            prefix: domain.prefix(),
            root: domain.root().display().to_string(),
            wake: crate::channel::wake_file(domain).display().to_string(),
            log_rings: ["observation", "command", "learning"]
                .map(|channel| crate::channel::ring_file(domain, channel).display().to_string()),
            schema: format!("{:016x}", identity.schema),
            scenario: format!("{:016x}", identity.scenario),
            build_hash: format!("{:016x}", identity.build_hash()),
            build: identity.build,
            services: Services {
                observation: channels.observation.clone(),
                command: channels.command.clone(),
                learning: channels.learning.clone(),
                ahead: (plan.scenario.link.ahead > 0).then(|| crate::channel::AHEAD.to_owned()),
                vision: plan.scenario.vision().map(str::to_owned),
                identity: crate::channel::IDENTITY.to_owned(),
                control: crate::channel::board_name(crate::channel::CONTROL),
                boards: Role::ALL.map(|role| crate::channel::board_name(role.name())),
            },
            period_ns: plan.period_ns,
            inputs: names(&plan.inputs),
            outputs: names(&plan.outputs),
            measures: plan.measures.clone(),
            signals: signals(plan),
            settings: plan.scenario.to_json(),
        }
    }
}
