//! The ends of channels and boards that plant, controller and logger hold. They open what the launcher has
//! created.

use std::os::unix::fs::MetadataExt as _;

use iceoryx2::service::port_factory::PortFactory as _;

use super::boards::{BoardReader, StatusBoard, open_status_board, read_peer};
use super::domain::{Domain, DomainName};
use super::log_ring::{LogAppender, LogTail};
use super::ports::{Factory, Payload, Receiver, Sender};
use super::wake::{WakeListener, WakeNotifier};
use super::{AHEAD, ChannelError, IDENTITY, Identity, LOOP_BUFFER, service_name};
use crate::wire::{Ahead, ChannelNames, Command, Learning, Observation, Role, Status};

/// The plant's ends.
pub struct PlantPorts {
    /// Observations, to the controller and viewers.
    pub observation: Sender<Observation>,
    /// Observations, for the logger.
    pub log: LogAppender<Observation>,
    /// Wakes the controller.
    pub wake: WakeNotifier,
    /// Wakes the plant in lockstep. Taken by its loop.
    pub lockstep_wake: Option<WakeListener>,
    /// Commands, the newest two.
    pub command: Receiver<Command>,
    /// Commands ahead, the newest two, once [opened](Self::open_ahead).
    pub ahead: Option<Receiver<Ahead>>,
    /// The controller's status.
    pub controller: BoardReader<Status>,
    /// The logger's status.
    pub logger: BoardReader<Status>,
    _domain: Domain,
}

/// The controller's ends.
pub struct ControllerPorts {
    /// Observations, the newest two.
    pub observation: Receiver<Observation>,
    /// Notified with every observation.
    pub wake: WakeListener,
    /// The same, which wakes the controller in lockstep. Taken by its loop.
    pub lockstep_wake: Option<WakeListener>,
    /// Wakes the plant in lockstep.
    pub wake_plant: WakeNotifier,
    /// Commands, to the plant and viewers.
    pub command: Sender<Command>,
    /// Commands ahead, to the plant, once [opened](Self::open_ahead).
    pub ahead: Option<Sender<Ahead>>,
    /// Learning records, to viewers.
    pub learning: Sender<Learning>,
    /// Commands, for the logger.
    pub command_log: LogAppender<Command>,
    /// Learning records, for the logger.
    pub learning_log: LogAppender<Learning>,
    /// The plant's status.
    pub plant: BoardReader<Status>,
    _domain: Domain,
}

/// The logger's ends.
pub struct LoggerPorts {
    /// Observations.
    pub observation: LogTail<Observation>,
    /// Commands.
    pub command: LogTail<Command>,
    /// Learning records.
    pub learning: LogTail<Learning>,
    /// The plant's status.
    pub plant: BoardReader<Status>,
    /// The controller's status.
    pub controller: BoardReader<Status>,
    _domain: Domain,
}

impl PlantPorts {
    /// Joins the run as its plant.
    ///
    /// # Errors
    /// [`ChannelError::Mismatch`] when the process does not fit the run, [`ChannelError::SetUp`] when there is
    /// no such run, or it has a plant already.
    pub fn open(
        name: &DomainName,
        identity: &Identity,
        channels: &ChannelNames,
    ) -> Result<(Self, StatusBoard), ChannelError> {
        let domain = open_domain(name, identity, Role::Plant.name())?;
        let status_board = open_status_board(&domain, Role::Plant)?;
        let ports = Self {
            observation: Sender::new(&channels.observation, open_channel(&domain, &channels.observation)?)?,
            log: LogAppender::open(name, "observation")?,
            wake: WakeNotifier::open(name)?,
            lockstep_wake: Some(WakeListener::open(name, Role::Plant)?),
            command: Receiver::new(&channels.command, open_channel(&domain, &channels.command)?, LOOP_BUFFER)?,
            ahead: None,
            controller: read_peer(&domain, Role::Controller, &status_board)?,
            logger: read_peer(&domain, Role::Logger, &status_board)?,
            _domain: domain,
        };
        Ok((ports, status_board))
    }

