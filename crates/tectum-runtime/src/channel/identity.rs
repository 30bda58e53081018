//! The handshake: a process may join a run only if schema, scenario and build are those of the run.

use iceoryx2::prelude::*;
use xxhash_rust::xxh3::xxh3_64;

use super::{ChannelError, Mismatch};

/// The values that must be equal for a process to join a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    /// Hash over the layout of all samples.
    pub schema: u64,
    /// Hash of the resolved scenario.
    pub scenario: u64,
    /// Package version and commit.
    pub build: String,
}

impl Identity {
    /// Hash of the build, as published on a board.
    pub fn build_hash(&self) -> u64 {
        xxh3_64(self.build.as_bytes())
    }

    fn attributes(&self) -> [(&'static str, String); 3] {
        [
            ("schema", format!("{:016x}", self.schema)),
            ("scenario", format!("{:016x}", self.scenario)),
            ("build", self.build.clone()),
        ]
    }

    /// The attributes of the run's first service.
    pub(super) fn specifier(&self) -> AttributeSpecifier {
        self.attributes().iter().fold(AttributeSpecifier::new(), |spec, (key, value)| {
            let key = (*key).try_into().expect("a short key");
            let value = value.as_str().try_into().expect("a hash or a version");
            spec.define(&key, &value).expect("three attributes of the eight that are allowed")
        })
    }

    /// Compares with the attributes of the run's first service.
    ///
    /// # Errors
    /// [`ChannelError::Mismatch`] names the first difference.
    pub(super) fn check(&self, role: &'static str, run: &AttributeSet) -> Result<(), ChannelError> {
        for (what, ours) in self.attributes() {
            let key = what.try_into().expect("a short key");
            let theirs = run.key_value(&key, 0).map(|v| v.to_string()).unwrap_or_default();
            if theirs != ours {
                return Err(ChannelError::Mismatch(Mismatch { role, what, ours, theirs }));
            }
        }
        Ok(())
    }
}
