//! Checkpoints: the whole state of a process at a tick, in a file of its own, from which a later run can continue.
//!
//! A run's plant and controller each write one at the same tick, into the run's folder `checkpoints`:
//! `<tick>.plant.safetensors` and `<tick>.controller.safetensors`. Both hold the state at the beginning of tick
//! `<tick>`: the plant has advanced through all ticks before it, and the controller has answered them and
//! learned from them. Every row that a part lists ([`crate::state`]) is a tensor under the part's name, so any
//! safetensors reader can read the file. The controller's file also has the policy as a matrix, `weights`, of
//! shape (outputs, features). The metadata has one entry, `tectum`, a JSON object: [`CheckpointFacts`] and
//! `check`.
//!
//! A file is written under another name, synced to the disk, and renamed, so it exists as a whole or not at
//! all. `check` is a checksum over the facts and all tensors with their names, types and shapes. A file that is
//! damaged, or that belongs to another role, run, scenario, schema or build, is refused before any part of it is
//! used; the error names the file.

mod error;
mod tensors;
mod writer;

pub use error::CheckpointError;
pub use writer::CheckpointWriter;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

use crate::agent::Agent;
use crate::policy::LinearPolicy;
use crate::state::{NumberKind, Persist, StateVisitor as _};
use crate::wire::Role;
use tensors::{Tensor, TensorCollector, TensorRestorer};

/// The folder of checkpoints in a run's folder.
const FOLDER: &str = "checkpoints";
/// The name of the metadata entry.
const ENTRY: &str = "tectum";
/// Name of the policy's matrix. It is for readers of the file; [`Checkpoint::restore`] ignores it.
const WEIGHTS: &str = "weights";
/// Version of the format; changes whenever the meaning of the content changes.
const FORMAT: u32 = 1;

/// The run, role, tick and versions that a checkpoint belongs to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CheckpointFacts {
    /// Version of the format.
    format: u32,
    /// `plant` or `controller`.
    pub role: String,
    /// Id of the run, hexadecimal.
    pub run: String,
    /// The tick that begins.
    pub tick: u64,
    /// Sequence number of the next sample that the process sends.
    pub sequence: u64,
    /// Hash of the scenario, hexadecimal.
    pub scenario: String,
    /// Hash of the layout of all samples, hexadecimal.
    pub schema: String,
    /// Package version and commit.
    pub build: String,
    /// The controller's: the scenario as TOML, by which another run knows whether what was learned fits it. A process
    /// in another language may leave it out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scenario_text: Option<String>,
}

impl CheckpointFacts {
    /// The facts of a checkpoint written by this build.
    pub(crate) fn new(role: Role, run: u64, tick: u64, sequence: u64, scenario: u64) -> Self {
        Self {
            format: FORMAT,
            role: role.name().to_owned(),
            run: format!("{run:016x}"),
            tick,
            sequence,
            scenario: format!("{scenario:016x}"),
            schema: format!("{:016x}", crate::wire::schema_hash()),
            build: crate::BUILD.to_owned(),
            scenario_text: None,
        }
    }
}

/// The metadata entry.
#[derive(Serialize, Deserialize)]
struct MetadataEntry {
    #[serde(flatten)]
    facts: CheckpointFacts,
    check: String,
}

/// A checkpoint that was read completely and whose checksum fits.
#[derive(Debug)]
pub struct Checkpoint {
    path: PathBuf,
    /// The run, role, tick and versions that it belongs to.
    pub facts: CheckpointFacts,
    tensors: BTreeMap<String, Tensor>,
}

/// The file of a checkpoint in a run's folder.
pub fn path(folder: &Path, tick: u64, role: Role) -> PathBuf {
    folder.join(FOLDER).join(format!("{tick}.{}.safetensors", role.name()))
}

/// The newest checkpoint of the controller of the run in `folder`, if there is one.
pub fn newest_of_controller(folder: &Path) -> Option<PathBuf> {
    let tick = ticks_of(folder, Role::Controller).pop()?;
    Some(path(folder, tick, Role::Controller))
}

