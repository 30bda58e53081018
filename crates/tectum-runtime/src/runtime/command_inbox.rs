//! Receives commands for the plant's loop and sorts them by tick.

use hdrhistogram::Histogram;

use crate::channel::{ChannelError, Receiver};
use crate::stats::histogram;
use crate::wire::Command;

/// The plant's inbox for commands.
#[derive(Debug)]
pub(super) struct CommandInbox {
    /// The sequence number of the next command, if none is lost.
    pub expected: u64,
    /// The number of observations sent. No controller has sent more commands, so a command with a greater number is
    /// not believed: it would make all later ones look like duplicates.
    pub observed: u64,
    /// The command of the tick that was polled for last.
    command: Option<Command>,
    /// Commands that arrived after their tick, since the last call of [`take_late`](Self::take_late).
    late: u64,
    failure: Option<ChannelError>,
    /// Real time: from the sensing of an observation to the sending of its command, ns.
    pub response_times: Histogram<u64>,
    real: bool,
}

impl CommandInbox {
    /// An inbox whose next command has the sequence number `expected`, after `observed` observations; `real` in real
    /// time.
    pub fn new(expected: u64, observed: u64, real: bool) -> Self {
        Self { expected, observed, command: None, late: 0, failure: None, response_times: histogram(), real }
    }

    /// Receives from `channel`, and returns whether the command of `tick` has arrived. Commands of other ticks
    /// are counted as late and dropped. In lockstep only duplicates and commands of later ticks can follow the
    /// one of `tick`, so the channel is not read again once it has arrived. Also returns true when the channel
    /// failed, to end the caller's wait.
    pub fn poll_for(&mut self, channel: &Receiver<Command>, tick: u64) -> bool {
        while self.real || self.command.is_none() {
            match channel.receive() {
                Ok(None) => return self.command.is_some(),
                // A duplicate, sent again by a restarted controller.
                Ok(Some(command)) if command.header.sequence < self.expected => {}
                Ok(Some(command)) if command.header.sequence >= self.observed => {}
                Ok(Some(command)) => {
                    self.expected = command.header.sequence + 1;
                    if self.real {
                        // The command carries the instant at which its observation had been sensed.
                        let header = &command.header;
                        self.response_times.saturating_record(header.published_ns.saturating_sub(header.sensed_ns));
                    }
                    if command.header.tick == tick {
                        self.command = Some(command);
                    } else {
                        self.late += 1;
                    }
                }
                Err(error) => {
                    // The wait ends here; `check` returns the error.
                    self.failure = Some(error);
                    return true;
                }
            }
        }
        true
    }

    /// Puts in the command that the process's predecessor had received last.
    pub fn put(&mut self, command: Command) {
        self.expected = command.header.sequence + 1;
        self.command = Some(command);
    }

    /// The failure of the channel, if it has failed.
    pub fn check(&mut self) -> Result<(), ChannelError> {
        self.failure.take().map_or(Ok(()), Err)
    }

    /// Takes the command of the tick that was polled for last, if it has arrived.
    pub fn take(&mut self) -> Option<Command> {
        self.command.take()
    }

    /// The number of late commands since the last call.
    pub fn take_late(&mut self) -> u64 {
        std::mem::take(&mut self.late)
    }

    /// Counts the command that has arrived, if any, as late: the plant has already acted without it.
    pub fn drop_as_late(&mut self) {
        self.late += u64::from(self.command.take().is_some());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::channel::{ControllerPorts, DomainName, Identity, PlantPorts, RunServices};
    use crate::wire::ChannelNames;

    /// A command with the greatest number of all is not believed, so that those of the real controller still count.
    #[test]
    fn a_forged_number_does_not_silence_the_controller() {
        let name = DomainName::of(u64::from(std::process::id()) << 32 ^ 0x1b0c);
        let (identity, channels) = (Identity { schema: 1, scenario: 2, build: "b".into() }, ChannelNames::default());
        let _services = RunServices::create(&name, &identity, &channels, None, false).unwrap();
        let (plant, _board) = PlantPorts::open(&name, &identity, &channels).unwrap();
        let (controller, _board) = ControllerPorts::open(&name, &identity, &channels).unwrap();
        let mut inbox = CommandInbox::new(0, 0, true);
        for tick in 0..3 {
            inbox.observed = tick + 1;
            let mut command = Command::default();
            (command.header.tick, command.header.sequence) = (tick, if tick == 1 { u64::MAX } else { tick });
            controller.command.send(&command).unwrap();
            assert_eq!(inbox.poll_for(&plant.command, tick), tick != 1, "{tick}");
            inbox.take();
        }
    }
}
