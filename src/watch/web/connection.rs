//! A connection of a browser: its request, what is still to be written, and, for events, what it knows of the run.

use std::collections::VecDeque;
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};

use tectum_view::RunView;
use tectum_view::page::PageCursor;

use super::request::{LONGEST_HEAD, PageResponse, answer, head};

/// How long a connection may take to ask, ns.
const REQUEST_NS: u64 = 5_000_000_000;
/// How long it may take to read an answer that is no stream of events, ns.
const ANSWER_NS: u64 = 30_000_000_000;
/// Seconds between two signs of life where nothing is new.
const ALIVE_EVERY_S: f64 = 10.0;

/// What is served, and to whom.
pub(super) struct Served<'a> {
    /// The page; `None` where metrics alone are served.
    pub page: Option<&'a str>,
    /// Gives the metrics of now.
    pub metrics: &'a dyn Fn() -> String,
    /// Where it is served.
    pub local: SocketAddr,
    /// The token that a reader needs.
    pub token: Option<&'a str>,
}

/// What a connection is at.
#[derive(Debug)]
enum Stage {
    /// Its request is read.
    Asking(Vec<u8>),
    /// Its answer is written, and then it is closed.
    Answered,
    /// It gets events.
    Reading(PageCursor),
    /// It is over.
    Closed,
}

/// A connection.
#[derive(Debug)]
pub(super) struct Connection {
    stream: TcpStream,
    stage: Stage,
    output: VecDeque<u8>,
    began: u64,
    /// When something was sent last, in seconds of the watcher's own time, and what a reader without a run was told.
    last_sent: f64,
    told: String,
}

impl Connection {
    /// Takes a connection that was accepted at `now`, ns. `None` if it is gone already.
    pub fn new(stream: TcpStream, now: u64) -> Option<Self> {
        stream.set_nonblocking(true).ok()?;
        // An update is small and is wanted now.
        stream.set_nodelay(true).ok()?;
        let stage = Stage::Asking(Vec::new());
        Some(Self { stream, stage, output: VecDeque::new(), began: now, last_sent: 0.0, told: String::new() })
    }

    /// The socket, to wait for it.
    pub fn stream(&self) -> &TcpStream {
        &self.stream
    }

    /// Whether something is still to be written.
    pub fn has_output(&self) -> bool {
        !self.output.is_empty()
    }

    /// Whether it stays: it is not over, and has not taken too long.
    pub fn is_open(&self, now: u64) -> bool {
        match self.stage {
            Stage::Asking(_) => now - self.began < REQUEST_NS,
            Stage::Answered => now - self.began < ANSWER_NS,
            Stage::Reading(_) => true,
            Stage::Closed => false,
        }
    }

    /// Reads and writes as far as that goes at once.
    pub fn serve(&mut self, served: &Served<'_>) {
        self.read(served);
        self.write();
    }

    fn read(&mut self, served: &Served<'_>) {
        let mut bytes = [0; 2048];
        loop {
            match self.stream.read(&mut bytes) {
                Ok(0) => {
                    // It asks for nothing more, but may still read its answer.
                    if !matches!(self.stage, Stage::Answered) || self.output.is_empty() {
                        self.stage = Stage::Closed;
                    }
                    return;
                }
                Ok(n) => {
                    if let Stage::Asking(asked) = &mut self.stage {
                        asked.extend(&bytes[..n]);
                        let found = answer(&asked[..asked.len().min(LONGEST_HEAD)], served.local, served.token);
                        self.give(found, served);
                    }
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(_) => {
                    self.stage = Stage::Closed;
                    return;
                }
            }
        }
    }

    fn give(&mut self, answer: PageResponse, served: &Served<'_>) {
        const NO_PAGE: &str = "There is no page here; metrics are at /metrics.";
        match (answer, served.page) {
            (PageResponse::NotYet, _) => {}
            (PageResponse::Page { head }, Some(page)) => self.give_text("text/html; charset=utf-8", page, head),
            (PageResponse::Metrics { head }, _) => {
                self.give_text("text/plain; version=0.0.4; charset=utf-8", &(served.metrics)(), head);
            }
            (PageResponse::Events, Some(_)) => {
                // A browser that loses the connection tries again after a second.
                self.output.extend(head("200 OK", "text/event-stream", None).into_bytes());
                self.output.extend(b"retry: 1000\n\n");
                self.stage = Stage::Reading(PageCursor::default());
            }
            (PageResponse::Refusal(status, text), _) => self.refuse(status, text),
            (PageResponse::Page { .. } | PageResponse::Events, None) => self.refuse("404 Not Found", NO_PAGE),
        }
    }

    fn give_text(&mut self, kind: &str, text: &str, only_head: bool) {
        self.output.extend(head("200 OK", kind, Some(text.len())).into_bytes());
        self.output.extend(if only_head { "" } else { text }.bytes());
        self.stage = Stage::Answered;
    }

    fn refuse(&mut self, status: &str, text: &str) {
        self.output.extend(head(status, "text/plain; charset=utf-8", Some(text.len() + 1)).into_bytes());
        self.output.extend(text.bytes().chain(*b"\n"));
        self.stage = Stage::Answered;
    }

    fn write(&mut self) {
        while !self.output.is_empty() {
            let (bytes, _) = self.output.as_slices();
            match self.stream.write(bytes) {
                Ok(0) => self.stage = Stage::Closed,
                Ok(n) => drop(self.output.drain(..n)),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(_) => self.stage = Stage::Closed,
            }
            if matches!(self.stage, Stage::Closed) {
                self.output.clear();
                return;
            }
        }
        if matches!(self.stage, Stage::Answered) {
            self.stage = Stage::Closed;
        }
    }

    /// Sends what is new, if this gets events and has taken all that was sent before.
    pub fn update(&mut self, view: &RunView, generation: u64, now: f64) {
        let Stage::Reading(cursor) = &mut self.stage else { return };
        if self.output.is_empty() {
            let messages = cursor.update(view, generation, now);
            self.send(&messages, now);
        }
    }

    /// Tells why there is no run to see, once.
    pub fn notice(&mut self, text: &str, now: f64) {
        if !matches!(self.stage, Stage::Reading(_)) || !self.output.is_empty() {
            return;
        }
        let new = self.told != text;
        self.told = text.to_owned();
        let message = serde_json::json!({"kind": "notice", "text": text}).to_string();
        self.send(if new { std::slice::from_ref(&message) } else { &[] }, now);
    }

    fn send(&mut self, messages: &[String], now: f64) {
        for message in messages {
            self.output.extend(format!("data: {message}\n\n").into_bytes());
        }
        if messages.is_empty() && now - self.last_sent > ALIVE_EVERY_S {
            self.output.extend(b":\n\n");
        }
        if !self.output.is_empty() {
            self.last_sent = now;
            self.write();
        }
    }
}