/// The ticks at which both plant and controller of the run in `folder` have written a checkpoint, in order.
pub fn ticks(folder: &Path) -> Vec<u64> {
    let mut ticks = ticks_of(folder, Role::Plant);
    ticks.retain(|&tick| path(folder, tick, Role::Controller).exists());
    ticks
}

/// The ticks at which the process in `role` has written a checkpoint, in order.
fn ticks_of(folder: &Path, role: Role) -> Vec<u64> {
    let entries = std::fs::read_dir(folder.join(FOLDER)).into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let end = format!(".{}.safetensors", role.name());
    let mut ticks: Vec<u64> = names.filter_map(|name| name.strip_suffix(&end)?.parse().ok()).collect();
    ticks.sort_unstable();
    ticks
}

/// Encodes the state of `part` as the bytes of a file. `policy` is given for the controller.
pub(crate) fn encode(facts: &CheckpointFacts, part: &mut dyn Persist, policy: Option<&LinearPolicy>) -> Vec<u8> {
    let mut collector = TensorCollector::default();
    part.visit_state(&mut collector);
    let mut tensors = collector.tensors;
    if let Some(policy) = policy {
        let rows = (0..policy.outputs()).flat_map(|o| (0..policy.features()).map(move |f| policy.weight(o, f)));
        let bytes = rows.flat_map(f32::to_ne_bytes).collect();
        let shape = vec![policy.outputs(), policy.features()];
        tensors.insert(WEIGHTS.to_owned(), Tensor { kind: NumberKind::F32, shape, bytes });
    }
    serialize(facts, &tensors)
}

fn serialize(facts: &CheckpointFacts, tensors: &BTreeMap<String, Tensor>) -> Vec<u8> {
    let entry = MetadataEntry { facts: facts.clone(), check: checksum(facts, tensors) };
    let text = serde_json::to_string(&entry).unwrap_or_default();
    let views = tensors.iter().map(|(name, t)| {
        let view = TensorView::new(dtype(t.kind), t.shape.clone(), &t.bytes).expect("a shape of as many numbers");
        (name.as_str(), view)
    });
    // One entry only: several would be written in the order of a hash map.
    let metadata = Some([(ENTRY.to_owned(), text)].into_iter().collect());
    safetensors::serialize(views, metadata).expect("a header of some kilobytes")
}

fn checksum(facts: &CheckpointFacts, tensors: &BTreeMap<String, Tensor>) -> String {
    let mut hash = Xxh3::new();
    hash.update(serde_json::to_string(facts).unwrap_or_default().as_bytes());
    for (name, Tensor { kind, shape, bytes }) in tensors {
        hash.update(format!("{name} {kind:?} {shape:?} {}\n", bytes.len()).as_bytes());
        hash.update(bytes);
    }
    format!("{:016x}", hash.digest())
}

fn dtype(kind: NumberKind) -> Dtype {
    match kind {
        NumberKind::U32 => Dtype::U32,
        NumberKind::U64 => Dtype::U64,
        NumberKind::F32 => Dtype::F32,
        NumberKind::F64 => Dtype::F64,
    }
}

fn kind(dtype: Dtype) -> Option<NumberKind> {
    [NumberKind::U32, NumberKind::U64, NumberKind::F32, NumberKind::F64]
        .into_iter()
        .find(|&kind| self::dtype(kind) == dtype)
}

