//! The services of a run. The launcher creates and holds all of them.

use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::event;

use super::boards::{Board, BoardReader, BoardWriter, CONTROL_PAGE, create_board, create_process_board, write_board};
use super::domain::{Domain, DomainName, close_domain_to_others};
use super::domain_lock::DomainGuard;
use super::log_ring::create_rings;
use super::ports::{Factory, Payload};
use super::wake::WakeWord;
use super::{AHEAD, BOARD_PAGES, CONTROL, ChannelError, IDENTITY, Identity, LOG_BUFFER, VISION_BUFFER, service_name};
use crate::wire::{Ahead, ChannelNames, Command, Control, Learning, Observation, Role, Status, Vision};

/// Readers of a channel: the loop's peer and some viewers. None of them can hold up the writer.
const MAX_SUBSCRIBERS: usize = 4;
/// Processes of a run: launcher, plant, controller and logger, and some viewers.
const MAX_NODES: usize = 8;
/// Additional readers and nodes in a run with trackers. A killed tracker keeps its place until the launcher
/// next cleans up; cleaning up while another tracker is being set up could take that one for dead.
const TRACKER_PLACES: usize = 8;
/// Trackers at the same time, killed ones included. The newest sample counts, whichever tracker sent it.
const MAX_TRACKERS: usize = 8;

/// Every service of a run, created and held by the launcher. Dropping it removes the domain, so it must be
/// dropped last.
pub struct RunServices {
    /// The launcher's board.
    pub control: BoardWriter<Control>,
    /// The boards of the processes, by [`Role`].
    status: [BoardReader<Status>; 3],
    // Fields drop in this order: services before the node, the domain's files after all of them.
    boards: Vec<Board>,
    /// Most processes on a board.
    nodes: usize,
    _channels: (Factory<Observation>, Factory<Command>, Factory<Learning>),
    _ahead: Option<Factory<Ahead>>,
    _vision: Option<Factory<Vision>>,
    _identity: event::PortFactory<ipc::Service>,
    _wake: WakeWord,
    domain: Domain,
    guard: DomainGuard,
}

impl RunServices {
    /// Creates the domain and all its services. If `vision` names a channel for trackers, creates that too, and
    /// more places for readers and nodes; with `ahead`, also the channel of commands ahead. The domain is also removed
    /// if setting up fails half-way.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when shared memory cannot be used.
    pub fn create(
        name: &DomainName,
        identity: &Identity,
        channels: &ChannelNames,
        vision: Option<&str>,
        ahead: bool,
    ) -> Result<Self, ChannelError> {
        let extra = if vision.is_some() { TRACKER_PLACES } else { 0 };
        let nodes = MAX_NODES + extra;
        let guard = DomainGuard::take(name)?;
        let domain = Domain::join(name)?;
        close_domain_to_others(name);
        let service = domain
            .node
            .service_builder(&service_name(IDENTITY)?)
            .event()
            .max_nodes(nodes)
            .create_with_attributes(&identity.specifier())
            .map_err(|e| ChannelError::set_up("the run's identity", e))?;
        let wake = WakeWord::create(name)?;
        create_rings(name)?;
        let channels = (
            create_channel(&domain, &channels.observation, extra)?,
            create_channel(&domain, &channels.command, extra)?,
            create_channel(&domain, &channels.learning, extra)?,
        );
        let ahead = ahead.then(|| create_channel(&domain, AHEAD, 0)).transpose()?;
        let vision = vision.map(|name| create_vision(&domain, name, nodes)).transpose()?;
        let control = create_board::<Control>(&domain, CONTROL, 1, nodes)?;
        let mut boards = Vec::new();
        for role in Role::ALL {
            boards.push(create_process_board(&domain, role, 0, nodes)?);
        }
        let [plant, controller, logger] = Role::ALL.map(|role| BoardReader::of_process(&domain, role, 0));
        let status = [plant?, controller?, logger?];
        let writer = write_board(&control, CONTROL_PAGE)?;
        boards.push(control);
        Ok(Self {
            control: writer,
            status,
            boards,
            nodes,
            _channels: channels,
            _ahead: ahead,
            _vision: vision,
            _identity: service,
            _wake: wake,
            domain,
            guard,
        })
    }

    /// The run's domain.
    pub fn domain(&self) -> &DomainName {
        self.guard.name()
    }

    /// The status that the process in `role` published last.
    pub fn status(&self, role: Role) -> Status {
        self.status[role as usize].get()
    }

    /// Switches to the page of `incarnation` on the board of `role`. Creates another board when all pages are used.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when shared memory has no room for another board.
    pub fn set_incarnation(&mut self, role: Role, incarnation: u32) -> Result<(), ChannelError> {
        if incarnation > 0 && incarnation.is_multiple_of(BOARD_PAGES) {
            self.boards.push(create_process_board(&self.domain, role, incarnation, self.nodes)?);
        }
        self.status[role as usize].set_incarnation(incarnation).map(|_| ())
    }
}

fn create_channel<T: Payload>(domain: &Domain, name: &str, extra: usize) -> Result<Factory<T>, ChannelError> {
    domain
        .node
        .service_builder(&service_name(name)?)
        .publish_subscribe::<T>()
        .max_publishers(1)
        .max_subscribers(MAX_SUBSCRIBERS + extra)
        .max_nodes(MAX_NODES + extra)
        .subscriber_max_buffer_size(LOG_BUFFER)
        .subscriber_max_borrowed_samples(2)
        .history_size(0)
        .enable_safe_overflow(true)
        .create()
        .map_err(|e| ChannelError::set_up(format!("channel {name}"), e))
}

/// The channel from all trackers to the bridge.
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

#[cfg(test)]
mod tests {
    use super::super::boards::open_status_board;
    use super::*;
    use crate::wire::ProcessState;

    /// A process can be started more often than a board has pages; its peers and the launcher follow it.
    #[test]
    fn starts_have_no_bound() {
        let name = DomainName::of(0x7e57_b0a2_0000_0000 | u64::from(std::process::id()));
        let identity = Identity { schema: 1, scenario: 2, build: "test".to_owned() };
        let mut services = RunServices::create(&name, &identity, &ChannelNames::default(), None, false).unwrap();
        let domain = Domain::join(&name).unwrap();
        let mut peer = BoardReader::<Status>::of_process(&domain, Role::Plant, 0).unwrap();
        for incarnation in 1..=2 * BOARD_PAGES + 1 {
            services.set_incarnation(Role::Plant, incarnation).unwrap();
            let mut control = Control::default();
            control.incarnations[Role::Plant as usize] = incarnation;
            services.control.put(control);
            if incarnation % 100 > 1 && incarnation % BOARD_PAGES > 1 {
                continue;
            }
            let own = open_status_board(&domain, Role::Plant).unwrap();
            assert_eq!(own.incarnation, incarnation);
            let state = ProcessState::Running as u32;
            own.status.put(Status { state, sent: u64::from(incarnation), ..Status::default() });
            assert!(peer.set_incarnation(incarnation).unwrap());
            assert_eq!((peer.get().sent, services.status(Role::Plant).sent), (incarnation.into(), incarnation.into()));
        }
    }
}
