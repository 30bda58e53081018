//! A client: its handshake, what it has subscribed to, and what is still to be written to it.

use std::collections::{BTreeMap, VecDeque};
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};

use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, Message, WebSocket};

use super::super::web::request::LONGEST_HEAD;
use super::feed::SampleFeed;
use super::handshake::{Opening, open};
use super::protocol::{ClientRequest, message_data, request, status, unadvertise};

/// How long a client may take to ask, ns.
const REQUEST_NS: u64 = 5_000_000_000;
/// Most bytes of messages that wait for a client. Beyond it the oldest are dropped.
const LONGEST_QUEUE: usize = 4 << 20;
/// Most bytes of a client's message.
const LONGEST_REQUEST: usize = 1 << 20;
/// Bytes that are handed over at a time.
const STRETCH: usize = 64 << 10;
/// Time between two statements of what was dropped, ns.
const SAY_EVERY_NS: u64 = 1_000_000_000;

enum Stage {
    /// Its request is read.
    Asking(TcpStream, Vec<u8>),
    /// It is a WebSocket.
    Open(Box<WebSocket<TcpStream>>),
    /// It is over.
    Closed(TcpStream),
}

/// A client.
pub(super) struct Client {
    stage: Stage,
    began: u64,
    /// By channel: the client's own number for its subscription.
    subscriptions: BTreeMap<u32, u32>,
    /// The channels that it knows.
    advertised: Vec<u32>,
    /// What must not be dropped, and messages of channels.
    texts: VecDeque<String>,
    queue: VecDeque<Vec<u8>>,
    queued: usize,
    /// Whether the socket takes no more for now.
    blocked: bool,
    dropped: u64,
    /// How many dropped messages it was told of, when that may be next, and what else it was told last.
    told_dropped: u64,
    next_told: u64,
    told: String,
}

impl Client {
    /// Takes a connection that was accepted at `now`, ns. `None` if it is gone already.
    pub fn new(stream: TcpStream, now: u64) -> Option<Self> {
        stream.set_nonblocking(true).ok()?;
        // A message is small and is wanted now.
        stream.set_nodelay(true).ok()?;
        Some(Self {
            stage: Stage::Asking(stream, Vec::new()),
            began: now,
            subscriptions: BTreeMap::new(),
            advertised: Vec::new(),
            texts: VecDeque::new(),
            queue: VecDeque::new(),
            queued: 0,
            blocked: false,
            dropped: 0,
            told_dropped: 0,
            next_told: 0,
            told: String::new(),
        })
    }

    /// The socket, to wait for it.
    pub fn stream(&self) -> &TcpStream {
        match &self.stage {
            Stage::Asking(stream, _) | Stage::Closed(stream) => stream,
            Stage::Open(socket) => socket.get_ref(),
        }
    }

    /// Whether something is still to be written.
    pub fn has_output(&self) -> bool {
        self.blocked || !self.texts.is_empty() || !self.queue.is_empty()
    }

    /// Whether it stays.
    pub fn is_open(&self, now: u64) -> bool {
        match self.stage {
            Stage::Asking(..) => now - self.began < REQUEST_NS,
            Stage::Open(_) => true,
            Stage::Closed(_) => false,
        }
    }

    fn close(&mut self) {
        if let Ok(stream) = self.stream().try_clone() {
            self.stage = Stage::Closed(stream);
        }
        (self.blocked, self.queued) = (false, 0);
        self.texts.clear();
        self.queue.clear();
    }

    /// Reads and writes as far as that goes at once. Returns true when it has just become a WebSocket.
    pub fn serve(&mut self, local: SocketAddr, token: Option<&str>) -> bool {
        if let Stage::Asking(..) = self.stage {
            return self.shake_hands(local, token);
        }
        self.read();
        self.write();
        false
    }