impl Checkpoint {
    /// Reads a checkpoint.
    ///
    /// # Errors
    /// [`CheckpointError`], which names the file.
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        let bytes = std::fs::read(path).map_err(|cause| CheckpointError::Read { path: path.to_owned(), cause })?;
        Self::parse(path, &bytes)
    }

    /// Reads a checkpoint from bytes; `path` is for messages.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, CheckpointError> {
        let damaged = |what: &str| CheckpointError::Damaged { path: path.to_owned(), what: what.to_owned() };
        let foreign = || CheckpointError::Foreign { path: path.to_owned() };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| damaged(&e.to_string()))?;
        let text = header.metadata().as_ref().and_then(|map| map.get(ENTRY)).ok_or_else(foreign)?;
        let MetadataEntry { facts, check: stated } =
            serde_json::from_str(text).map_err(|_| damaged("its metadata cannot be read"))?;
        if facts.format != FORMAT {
            return Err(foreign());
        }
        let file = SafeTensors::deserialize(bytes).map_err(|e| damaged(&e.to_string()))?;
        let mut tensors = BTreeMap::new();
        for (name, view) in file.iter() {
            let kind = kind(view.dtype()).ok_or_else(|| damaged("it holds numbers of an unknown type"))?;
            let tensor = Tensor { kind, shape: view.shape().to_vec(), bytes: view.data().to_vec() };
            tensors.insert(name.to_owned(), tensor);
        }
        if checksum(&facts, &tensors) != stated {
            return Err(damaged("its checksum does not fit its content"));
        }
        // Finds changes that the checksum does not cover, such as spaces in the header.
        if serialize(&facts, &tensors) != bytes {
            return Err(damaged("it is not as it was written"));
        }
        Ok(Self { path: path.to_owned(), facts, tensors })
    }

    /// Checks that this is a state of `role` in a run of that scenario by this build. The run itself may be
    /// another.
    ///
    /// # Errors
    /// [`CheckpointError::Mismatch`] names the first difference.
    pub fn fits(&self, role: Role, scenario: u64) -> Result<(), CheckpointError> {
        let ours = CheckpointFacts::new(role, 0, self.facts.tick, self.facts.sequence, scenario);
        let theirs = &self.facts;
        for (what, ours, theirs) in [
            ("role", ours.role, &theirs.role),
            ("scenario", ours.scenario, &theirs.scenario),
            ("schema", ours.schema, &theirs.schema),
            ("build", ours.build, &theirs.build),
        ] {
            if ours != *theirs {
                let (path, theirs) = (self.path.clone(), theirs.clone());
                return Err(CheckpointError::Mismatch { path, what, ours, theirs });
            }
        }
        Ok(())
    }

    /// Restores what an agent has learned, and nothing else of a controller's checkpoint. Random streams stay those of
    /// the agent, so that a run's seed decides on its exploration. After an error the agent must not be used.
    ///
    /// # Errors
    /// [`CheckpointError::OtherAgent`] when a row is missing, superfluous, or of another size.
    pub fn restore_agent<A: Agent>(&self, agent: &mut A) -> Result<(), CheckpointError> {
        let mut restorer = TensorRestorer::new(&self.tensors, &[WEIGHTS]).keeping_streams();
        restorer.enter("controller");
        // The rows of a learning rule stand beside those of the controller.
        let own = agent.policy().is_none();
        if own {
            restorer.enter("agent");
        }
        agent.visit_state(&mut restorer);
        restorer
            .finish_part(if own { "controller.agent." } else { "controller.learner." })
            .map_err(|what| CheckpointError::OtherAgent { path: self.path.clone(), what })
    }

    /// The policy as it answers the next tick: outputs, features, and the weights row by row. `None` where the learner
    /// has no linear policy.
    pub fn weights(&self) -> Option<(usize, usize, Vec<f32>)> {
        let tensor = self.tensors.get(WEIGHTS).filter(|tensor| tensor.kind == NumberKind::F32)?;
        let &[outputs, features] = &tensor.shape[..] else { return None };
        Some((outputs, features, tensor.bytes.chunks_exact(4).map(bytemuck::pod_read_unaligned).collect()))
    }

    /// The checksum over facts and tensors, hexadecimal.
    pub fn check(&self) -> String {
        checksum(&self.facts, &self.tensors)
    }

    /// Restores the state of `part`. After an error `part` is only partly restored and must not be used.
    ///
    /// # Errors
    /// [`CheckpointError::Damaged`] when a row is missing, superfluous, or of another size.
    pub fn restore(&self, part: &mut dyn Persist) -> Result<(), CheckpointError> {
        let mut restorer = TensorRestorer::new(&self.tensors, &[WEIGHTS]);
        part.visit_state(&mut restorer);
        restorer.finish().map_err(|what| CheckpointError::Damaged { path: self.path.clone(), what })
    }
}

#[cfg(test)]
mod tests;
