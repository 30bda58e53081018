//! `tectum watch --web` or a run that serves its own metrics in a test, and a reader of HTTP that is as simple as can
//! be.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::Value;

use super::{TECTUM, TestFolder, WATCHDOG, signal_process};

/// A watcher that serves a page, or a run that serves metrics.
pub struct WebWatcher {
    child: Child,
    /// The link that it printed.
    pub url: String,
}

impl WebWatcher {
    /// Starts it, and waits for its link.
    pub fn start(folder: &TestFolder, arguments: &[&str]) -> Self {
        let mut command = Command::new(TECTUM);
        command.arg("watch").args(arguments).current_dir(folder.path());
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
        assert!(url.starts_with("http://"), "{url}");
        Self { child, url: url.trim().to_owned() }
    }

    /// Starts a run that serves its own metrics, and waits for the link.
    pub fn of_run(folder: &TestFolder, arguments: &[&str]) -> Self {
        let mut command = Command::new(TECTUM);
        command.arg("run").args(arguments).current_dir(folder.path());
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
        let url = lines.find_map(|line| line.strip_prefix("tectum: metrics are at ").map(str::to_owned));
        // What else it says is read, so that it can be said.
        std::thread::spawn(move || lines.for_each(drop));
        Self { child, url: url.expect("a link") }
    }

    /// Host and port of the link.
    pub fn host(&self) -> &str {
        self.url.trim_start_matches("http://").split('/').next().unwrap()
    }

    /// The watcher's process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a request, and gives the connection.
    pub fn ask(&self, request: &str) -> TcpStream {
        let port = self.host().rsplit_once(':').unwrap().1;
        let mut stream = TcpStream::connect(format!("127.0.0.1:{port}")).unwrap();
        stream.set_read_timeout(Some(WATCHDOG)).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        stream
    }

    /// The whole answer to a request of GET for `target`, which names `host`.
    pub fn get(&self, target: &str, host: &str) -> String {
        let mut text = String::new();
        self.ask(&format!("GET {target} HTTP/1.1\r\nHost: {host}\r\n\r\n")).read_to_string(&mut text).unwrap();
        text
    }

    /// The server-sent events for `target`.
    pub fn events(&self, target: &str) -> impl Iterator<Item = Value> + use<> {
        let stream = self.ask(&format!("GET {target} HTTP/1.1\r\nHost: {}\r\n\r\n", self.host()));
        let lines = BufReader::new(stream).lines().map(|line| line.unwrap());
        lines.filter_map(|line| line.strip_prefix("data: ").map(|data| serde_json::from_str(data).unwrap()))
    }

    /// Ends it with SIGTERM.
    pub fn end(mut self) {
        signal_process(self.child.id(), "TERM");
        assert_eq!(self.child.wait().unwrap().code(), Some(143));
    }
}

impl Drop for WebWatcher {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Processor time that a process has used, by the operating system's count.
pub fn processor_time(pid: u32) -> Duration {
    let text = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    // Fields after the name in parentheses, the first of which is field 3: user and system time are 14 and 15.
    let fields: Vec<&str> = text.rsplit_once(')').unwrap().1.split_whitespace().collect();
    let ticks: u64 = fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap();
    Duration::from_millis(10 * ticks)
}
