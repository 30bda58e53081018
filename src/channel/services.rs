//! Which services a run has, who creates them and who holds which end.

use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::{blackboard, event};
use xxhash_rust::xxh3::xxh3_64;

use super::domain::{Domain, DomainName, remove_domain};
use super::ports::{
    BoardReader, BoardWriter, Factory, Payload, Receiver, Sender, StatusBoard, WakeListener, WakeNotifier,
};
use super::stale_domains::DomainLock;
use super::{ChannelError, INCARNATIONS, LOG_BUFFER, Mismatch};
use crate::scenario::ChannelsConfig;
use crate::wire::{Command, Control, Learning, Observation, Role, Status, Vision};

type Board = blackboard::PortFactory<ipc::Service, u64>;
type Event = event::PortFactory<ipc::Service>;

/// The loop reads the newest sample; one more slot lets a late one be seen and counted.
const LOOP_BUFFER: usize = 2;
/// Controller and logger, and room for viewers. None of them can hold up the writer.
const MAX_SUBSCRIBERS: usize = 4;
/// Launcher, the three processes, and room for viewers.
const MAX_NODES: usize = 8;
/// More of both where trackers may come: one that is killed leaves its place taken until the launcher next tidies up, and to tidy up
/// while another is being set up could take that for a dead one.
const FOR_TRACKERS: usize = 8;
/// Trackers that there may be at once, those that were killed among them. The newest picture counts, whoever took it.
const MAX_TRACKERS: usize = 8;
/// Samples of each tracker that the bridge can be behind: it takes the newest at every tick.
const VISION_BUFFER: usize = 4;
/// The service that exists before all others and says whose run this is.
pub const WAKE: &str = "wake";
/// The launcher's board.
pub const CONTROL: &str = "control";
/// The launcher's board has one page.
const PAGE: u32 = 0;

/// What must be equal for a process to belong to a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    /// Hash over the layout of all samples.
    pub schema: u64,
    /// Hash of the resolved scenario.
    pub scenario: u64,
    /// Package version and commit.
    pub build: String,
}

impl Identity {
    /// The build as it stands on a board.
    pub fn build_hash(&self) -> u64 {
        xxh3_64(self.build.as_bytes())
    }

    fn attributes(&self) -> [(&'static str, String); 3] {
        [
            ("schema", format!("{:016x}", self.schema)),
            ("scenario", format!("{:016x}", self.scenario)),
            ("build", self.build.clone()),
        ]
    }

    fn specifier(&self) -> AttributeSpecifier {
        self.attributes().iter().fold(AttributeSpecifier::new(), |spec, (key, value)| {
            let key = (*key).try_into().expect("a short key");
            let value = value.as_str().try_into().expect("a hash or a version");
            spec.define(&key, &value).expect("three attributes of the eight that are allowed")
        })
    }

    /// Compares with what the run's first service says.
    fn check(&self, role: &'static str, run: &AttributeSet) -> Result<(), ChannelError> {
        for (what, ours) in self.attributes() {
            let key = what.try_into().expect("a short key");
            let theirs = run.key_value(&key, 0).map(|v| v.to_string()).unwrap_or_default();
            if theirs != ours {
                return Err(ChannelError::Mismatch(Mismatch { role, what, ours, theirs }));
            }
        }
        Ok(())
    }
}

/// Every service of a run, created and held by the launcher. Dropping it wipes the domain: it must be the last.
pub struct RunServices {
    /// The launcher's board.
    pub control: BoardWriter<Control>,
    /// The boards of the processes, by [`Role`].
    status: [BoardReader<Status>; 3],
    // In reverse order of need: services go before the node, the files after all of them.
    _boards: Vec<Board>,
    _channels: (Factory<Observation>, Factory<Command>, Factory<Learning>),
    _vision: Option<Factory<Vision>>,
    _wake: Event,
    _domain: Domain,
    _wipe: DomainGuard,
}

/// Wipes the domain when everything else is gone, also when setting up fails half-way.
/// The claim is given back after that.
#[derive(Debug)]
struct DomainGuard {
    name: DomainName,
    _claim: DomainLock,
}

impl Drop for DomainGuard {
    fn drop(&mut self) {
        remove_domain(&self.name);
    }
}

impl RunServices {
    /// Creates the domain and all its services; a channel for trackers, and room for them, where `vision` names one.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when shared memory cannot be used.
    pub fn create(
        name: &DomainName,
        identity: &Identity,
        channels: &ChannelsConfig,
        vision: Option<&str>,
    ) -> Result<Self, ChannelError> {
        let more = if vision.is_some() { FOR_TRACKERS } else { 0 };
        let nodes = MAX_NODES + more;
        let claim = DomainLock::take(name).map_err(|e| ChannelError::set_up("the root", e.kind()))?;
        let remove_domain = DomainGuard { name: name.clone(), _claim: claim };
        let domain = Domain::join(name)?;
        let wake = domain
            .node
            .service_builder(&service_name(WAKE)?)
            .event()
            .max_nodes(nodes)
            .create_with_attributes(&identity.specifier())
            .map_err(|e| ChannelError::set_up("the wake-up service", e))?;
        let channels = (
            create_channel(&domain, &channels.observation, more)?,
            create_channel(&domain, &channels.command, more)?,
            create_channel(&domain, &channels.learning, more)?,
        );
        let vision = vision.map(|name| create_vision(&domain, name, nodes)).transpose()?;
        let control = create_board::<Control>(&domain, CONTROL, 1, nodes)?;
        let mut boards = Vec::new();
        for role in Role::ALL {
            boards.push(create_board::<Status>(&domain, role.name(), INCARNATIONS, nodes)?);
        }
        let status = [read_board(&boards[0], 0)?, read_board(&boards[1], 0)?, read_board(&boards[2], 0)?];
        let writer = write_board(&control, PAGE)?;
        boards.push(control);
        Ok(Self {
            control: writer,
            status,
            _boards: boards,
            _channels: channels,
            _vision: vision,
            _wake: wake,
            _domain: domain,
            _wipe: remove_domain,
        })
    }

