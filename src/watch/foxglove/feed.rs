//! From samples to messages: each sample as it is, and its views, as they stand in a packed log.

use super::protocol::{FoxgloveChannel, advertise, server_info};
use crate::log::{LogRecord, SampleViews, ViewFacts};
use crate::wire::{ChannelNames, Command, Learning, Observation, Sample};

/// Ids of a run's channels begin at its number times this.
const IDS_A_RUN: u32 = 1000;
/// CDR encapsulation, plain and little-endian, before a sample's bytes.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];
/// Channels before the views.
const SAMPLES: usize = 3;

/// The channels of a run, and what is needed to fill them.
pub(super) struct SampleFeed {
    name: String,
    generation: u64,
    channels: Vec<FoxgloveChannel>,
    views: SampleViews,
    shift_ns: i128,
    data: Vec<u8>,
}

impl SampleFeed {
    /// The channels of the run called `name`, the `generation`th that is watched.
    pub fn new(facts: ViewFacts, names: &ChannelNames, generation: u64, name: &str) -> Self {
        let first = (generation as u32).wrapping_mul(IDS_A_RUN);
        let shift_ns = facts.shift_ns;
        let views = SampleViews::new(facts);
        let mut channels = vec![
            of_sample::<Observation>(&names.observation),
            of_sample::<Command>(&names.command),
            of_sample::<Learning>(&names.learning),
        ];
        channels.extend(views.channels().iter().map(|view| FoxgloveChannel {
            id: 0,
            topic: view.topic.to_owned(),
            encoding: "cdr",
            schema_name: view.schema_name.to_owned(),
            schema_encoding: "ros2msg",
            schema: view.schema.clone(),
        }));
        channels.iter_mut().zip(first..).for_each(|(channel, id)| channel.id = id);
        Self { name: name.to_owned(), generation, channels, views, shift_ns, data: Vec::new() }
    }

    /// The messages that tell a client of this run.
    pub fn introduction(&self) -> [String; 2] {
        [server_info(&format!("tectum {}", self.name), &self.generation.to_string()), advertise(&self.channels)]
    }

    /// The ids of the channels.
    pub fn ids(&self) -> Vec<u32> {
        self.channels.iter().map(|channel| channel.id).collect()
    }

    /// Hands the messages of a sample to `emit`: the channel's id, wall time, and the encoded message.
    pub fn take(&mut self, record: &LogRecord, mut emit: impl FnMut(u32, u64, &[u8])) {
        let (index, bytes) = match record {
            LogRecord::Observation(sample) => (0, bytemuck::bytes_of(sample)),
            LogRecord::Command(sample) => (1, bytemuck::bytes_of(sample)),
            LogRecord::Learning(sample) => (2, bytemuck::bytes_of(sample)),
            LogRecord::Gap(_) => return,
        };
        let published = record.header().map_or(0, |header| header.published_ns);
        let ns = (i128::from(published) + self.shift_ns).clamp(0, i128::from(u64::MAX)) as u64;
        self.data.clear();
        self.data.extend(ENCAPSULATION);
        self.data.extend(bytes);
        emit(self.channels[index].id, ns, &self.data);
        let channels = &self.channels;
        let sent = self.views.take(record, |message| -> Result<(), std::convert::Infallible> {
            emit(channels[SAMPLES + message.channel].id, message.ns, message.data);
            Ok(())
        });
        let Ok(()) = sent;
    }
}

fn of_sample<S: Sample>(name: &str) -> FoxgloveChannel {
    FoxgloveChannel {
        id: 0,
        topic: format!("/{name}"),
        encoding: "cdr",
        schema_name: S::ROS_NAME.to_owned(),
        schema_encoding: "ros2msg",
        schema: S::ros2msg(),
    }
}
