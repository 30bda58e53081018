//! A pseudo-terminal with a program in it, and what the program shows there.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::os::fd::OwnedFd;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{LocalModes, Termios, Winsize, tcgetattr, tcsetwinsize};

use super::{Process, TestFolder};

/// A pseudo-terminal.
pub struct TestTerminal {
    ours: OwnedFd,
    theirs: OwnedFd,
    received: Arc<Mutex<Vec<u8>>>,
    /// Whether the reader is to end, and the reader.
    closing: Arc<AtomicBool>,
    reader: JoinHandle<()>,
}

impl TestTerminal {
    /// A terminal of this size, columns and rows.
    pub fn new(size: [u16; 2]) -> Self {
        let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&ours).unwrap();
        unlockpt(&ours).unwrap();
        let name = ptsname(&ours, Vec::new()).unwrap();
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let theirs = rustix::fs::open(name.to_str().unwrap(), flags, Mode::empty()).unwrap();
        let received = Arc::new(Mutex::new(Vec::new()));
        let (mut file, into) = (File::from(ours.try_clone().unwrap()), Arc::clone(&received));
        let closing = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&closing);
        // Ends when the last program has closed the terminal, or the terminal is to hang up.
        let reader = std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            let limit = Timespec { tv_sec: 0, tv_nsec: 20_000_000 };
            while !ends.load(Ordering::Relaxed) {
                if poll(&mut [PollFd::new(&file, PollFlags::IN)], Some(&limit)) == Ok(0) {
                    continue;
                }
                let Ok(n @ 1..) = file.read(&mut bytes) else { break };
                into.lock().unwrap().extend(&bytes[..n]);
            }
        });
        let terminal = Self { ours, theirs, received, closing, reader };
        terminal.resize(size);
        terminal
    }

    /// Starts `tectum` in it, as the leader of a session of its own, whose terminal it is. With `colours` false,
    /// `NO_COLOR` is set.
    pub fn start(&self, folder: &TestFolder, arguments: &[&str], colours: bool) -> Process {
        self.start_program(super::TECTUM, folder, arguments, colours)
    }

    /// Starts another program in it in the same way.
    pub fn start_program(&self, program: &str, folder: &TestFolder, arguments: &[&str], colours: bool) -> Process {
        let mut command = Command::new("setsid");
        command.arg("-c").arg(program).args(arguments).env("TERM", "xterm").current_dir(folder.path());
        if colours {
            command.env_remove("NO_COLOR");
        } else {
            command.env("NO_COLOR", "1");
        }
        let stdio = || Stdio::from(self.theirs.try_clone().unwrap());
        command.stdin(stdio()).stdout(stdio()).stderr(stdio());
        Process::of_command(command, folder.run_folder())
    }

    /// Closes it, as a window that is closed or a connection that is lost: its programs get SIGHUP, and can neither
    /// read nor write any more.
    pub fn hang_up(self) {
        self.closing.store(true, Ordering::Relaxed);
        self.reader.join().unwrap();
    }

    /// Gives it another size.
    pub fn resize(&self, [columns, rows]: [u16; 2]) {
        let size = Winsize { ws_col: columns, ws_row: rows, ws_xpixel: 0, ws_ypixel: 0 };
        tcsetwinsize(&self.ours, size).unwrap();
    }

    /// Presses keys.
    pub fn press(&self, keys: &str) {
        rustix::io::write(&self.ours, keys.as_bytes()).unwrap();
    }

    /// Its settings.
    pub fn settings(&self) -> Termios {
        tcgetattr(&self.theirs).unwrap()
    }

    /// All that was written to it.
    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.received.lock().unwrap()).into_owned()
    }

    /// What it shows now, line by line.
    pub fn screen(&self) -> String {
        screen(&self.text())
    }

    /// Requires that it is as a shell expects it: echo and lines are on, the cursor is there, and the alternate screen
    /// is left.
    #[track_caller]
    pub fn assert_restored(&self) {
        let modes = self.settings().local_modes;
        assert!(modes.contains(LocalModes::ECHO | LocalModes::ICANON | LocalModes::ISIG), "{modes:?}");
        for (on, off) in [("\x1b[?1049h", "\x1b[?1049l"), ("\x1b[?25l", "\x1b[?25h")] {
            let restored = |text: &str| text.contains(on) && text.rfind(off) > text.rfind(on);
            // The last bytes of a program that has ended may still be on their way to the reader.
            let end = Instant::now() + Duration::from_secs(20);
            while !restored(&self.text()) && Instant::now() < end {
                std::thread::park_timeout(Duration::from_millis(5));
            }
            assert!(restored(&self.text()), "{off:?} after {on:?}:\n{:?}", self.text());
        }
    }
}

/// What a terminal shows after `text`: the few sequences that tectum writes.
fn screen(text: &str) -> String {
    let mut cells: BTreeMap<(usize, usize), char> = BTreeMap::new();
    let (mut row, mut column) = (0, 0);
    let mut rest = text.chars();
    while let Some(c) = rest.next() {
        match c {
            '\x1b' if rest.clone().next() == Some('[') => {
                rest.next();
                let mut parameters = String::new();
                let last = rest.by_ref().find(|c| {
                    let ends = c.is_ascii_alphabetic();
                    if !ends {
                        parameters.push(*c);
                    }
                    ends
                });
                match last {
                    Some('H') => {
                        let (y, x) = parameters.split_once(';').unwrap();
                        (row, column) = (y.parse::<usize>().unwrap() - 1, x.parse::<usize>().unwrap() - 1);
                    }
                    Some('J' | 'h' | 'l') if matches!(parameters.as_str(), "2" | "?1049") => cells.clear(),
                    Some('K') => cells.retain(|at, _| at.0 != row || at.1 < column),
                    _ => {}
                }
            }
            '\r' => column = 0,
            '\n' => row += 1,
            c => {
                cells.insert((row, column), c);
                column += 1;
            }
        }
    }
    let last = cells.keys().last().map_or(0, |at| at.0);
    let line = |row: usize| {
        let end = cells.range((row, 0)..(row, usize::MAX)).last().map_or(0, |(at, _)| at.1 + 1);
        (0..end).map(|column| cells.get(&(row, column)).copied().unwrap_or(' ')).collect::<String>() + "\n"
    };
    (0..=last).map(line).collect()
}