    /// The board of `role`.
    pub fn status(&self, role: Role) -> Status {
        self.status[role as usize].get()
    }

    /// Turns the board of `role` to the page of its next incarnation.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when it has no such page.
    pub fn set_incarnation(&mut self, role: Role, incarnation: u32) -> Result<(), ChannelError> {
        self.status[role as usize].set_incarnation(incarnation).map(|_| ())
    }
}

/// The plant's ends.
pub struct PlantPorts {
    /// Observations, to controller and logger.
    pub observation: Sender<Observation>,
    /// Wakes the controller.
    pub wake: WakeNotifier,
    /// Commands, newest two.
    pub command: Receiver<Command>,
    /// How far the controller is.
    pub controller: BoardReader<Status>,
    /// How far the logger is.
    pub logger: BoardReader<Status>,
    _domain: Domain,
}

/// The controller's ends.
pub struct ControllerPorts {
    /// Observations, newest two.
    pub observation: Receiver<Observation>,
    /// Rings with every observation.
    pub wake: WakeListener,
    /// Commands, to plant and logger.
    pub command: Sender<Command>,
    /// What was learned, to the logger.
    pub learning: Sender<Learning>,
    /// How far the plant is.
    pub plant: BoardReader<Status>,
    _domain: Domain,
}

/// The logger's ends.
pub struct LoggerPorts {
    /// Observations, the last [`LOG_BUFFER`].
    pub observation: Receiver<Observation>,
    /// Commands, the last [`LOG_BUFFER`].
    pub command: Receiver<Command>,
    /// Learning records, the last [`LOG_BUFFER`].
    pub learning: Receiver<Learning>,
    /// How far the plant is.
    pub plant: BoardReader<Status>,
    /// How far the controller is.
    pub controller: BoardReader<Status>,
    _domain: Domain,
}

impl PlantPorts {
    /// Joins the run in the plant's place.
    ///
    /// # Errors
    /// [`ChannelError::Mismatch`] when the process does not fit the run, [`ChannelError::SetUp`] when there is no such
    /// run or its plant is there already.
    pub fn open(
        name: &DomainName,
        identity: &Identity,
        channels: &ChannelsConfig,
    ) -> Result<(Self, StatusBoard), ChannelError> {
        let (domain, wake) = open_domain(name, identity, Role::Plant.name())?;
        let wake =
            wake.notifier_builder().create().map_err(|e| ChannelError::set_up("the bell", e)).map(WakeNotifier)?;
        let status_board = open_desk(&domain, Role::Plant)?;
        let ports = Self {
            observation: Sender::new(&channels.observation, open_channel(&domain, &channels.observation)?)?,
            wake,
            command: Receiver::new(&channels.command, open_channel(&domain, &channels.command)?, LOOP_BUFFER)?,
            controller: read_peer(&domain, Role::Controller, &status_board)?,
            logger: read_peer(&domain, Role::Logger, &status_board)?,
            _domain: domain,
        };
        Ok((ports, status_board))
    }
}

impl ControllerPorts {
    /// Joins the run in the controller's place.
    ///
    /// # Errors
    /// As for [`PlantPorts::open`].
    pub fn open(
        name: &DomainName,
        identity: &Identity,
        channels: &ChannelsConfig,
    ) -> Result<(Self, StatusBoard), ChannelError> {
        let (domain, wake) = open_domain(name, identity, Role::Controller.name())?;
        let wake = wake
            .listener_builder()
            .create()
            .map_err(|e| ChannelError::set_up("the wake-up listener", e))
            .map(WakeListener)?;
        let status_board = open_desk(&domain, Role::Controller)?;
        let ports = Self {
            observation: Receiver::new(
                &channels.observation,
                open_channel(&domain, &channels.observation)?,
                LOOP_BUFFER,
            )?,
            wake,
            command: Sender::new(&channels.command, open_channel(&domain, &channels.command)?)?,
            learning: Sender::new(&channels.learning, open_channel(&domain, &channels.learning)?)?,
            plant: read_peer(&domain, Role::Plant, &status_board)?,
            _domain: domain,
        };
        Ok((ports, status_board))
    }
}

impl LoggerPorts {
    /// Joins the run in the logger's place.
    ///
    /// # Errors
    /// As for [`PlantPorts::open`].
    pub fn open(
        name: &DomainName,
        identity: &Identity,
        channels: &ChannelsConfig,
    ) -> Result<(Self, StatusBoard), ChannelError> {
        let (domain, _wake) = open_domain(name, identity, Role::Logger.name())?;
        let status_board = open_desk(&domain, Role::Logger)?;
        let ports = Self {
            observation: Receiver::new(
                &channels.observation,
                open_channel(&domain, &channels.observation)?,
                LOG_BUFFER,
            )?,
            command: Receiver::new(&channels.command, open_channel(&domain, &channels.command)?, LOG_BUFFER)?,
            learning: Receiver::new(&channels.learning, open_channel(&domain, &channels.learning)?, LOG_BUFFER)?,
            plant: read_peer(&domain, Role::Plant, &status_board)?,
            controller: read_peer(&domain, Role::Controller, &status_board)?,
            _domain: domain,
        };
        Ok((ports, status_board))
    }
}

/// A tracker's ends: it says what it sees, and may read what the plant says.
pub struct TrackerPorts {
    /// What it sees, to the bridge.
    pub vision: Sender<Vision>,
    /// Observations, newest two.
    pub observation: Receiver<Observation>,
    /// The launcher's board.
    pub control: BoardReader<Control>,
    _domain: Domain,
}

impl TrackerPorts {
    /// Joins the run as a tracker. It may come and go at any time, also by SIGKILL.
    ///
    /// # Errors
    /// As for [`PlantPorts::open`]; and where the run has no channel for trackers, or no place for another one.
    pub fn open(name: &DomainName, identity: &Identity, channels: &ChannelsConfig) -> Result<Self, ChannelError> {
        let (domain, _wake) = open_domain(name, identity, "tracker")?;
        Ok(Self {
            vision: Sender::new(&channels.vision, open_channel(&domain, &channels.vision)?)?,
            observation: Receiver::new(
                &channels.observation,
                open_channel(&domain, &channels.observation)?,
                LOOP_BUFFER,
            )?,
            control: read_board(&open_board(&domain, CONTROL)?, PAGE)?,
            _domain: domain,
        })
    }
}

/// The bridge's end of the channel on which trackers say what they see.
pub struct VisionReceiver {
    vision: Receiver<Vision>,
    _domain: Domain,
}

impl VisionReceiver {
    /// Opens it.
    ///
    /// # Errors
    /// As for [`PlantPorts::open`].
    pub fn open(name: &DomainName, identity: &Identity, channels: &ChannelsConfig) -> Result<Self, ChannelError> {
        let (domain, _wake) = open_domain(name, identity, Role::Plant.name())?;
        let vision = Receiver::new(&channels.vision, open_channel(&domain, &channels.vision)?, VISION_BUFFER)?;
        Ok(Self { vision, _domain: domain })
    }

