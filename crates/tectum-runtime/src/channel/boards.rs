//! Boards: blackboard services of which only the latest value counts. The launcher's board shows the run's
//! phase; each process publishes its status on its own.

use iceoryx2::port::reader::{EntryHandle, Reader};
use iceoryx2::port::writer::{EntryHandleMut, Writer};
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::blackboard;

use super::domain::Domain;
use super::ports::Payload;
use super::{CONTROL, ChannelError, board_name, service_name};
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
    page: u32,
}

impl<T: Payload> BoardReader<T> {
    pub(super) fn new(reader: Reader<ipc::Service, u64>, page: u32) -> Result<Self, ChannelError> {
        let entry = entry(&reader, page)?;
        Ok(Self { reader, entry, page })
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
        if incarnation == self.page {
            return Ok(false);
        }
        self.entry = entry(&self.reader, incarnation)?;
        self.page = incarnation;
        Ok(true)
    }
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
    read_board(&open_board(domain, role.name())?, status_board.control.get().incarnations[role as usize])
}

/// Opens the boards of the process in `role`.
pub(super) fn open_status_board(domain: &Domain, role: Role) -> Result<StatusBoard, ChannelError> {
    let control = read_board::<Control>(&open_board(domain, CONTROL)?, CONTROL_PAGE)?;
    let incarnation = control.get().incarnations[role as usize];
    let board = open_board(domain, role.name())?;
    let before = last_of_predecessors(&board, incarnation)?;
    Ok(StatusBoard { control, status: write_board(&board, incarnation)?, incarnation, before })
}

/// The last page before `incarnation` that shows a sample.
fn last_of_predecessors(board: &Board, incarnation: u32) -> Result<Status, ChannelError> {
    let Some(newest) = incarnation.checked_sub(1) else { return Ok(Status::default()) };
    let mut pages = read_board::<Status>(board, newest)?;
    for page in (0..incarnation).rev() {
        pages.set_incarnation(page)?;
        if pages.get().sent > 0 {
            return Ok(pages.get());
        }
    }
    Ok(Status::default())
}