    /// Opens the channel of commands ahead, in a run whose scenario has them.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when the run has no such channel.
    pub fn open_ahead(&mut self) -> Result<(), ChannelError> {
        self.ahead = Some(Receiver::new(AHEAD, open_channel(&self._domain, AHEAD)?, LOOP_BUFFER)?);
        Ok(())
    }
}

impl ControllerPorts {
    /// Joins the run as its controller.
    ///
    /// # Errors
    /// As for [`PlantPorts::open`].
    pub fn open(
        name: &DomainName,
        identity: &Identity,
        channels: &ChannelNames,
    ) -> Result<(Self, StatusBoard), ChannelError> {
        let domain = open_domain(name, identity, Role::Controller.name())?;
        let status_board = open_status_board(&domain, Role::Controller)?;
        let ports = Self {
            observation: Receiver::new(
                &channels.observation,
                open_channel(&domain, &channels.observation)?,
                LOOP_BUFFER,
            )?,
            wake: WakeListener::open(name, Role::Controller)?,
            lockstep_wake: Some(WakeListener::open(name, Role::Controller)?),
            wake_plant: WakeNotifier::of(name, Role::Plant)?,
            command: Sender::new(&channels.command, open_channel(&domain, &channels.command)?)?,
            ahead: None,
            learning: Sender::new(&channels.learning, open_channel(&domain, &channels.learning)?)?,
            command_log: LogAppender::open(name, "command")?,
            learning_log: LogAppender::open(name, "learning")?,
            plant: read_peer(&domain, Role::Plant, &status_board)?,
            _domain: domain,
        };
        Ok((ports, status_board))
    }

    /// Opens the channel of commands ahead, in a run whose scenario has them.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when the run has no such channel.
    pub fn open_ahead(&mut self) -> Result<(), ChannelError> {
        self.ahead = Some(Sender::new(AHEAD, open_channel(&self._domain, AHEAD)?)?);
        Ok(())
    }
}

impl LoggerPorts {
    /// Joins the run as its logger.
    ///
    /// # Errors
    /// As for [`PlantPorts::open`].
    pub fn open(
        name: &DomainName,
        identity: &Identity,
        _channels: &ChannelNames,
    ) -> Result<(Self, StatusBoard), ChannelError> {
        let domain = open_domain(name, identity, Role::Logger.name())?;
        let status_board = open_status_board(&domain, Role::Logger)?;
        let ports = Self {
            observation: LogTail::open(name, "observation")?,
            command: LogTail::open(name, "command")?,
            learning: LogTail::open(name, "learning")?,
            plant: read_peer(&domain, Role::Plant, &status_board)?,
            controller: read_peer(&domain, Role::Controller, &status_board)?,
            _domain: domain,
        };
        Ok((ports, status_board))
    }

    /// From now on takes samples from the rings one by one, because most of them are passed over.
    pub fn take_singly(&mut self) {
        self.observation.take_singly();
        self.command.take_singly();
        self.learning.take_singly();
    }
}

/// Joins the domain and checks the handshake.
pub(super) fn open_domain(name: &DomainName, identity: &Identity, role: &'static str) -> Result<Domain, ChannelError> {
    check_owner(name)?;
    let domain = Domain::join(name)?;
    let service = domain
        .node
        .service_builder(&service_name(IDENTITY)?)
        .event()
        .open()
        .map_err(|e| ChannelError::set_up("the run's identity", e))?;
    identity.check(role, service.attributes())?;
    Ok(domain)
}

/// Requires that the run's domain is there and belongs to this user. The transport would only say that something
/// failed, or would set up a part of the domain anew.
fn check_owner(name: &DomainName) -> Result<(), ChannelError> {
    let root = name.root();
    let own = rustix::process::geteuid().as_raw();
    match root.symlink_metadata() {
        Ok(metadata) if metadata.uid() != own => Err(ChannelError::OtherUser { owner: metadata.uid(), own }),
        Ok(_) => Ok(()),
        Err(_) => Err(ChannelError::Removed { root }),
    }
}

pub(super) fn open_channel<T: Payload>(domain: &Domain, name: &str) -> Result<Factory<T>, ChannelError> {
    domain
        .node
        .service_builder(&service_name(name)?)
        .publish_subscribe::<T>()
        .open()
        .map_err(|e| ChannelError::set_up(format!("channel {name}"), e))
}
