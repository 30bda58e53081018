//! The channel from trackers to the bridge: a tracker's ends, and the bridge's.

use super::boards::{BoardReader, CONTROL_PAGE, open_board, read_board};
use super::domain::{Domain, DomainName};
use super::participant_ports::{open_channel, open_domain};
use super::ports::{Receiver, Sender};
use super::{CONTROL, ChannelError, Identity, LOOP_BUFFER, VISION_BUFFER};
use crate::wire::{ChannelNames, Control, Observation, Role, Vision};

/// A tracker's ends: it sends what it sees, and may read the plant's observations.
pub struct TrackerPorts {
    /// Vision samples, to the bridge.
    pub vision: Sender<Vision>,
    /// Observations, the newest two.
    pub observation: Receiver<Observation>,
    /// The launcher's board.
    pub control: BoardReader<Control>,
    _domain: Domain,
}

impl TrackerPorts {
    /// Joins the run as a tracker. A tracker may join and leave at any time, also by SIGKILL.
    ///
    /// # Errors
    /// As for [`PlantPorts::open`](super::PlantPorts::open); also when the run has no channel for trackers, or
    /// no place for another tracker.
    pub fn open(name: &DomainName, identity: &Identity, channels: &ChannelNames) -> Result<Self, ChannelError> {
        let domain = open_domain(name, identity, "tracker")?;
        Ok(Self {
            vision: Sender::new(&channels.vision, open_channel(&domain, &channels.vision)?)?,
            observation: Receiver::new(
                &channels.observation,
                open_channel(&domain, &channels.observation)?,
                LOOP_BUFFER,
            )?,
            control: read_board(&open_board(&domain, CONTROL)?, CONTROL_PAGE)?,
            _domain: domain,
        })
    }
}

/// The bridge's end of the trackers' channel.
pub struct VisionReceiver {
    vision: Receiver<Vision>,
    _domain: Domain,
}

impl VisionReceiver {
    /// Opens it.
    ///
    /// # Errors
    /// As for [`PlantPorts::open`](super::PlantPorts::open).
    pub fn open(name: &DomainName, identity: &Identity, channels: &ChannelNames) -> Result<Self, ChannelError> {
        let domain = open_domain(name, identity, Role::Plant.name())?;
        let vision = Receiver::new(&channels.vision, open_channel(&domain, &channels.vision)?, VISION_BUFFER)?;
        Ok(Self { vision, _domain: domain })
    }

    /// The next sample that was not received yet, from any tracker. A sample that cannot be received, for
    /// example because its tracker has just died, counts as none: the loss of a tracker is no reason to end a
    /// run.
    pub fn receive(&mut self) -> Option<Vision> {
        self.vision.receive().ok().flatten()
    }
}
