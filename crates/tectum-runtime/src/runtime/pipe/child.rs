//! The child's half: serves a parent with an agent.

use std::io::{BufReader, BufWriter, Read, Write};

use super::frame::{read_frame, write_frame};
use super::{Failed, Ready, Start, VERSION, json, kind, schema_text};
use crate::agent::Agent;
use crate::checkpoint::Checkpoint;
use crate::runtime::{Controller, RuntimeError, exit};
use crate::scenario::{Plan, Scenario, ScenarioError};
use crate::state;
use crate::wire::{Command, Learning, Observation};

/// Serves a parent on standard input and standard output, until the former ends. `build` makes the agent of the
/// scenario's plan. Returns the exit code; a failure has been told to the parent.
pub fn serve_controller<A: Agent>(build: impl FnOnce(&Plan) -> Result<A, ScenarioError>) -> u8 {
    let mut to = BufWriter::new(std::io::stdout().lock());
    match serve(&mut BufReader::new(std::io::stdin().lock()), &mut to, build) {
        Ok(()) => exit::OK,
        Err(error) => {
            let failed = Failed { code: error.exit_code(), message: error.to_string() };
            // A parent that is gone has no use for it.
            let _ = write_frame(&mut to, kind::FAILED, &json(&failed));
            failed.code
        }
    }
}

fn serve<A: Agent>(
    from: &mut impl Read,
    to: &mut impl Write,
    build: impl FnOnce(&Plan) -> Result<A, ScenarioError>,
) -> Result<(), RuntimeError> {
    let start = match read_frame(from).map_err(RuntimeError::Pipe)? {
        Some((kind::START, bytes)) => serde_json::from_slice::<Start>(&bytes),
        _ => return Err(unexpected("the first frame is not the parent's")),
    };
    let start = start.map_err(|error| RuntimeError::Pipe(error.into()))?;
    let plan = Scenario::parse(&start.scenario, &start.source)?.plan()?;
    let plan = plan.with_origin(&start.source, start.folder.as_deref());
    let agent = build(&plan)?;
    let columns = agent.columns().iter().map(|&name| name.to_owned()).collect();
    let mut controller = Controller::with_agent(&plan, agent);
    if start.frozen {
        controller.freeze();
    }
    if let Some(path) = &start.start {
        controller.start_from(&Checkpoint::read(path)?)?;
    }
    let mut send = |kind, bytes: &[u8]| write_frame(to, kind, bytes).map_err(RuntimeError::Pipe);
    send(kind::READY, &json(&Ready { version: VERSION, schema: schema_text(), columns }))?;
    let (mut command, mut learning) = (Command::default(), Learning::default());
    // The agent's state before the test that goes on.
    let mut kept: Option<Vec<u8>> = None;
    while let Some((kind, bytes)) = read_frame(from).map_err(RuntimeError::Pipe)? {
        match (kind, kept.take()) {
            (kind::OBSERVATION, before) if bytes.len() == size_of::<Observation>() => {
                let observation: Observation = bytemuck::pod_read_unaligned(&bytes);
                if before.is_some() {
                    controller.answer_test(&observation, &mut command);
                    send(kind::COMMAND, bytemuck::bytes_of(&command))?;
                    kept = before;
                    continue;
                }
                controller.respond(&observation, &mut command);
                send(kind::COMMAND, bytemuck::bytes_of(&command))?;
                controller.after_command(&observation);
                controller.record(&observation, &mut learning);
                send(kind::LEARNING, bytemuck::bytes_of(&learning))?;
            }
            (kind::TEST, None) => {
                let agent = controller.agent_mut();
                let mut bytes = vec![0; state::size(agent)];
                state::save(agent, &mut bytes);
                kept = Some(bytes);
            }
            (kind::TESTED, Some(before)) => {
                if !state::load(controller.agent_mut(), &before) {
                    return Err(RuntimeError::StateAfterTest);
                }
            }
            _ => return Err(unexpected(&format!("frame {kind} of {} bytes", bytes.len()))),
        }
    }
    send(kind::REPORT, &json(&controller.finish()))
}

fn unexpected(what: &str) -> RuntimeError {
    RuntimeError::Pipe(std::io::Error::other(what.to_owned()))
}