    /// The next sample that was not received yet, of whichever tracker. One that cannot be had, as when its tracker has just died, is
    /// none: trackers come and go, and are no reason to end a run.
    pub fn look(&mut self) -> Option<Vision> {
        self.vision.receive().ok().flatten()
    }
}

/// The service of the board called `name`.
pub fn board_name(name: &str) -> String {
    format!("board/{name}")
}

pub(super) fn service_name(name: &str) -> Result<ServiceName, ChannelError> {
    name.try_into().map_err(|e| ChannelError::set_up(format!("the name {name}"), e))
}

fn open_domain(name: &DomainName, identity: &Identity, role: &'static str) -> Result<(Domain, Event), ChannelError> {
    let domain = Domain::join(name)?;
    let wake = domain
        .node
        .service_builder(&service_name(WAKE)?)
        .event()
        .open()
        .map_err(|e| ChannelError::set_up("the wake-up service", e))?;
    identity.check(role, wake.attributes())?;
    Ok((domain, wake))
}

fn create_channel<T: Payload>(domain: &Domain, name: &str, more: usize) -> Result<Factory<T>, ChannelError> {
    domain
        .node
        .service_builder(&service_name(name)?)
        .publish_subscribe::<T>()
        .max_publishers(1)
        .max_subscribers(MAX_SUBSCRIBERS + more)
        .max_nodes(MAX_NODES + more)
        .subscriber_max_buffer_size(LOG_BUFFER)
        .subscriber_max_borrowed_samples(2)
        .history_size(0)
        .enable_safe_overflow(true)
        .create()
        .map_err(|e| ChannelError::set_up(format!("channel {name}"), e))
}

fn create_vision(domain: &Domain, name: &str, nodes: usize) -> Result<Factory<Vision>, ChannelError> {
    domain
        .node
        .service_builder(&service_name(name)?)
        .publish_subscribe::<Vision>()
        .max_publishers(MAX_TRACKERS)
        .max_subscribers(MAX_SUBSCRIBERS)
        .max_nodes(nodes)
        .subscriber_max_buffer_size(VISION_BUFFER)
        .subscriber_max_borrowed_samples(2)
        .history_size(0)
        .enable_safe_overflow(true)
        .create()
        .map_err(|e| ChannelError::set_up(format!("channel {name}"), e))
}

fn open_channel<T: Payload>(domain: &Domain, name: &str) -> Result<Factory<T>, ChannelError> {
    domain
        .node
        .service_builder(&service_name(name)?)
        .publish_subscribe::<T>()
        .open()
        .map_err(|e| ChannelError::set_up(format!("channel {name}"), e))
}

fn open_desk(domain: &Domain, role: Role) -> Result<StatusBoard, ChannelError> {
    let control = read_board::<Control>(&open_board(domain, CONTROL)?, PAGE)?;
    let incarnation = control.get().incarnations[role as usize];
    Ok(StatusBoard { control, status: write_board(&open_board(domain, role.name())?, incarnation)?, incarnation })
}

fn create_board<T: Payload + Default>(
    domain: &Domain,
    name: &str,
    pages: u32,
    nodes: usize,
) -> Result<Board, ChannelError> {
    let creator = domain
        .node
        .service_builder(&service_name(&board_name(name))?)
        .blackboard_creator::<u64>()
        .max_readers(nodes)
        .max_nodes(nodes);
    (0..pages)
        .fold(creator, |creator, page| creator.add::<T>(u64::from(page), T::default()))
        .create()
        .map_err(|e| ChannelError::set_up(format!("board {name}"), e))
}

fn open_board(domain: &Domain, name: &str) -> Result<Board, ChannelError> {
    domain
        .node
        .service_builder(&service_name(&board_name(name))?)
        .blackboard_opener::<u64>()
        .open()
        .map_err(|e| ChannelError::set_up(format!("board {name}"), e))
}

fn read_board<T: Payload>(board: &Board, page: u32) -> Result<BoardReader<T>, ChannelError> {
    let reader = board.reader_builder().create().map_err(|e| ChannelError::set_up("a board's reader", e))?;
    BoardReader::new(reader, page)
}

/// The board of a peer, at the page of its incarnation as it is now.
fn read_peer(domain: &Domain, role: Role, status_board: &StatusBoard) -> Result<BoardReader<Status>, ChannelError> {
    read_board(&open_board(domain, role.name())?, status_board.control.get().incarnations[role as usize])
}

fn write_board<T: Payload>(board: &Board, page: u32) -> Result<BoardWriter<T>, ChannelError> {
    let writer = board.writer_builder().create().map_err(|e| ChannelError::set_up("a board's writer", e))?;
    BoardWriter::new(writer, page)
}
