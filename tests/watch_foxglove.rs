//! `tectum watch --foxglove` (feature `foxglove`): the client that Foxglove publishes itself reads a run, under both
//! names of the protocol; a reader that does not read loses the oldest messages and holds up nobody.
//!
//! ```text
//! npm install --prefix target/node @foxglove/ws-protocol ws @foxglove/rosmsg @foxglove/rosmsg2-serialization
//! TECTUM_NODE_MODULES=$PWD/target/node/node_modules cargo test --features foxglove --test watch_foxglove -- --ignored
//! ```
#![cfg(feature = "foxglove")]

mod support;

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use serde_json::Value;
use support::{Process, TECTUM, TestFolder, WATCHDOG, signal_process};

/// A watcher that serves the protocol.
struct FoxgloveWatcher {
    child: Child,
    url: String,
}

impl FoxgloveWatcher {
    fn start(folder: &TestFolder, arguments: &[&str]) -> Self {
        let mut command = Command::new(TECTUM);
        command.args(["watch", "run"]).args(arguments).current_dir(folder.path());
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
        assert!(url.starts_with("ws://"), "{url}");
        Self { child, url: url.trim().to_owned() }
    }

    fn host(&self) -> &str {
        self.url.trim_start_matches("ws://").split('/').next().unwrap()
    }

    /// Opens a connection with a request of its own, and returns what comes first.
    fn ask(&self, more: &str) -> (TcpStream, String) {
        let port = self.host().rsplit_once(':').unwrap().1;
        let mut stream = TcpStream::connect(format!("127.0.0.1:{port}")).unwrap();
        stream.set_read_timeout(Some(WATCHDOG)).unwrap();
        let request = format!("GET / HTTP/1.1\r\nHost: {}\r\n{more}\r\n", self.host());
        stream.write_all(request.as_bytes()).unwrap();
        // Byte by byte: behind the head come the first frames.
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            stream.read_exact(&mut byte).unwrap();
            head.extend(byte);
        }
        (stream, String::from_utf8(head).unwrap())
    }

    fn end(mut self) {
        signal_process(self.child.id(), "TERM");
        assert_eq!(self.child.wait().unwrap().code(), Some(143));
    }
}

