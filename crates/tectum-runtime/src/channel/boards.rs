//! Boards: blackboard services of which only the latest value counts. The launcher's board shows the run's
//! phase; each process publishes its status on its own.

use iceoryx2::port::reader::{EntryHandle, Reader};
use iceoryx2::port::writer::{EntryHandleMut, Writer};
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::blackboard;

use super::domain::Domain;
use super::ports::Payload;
use super::{BOARD_PAGES, CONTROL, ChannelError, board_name, service_name};
use crate::wire::{Control, Role, Status};

pub(super) type Board = blackboard::PortFactory<ipc::Service, u64>;

/// The only page of the launcher's board.
pub(super) const CONTROL_PAGE: u32 = 0;

/// The boards of a process: the launcher's to read, its own to write.
pub struct StatusBoard {
    /// The launcher's board.
    pub control: BoardReader<Control>,
    /// This process's board.
    pub status: BoardWriter<Status>,
    /// The process's start number within the run.
    pub incarnation: u32,
    /// What the process's predecessors within the run showed last; all zeros if none got as far as its first sample.
    pub before: Status,
}

/// The writing end of a board.
pub struct BoardWriter<T: Payload> {
    entry: EntryHandleMut<ipc::Service, u64, T>,
    /// Not used to write, but kept: dropping it would remove the mark by which the place of a dead process is
    /// found and freed.
    _port: Writer<ipc::Service, u64>,
}

impl<T: Payload> BoardWriter<T> {
    pub(super) fn new(port: Writer<ipc::Service, u64>, page: u32) -> Result<Self, ChannelError> {
        let entry = port.entry::<T>(&u64::from(page)).map_err(|e| ChannelError::set_up("a board's page", e))?;
        Ok(Self { entry, _port: port })
    }

    /// Replaces the value on the board.
    #[inline]
    pub fn put(&self, value: T) {
        self.entry.update_with_copy(value);
    }
}

/// A reading end of a board. A restarted process writes on a page of its own, because the right to write a page
/// cannot be taken from its predecessor. Readers switch to that page.
pub struct BoardReader<T: Payload> {
    reader: Reader<ipc::Service, u64>,
    entry: EntryHandle<ipc::Service, u64, T>,
    incarnation: u32,
    /// Whose board it is; `None` for the launcher's, which has one page.
    process: Option<(Domain, Role)>,
}

impl<T: Payload> BoardReader<T> {
    pub(super) fn new(reader: Reader<ipc::Service, u64>, page: u32) -> Result<Self, ChannelError> {
        let entry = entry(&reader, page)?;
        Ok(Self { reader, entry, incarnation: page, process: None })
    }

    /// The board of the process in `role`, at the page of its start `incarnation`.
    pub(super) fn of_process(domain: &Domain, role: Role, incarnation: u32) -> Result<Self, ChannelError> {
        let reader = process_reader(domain, role, incarnation)?;
        let entry = entry(&reader, incarnation % BOARD_PAGES)?;
        Ok(Self { reader, entry, incarnation, process: Some((domain.clone(), role)) })
    }

    /// The value on the board.
    #[inline]
    pub fn get(&self) -> T {
        *self.entry.get()
    }

    /// Switches to the page of `incarnation`. True if it was another one before.
    ///
    /// # Errors
    /// [`ChannelError::SetUp`] when there is no such page.
    pub fn set_incarnation(&mut self, incarnation: u32) -> Result<bool, ChannelError> {
        if incarnation == self.incarnation {
            return Ok(false);
        }
        if let Some((domain, role)) = &self.process
            && incarnation / BOARD_PAGES != self.incarnation / BOARD_PAGES
        {
            self.reader = process_reader(domain, *role, incarnation)?;
        }
        self.entry = entry(&self.reader, incarnation % BOARD_PAGES)?;
        self.incarnation = incarnation;
        Ok(true)
    }
}

/// Name of the board on which the start `incarnation` of the process in `role` has its page.
pub(super) fn process_board(role: Role, incarnation: u32) -> String {
    match incarnation / BOARD_PAGES {
        0 => role.name().to_owned(),
        number => format!("{}-{number}", role.name()),
    }
}

/// Creates the board on which the start `incarnation` of the process in `role` has its page, and those after it.
pub(super) fn create_process_board(
    domain: &Domain,
    role: Role,
    incarnation: u32,
    nodes: usize,
) -> Result<Board, ChannelError> {
    create_board::<Status>(domain, &process_board(role, incarnation), BOARD_PAGES, nodes)
}

fn process_reader(domain: &Domain, role: Role, incarnation: u32) -> Result<Reader<ipc::Service, u64>, ChannelError> {
    let board = open_board(domain, &process_board(role, incarnation))?;
    board.reader_builder().create().map_err(|e| ChannelError::set_up("a board's reader", e))
}

fn entry<T: Payload>(
    reader: &Reader<ipc::Service, u64>,
    page: u32,
) -> Result<EntryHandle<ipc::Service, u64, T>, ChannelError> {
    reader.entry::<T>(&u64::from(page)).map_err(|e| ChannelError::set_up("a board's page", e))
}

/// Creates the board `name` with `pages` pages, for up to `nodes` processes.
pub(super) fn create_board<T: Payload + Default>(
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

pub(super) fn open_board(domain: &Domain, name: &str) -> Result<Board, ChannelError> {
    domain
        .node
        .service_builder(&service_name(&board_name(name))?)
        .blackboard_opener::<u64>()
        .open()
        .map_err(|e| ChannelError::set_up(format!("board {name}"), e))
}

pub(super) fn read_board<T: Payload>(board: &Board, page: u32) -> Result<BoardReader<T>, ChannelError> {
    let reader = board.reader_builder().create().map_err(|e| ChannelError::set_up("a board's reader", e))?;
    BoardReader::new(reader, page)
}

pub(super) fn write_board<T: Payload>(board: &Board, page: u32) -> Result<BoardWriter<T>, ChannelError> {
    let writer = board.writer_builder().create().map_err(|e| ChannelError::set_up("a board's writer", e))?;
    BoardWriter::new(writer, page)
}

/// The board of another process, at the page of its current incarnation.
pub(super) fn read_peer(
    domain: &Domain,
    role: Role,
    status_board: &StatusBoard,
) -> Result<BoardReader<Status>, ChannelError> {
    BoardReader::of_process(domain, role, status_board.control.get().incarnations[role as usize])
}

/// Opens the boards of the process in `role`.
pub(super) fn open_status_board(domain: &Domain, role: Role) -> Result<StatusBoard, ChannelError> {
    let control = read_board::<Control>(&open_board(domain, CONTROL)?, CONTROL_PAGE)?;
    let incarnation = control.get().incarnations[role as usize];
    let board = open_board(domain, &process_board(role, incarnation))?;
    let before = last_of_predecessors(domain, role, incarnation)?;
    Ok(StatusBoard { control, status: write_board(&board, incarnation % BOARD_PAGES)?, incarnation, before })
}

/// The last page before `incarnation` that shows a sample.
fn last_of_predecessors(domain: &Domain, role: Role, incarnation: u32) -> Result<Status, ChannelError> {
    let Some(newest) = incarnation.checked_sub(1) else { return Ok(Status::default()) };
    let mut pages = BoardReader::<Status>::of_process(domain, role, newest)?;
    for page in (0..incarnation).rev() {
        pages.set_incarnation(page)?;
        if pages.get().sent > 0 {
            return Ok(pages.get());
        }
    }
    Ok(Status::default())
}