    fn shake_hands(&mut self, local: SocketAddr, token: Option<&str>) -> bool {
        let Stage::Asking(stream, asked) = &mut self.stage else { return false };
        let mut bytes = [0; 2048];
        let opening = loop {
            match stream.read(&mut bytes) {
                Ok(0) => break None,
                Ok(n) => asked.extend(&bytes[..n]),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    break Some(open(&asked[..asked.len().min(LONGEST_HEAD)], local, token));
                }
                Err(_) => break None,
            }
        };
        // A fresh socket's buffer has room for a head.
        match opening {
            Some(Opening::NotYet) => return false,
            Some(Opening::Accepted(text)) => {
                if let (Ok(()), Ok(stream)) = (stream.write_all(text.as_bytes()), stream.try_clone()) {
                    let config = WebSocketConfig::default().max_message_size(Some(LONGEST_REQUEST));
                    let socket = WebSocket::from_raw_socket(stream, Role::Server, Some(config));
                    self.stage = Stage::Open(Box::new(socket));
                    return true;
                }
            }
            Some(Opening::Refused(text)) => drop(stream.write_all(text.as_bytes())),
            None => {}
        }
        self.close();
        false
    }

    fn read(&mut self) {
        loop {
            let Stage::Open(socket) = &mut self.stage else { return };
            match socket.read() {
                Ok(Message::Text(text)) => match request(text.as_str()) {
                    Ok(Some(ClientRequest::Subscribe(pairs))) => {
                        let known = pairs.into_iter().filter(|(_, channel)| self.advertised.contains(channel));
                        self.subscriptions.extend(known.map(|(id, channel)| (channel, id)));
                    }
                    Ok(Some(ClientRequest::Unsubscribe(ids))) => self.subscriptions.retain(|_, id| !ids.contains(id)),
                    Ok(None) => {}
                    Err(why) => self.texts.push_back(status(true, "request", &why)),
                },
                Ok(_) => {}
                Err(Error::Io(error)) if error.kind() == ErrorKind::Interrupted => {}
                Err(Error::Io(error)) if error.kind() == ErrorKind::WouldBlock => return,
                Err(_) => return self.close(),
            }
        }
    }

    fn write(&mut self) {
        loop {
            let Stage::Open(socket) = &mut self.stage else { return };
            match socket.flush() {
                Ok(()) => self.blocked = false,
                Err(Error::Io(error)) if error.kind() == ErrorKind::WouldBlock => {
                    self.blocked = true;
                    return;
                }
                Err(_) => return self.close(),
            }
            let mut handed_over = 0;
            while handed_over < STRETCH {
                let message = match (self.texts.pop_front(), &mut self.queue) {
                    (Some(text), _) => Message::text(text),
                    (None, queue) => match queue.pop_front() {
                        Some(data) => {
                            self.queued -= data.len();
                            Message::binary(data)
                        }
                        None => break,
                    },
                };
                handed_over += message.len().max(1);
                match socket.write(message) {
                    Ok(()) => {}
                    // It is kept, and goes out when there is room.
                    Err(Error::Io(error)) if error.kind() == ErrorKind::WouldBlock => break,
                    Err(_) => return self.close(),
                }
            }
            if handed_over == 0 {
                return;
            }
        }
    }

    /// Tells it of the run that is watched now, in place of the one before.
    pub fn welcome(&mut self, feed: Option<&SampleFeed>, generation: u64) {
        let (Stage::Open(_), Some(feed)) = (&self.stage, feed.filter(|_| generation > 0)) else { return };
        if !self.advertised.is_empty() {
            self.texts.push_back(unadvertise(&self.advertised));
        }
        self.subscriptions.clear();
        self.texts.extend(feed.introduction());
        self.advertised = feed.ids();
        self.told.clear();
        self.write();
    }

    /// Queues a message, if it has subscribed to its channel, and drops the oldest ones beyond the queue's limit.
    pub fn send(&mut self, channel: u32, ns: u64, data: &[u8]) {
        let Some(subscription) = self.subscriptions.get(&channel) else { return };
        let message = message_data(*subscription, ns, data);
        self.queued += message.len();
        self.queue.push_back(message);
        while self.queued > LONGEST_QUEUE {
            let Some(oldest) = self.queue.pop_front() else { break };
            self.queued -= oldest.len();
            self.dropped += 1;
        }
    }

    /// Tells it a sentence, once.
    pub fn say(&mut self, text: &str) {
        if matches!(self.stage, Stage::Open(_)) && self.told != text && !text.is_empty() {
            self.told = text.to_owned();
            self.texts.push_back(status(false, "run", text));
        }
    }

    /// Writes what was queued, and says what was dropped.
    pub fn update(&mut self, now: u64) {
        if self.dropped > self.told_dropped && now >= self.next_told && self.texts.is_empty() {
            (self.told_dropped, self.next_told) = (self.dropped, now + SAY_EVERY_NS);
            let text = format!("{} messages were dropped, because they were not read in time.", self.dropped);
            self.texts.push_back(status(true, "dropped", &text));
        }
        self.write();
    }
}