impl Drop for FoxgloveWatcher {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A run in lockstep of which every tick is logged, so that it makes many messages on a busy machine, too.
fn run(folder: &TestFolder) -> Process {
    let scenario = folder.arm_scenario(&[("ticks", "3_000_000"), ("every", "1")]);
    let mut run = folder.run(&[&scenario, "--mode", "lockstep"]);
    run.wait_until_ticking();
    run
}

fn end(run: Process) {
    run.signal("INT");
    run.wait().expect(130);
}

/// A frame of a client with this text, which is shorter than 64 KiB, masked with zeros.
fn text_frame(text: &str) -> Vec<u8> {
    let length = u16::try_from(text.len()).unwrap().to_be_bytes();
    [&[0x81, 0x80 | 126][..], &length, &[0; 4], text.as_bytes()].concat()
}

/// Reads one frame of the server: its operation code and its content.
fn frame(stream: &mut impl std::io::Read) -> (u8, Vec<u8>) {
    let mut head = [0; 2];
    stream.read_exact(&mut head).unwrap();
    let mut more = [0; 8];
    let length = match head[1] {
        126 => {
            stream.read_exact(&mut more[6..]).unwrap();
            u64::from_be_bytes(more)
        }
        127 => {
            stream.read_exact(&mut more).unwrap();
            u64::from_be_bytes(more)
        }
        short => u64::from(short),
    };
    let mut content = vec![0; length as usize];
    stream.read_exact(&mut content).unwrap();
    (head[0] & 15, content)
}

const UPGRADE: &str = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
    Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.websocket.v1\r\n";

/// More bytes than wait for a client that does not read: its queue, and the sockets' buffers.
const MORE_THAN_WAITS: usize = 16 << 20;

/// A lockstep run makes more than a client can hold that reads nothing. It is told afterwards what it lost.
#[test]
fn who_does_not_read_loses_the_oldest_and_holds_up_nobody() {
    let folder = TestFolder::new();
    let mut running = run(&folder);
    let watcher = FoxgloveWatcher::start(&folder, &["--foxglove", "127.0.0.1:0"]);
    assert!(watcher.ask("").1.starts_with("HTTP/1.1 426"));
    let (stream, head) = watcher.ask(UPGRADE);
    assert!(head.starts_with("HTTP/1.1 101"), "{head}");
    let mut reader = BufReader::new(stream);
    // It is told of the channels once the server has found the run, and subscribes to all of them.
    let channels = loop {
        let (_, content) = frame(&mut reader);
        let message: Value = serde_json::from_slice(&content).unwrap();
        if message["op"] == "advertise" {
            break message["channels"].as_array().unwrap().clone();
        }
    };
    let each: Vec<_> = channels.iter().map(|c| serde_json::json!({"id": c["id"], "channelId": c["id"]})).collect();
    let subscribe = serde_json::json!({"op": "subscribe", "subscriptions": each}).to_string();
    reader.get_mut().write_all(&text_frame(&subscribe)).unwrap();
    let began = Instant::now();
    let log = folder.path().join("run/log.mcap");
    let length = || std::fs::metadata(&log).unwrap().len();
    let mut unread = 48 << 20;
    let told = 'told: loop {
        // For so long nothing is read, and the run goes on. A run may be much quicker than the server of this build,
        // which then has sent little; so the next time is longer.
        let enough = length() + unread;
        running.wait_until("a log that is longer by what can wait", || length() >= enough);
        unread *= 2;
        let mut read = 0;
        while read < MORE_THAN_WAITS {
            assert!(began.elapsed() < WATCHDOG, "it was not told of what was dropped");
            let (code, content) = frame(&mut reader);
            read += content.len();
            if code == 1 {
                let message: Value = serde_json::from_slice(&content).unwrap();
                if message["op"] == "status" && message["id"] == "dropped" {
                    break 'told message["message"].as_str().unwrap().to_owned();
                }
            }
        }
    };
    assert!(told.contains("messages were dropped"), "{told}");
    end(running);
    watcher.end();
}

#[test]
#[ignore = "needs node with Foxglove's packages and ws"]
fn the_client_of_foxglove_itself_reads_a_run() {
    let folder = TestFolder::new();
    let mut running = folder.run(&["arm", "--mode", "realtime", "--ticks", "100000"]);
    running.wait_until_ticking();
    let watcher = FoxgloveWatcher::start(&folder, &["--foxglove", "127.0.0.1:0"]);
    let modules = std::env::var("TECTUM_NODE_MODULES").expect("TECTUM_NODE_MODULES names the folder node_modules");
    let script = folder.write_file("client.mjs", include_str!("node/foxglove_client.mjs"));
    std::os::unix::fs::symlink(modules, folder.path().join("node_modules")).unwrap();
    for name in ["foxglove.websocket.v1", "foxglove.sdk.v1"] {
        let outcome = folder.start("node", &[script.to_str().unwrap(), &watcher.url, name, "40"]).wait().expect(0);
        let seen: Value = serde_json::from_str(&outcome.stdout).unwrap();
        assert_eq!(seen["info"]["name"], "tectum run");
        for topic in ["/observation", "/learning", "/inputs", "/joint_states", "/loss", "/error", "/budget"] {
            assert!(seen["counts"][topic].as_u64() >= Some(39), "{topic}: {seen}");
        }
        assert_eq!(seen["keys"]["/transforms"], serde_json::json!(["transforms"]));
        for topic in ["/scene/links", "/scene/target", "/scene/path"] {
            assert_eq!(seen["keys"][topic], serde_json::json!(["markers"]), "{seen}");
        }
    }
    end(running);
    watcher.end();
}
