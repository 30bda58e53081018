//! The channels without processes: handshake, overflow, and removal of a domain.

use tectum::channel::{
    ChannelError, ControllerPorts, DomainName, Identity, LOG_BUFFER, LoggerPorts, PlantPorts, RunServices,
};
use tectum::wire::{ChannelNames, Observation};

fn identity() -> Identity {
    Identity { schema: 1, scenario: 2, build: "0.1.0+abc".into() }
}

fn domain(salt: u64) -> DomainName {
    DomainName::of(u64::from(std::process::id()) << 32 | 0xc4a0 | salt << 16)
}

/// Schema, scenario and build are each compared, and the error names the difference.
#[test]
fn the_handshake_compares_schema_scenario_and_build() {
    let (name, channels) = (domain(1), ChannelNames::default());
    let _services = RunServices::create(&name, &identity(), &channels, None, false).unwrap();
    for (identity_of_process, what, ours, theirs) in [
        (Identity { schema: 9, ..identity() }, "schema", "0000000000000009", "0000000000000001"),
        (Identity { scenario: 9, ..identity() }, "scenario", "0000000000000009", "0000000000000002"),
        (Identity { build: "0.2.0+def".into(), ..identity() }, "build", "0.2.0+def", "0.1.0+abc"),
    ] {
        let Err(ChannelError::Mismatch(mismatch)) = PlantPorts::open(&name, &identity_of_process, &channels) else {
            panic!("{what} must be compared");
        };
        assert_eq!((mismatch.what, mismatch.ours.as_str(), mismatch.theirs.as_str()), (what, ours, theirs));
        assert_eq!(
            mismatch.to_string(),
            format!(
                "the plant does not fit the run: its {what} is {ours}, the run's is {theirs}; \
                 start it from the same build and with the same scenario as the run"
            )
        );
    }
    PlantPorts::open(&name, &identity(), &channels).unwrap();
}

/// A reader that does not read loses the oldest samples. The writer is never blocked.
#[test]
fn a_full_reader_loses_its_oldest_samples() {
    let (name, channels) = (domain(2), ChannelNames::default());
    let _services = RunServices::create(&name, &identity(), &channels, None, false).unwrap();
    let (mut plant, _board) = PlantPorts::open(&name, &identity(), &channels).unwrap();
    let (controller, _board) = ControllerPorts::open(&name, &identity(), &channels).unwrap();
    let (mut logger, _board) = LoggerPorts::open(&name, &identity(), &channels).unwrap();
    let mut observation = Observation::default();
    let sent = 3 * LOG_BUFFER as u64;
    for tick in 0..sent {
        observation.header.tick = tick;
        plant.observation.send(&observation).unwrap();
        plant.log.append(&observation);
    }
    let received = |receive: &mut dyn FnMut() -> Option<Observation>| {
        std::iter::from_fn(receive).map(|o| o.header.tick).collect::<Vec<u64>>()
    };
    let newest = received(&mut || controller.observation.receive().unwrap());
    assert_eq!(newest, [sent - 2, sent - 1], "the loop reads the newest");
    let log = received(&mut || logger.observation.receive());
    assert!(log.len() >= LOG_BUFFER && log.is_sorted(), "{log:?}");
    assert_eq!(log.last(), Some(&(sent - 1)));
}

#[test]
fn a_domain_is_removed_with_its_services() {
    let (name, channels) = (domain(3), ChannelNames::default());
    let files = || {
        let entries = std::fs::read_dir("/dev/shm").unwrap().flatten();
        let prefix = name.prefix();
        let prefix = prefix.trim_end_matches('_').to_owned();
        entries.filter(|e| e.file_name().to_string_lossy().starts_with(&prefix)).count()
    };
    let services = RunServices::create(&name, &identity(), &channels, None, false).unwrap();
    assert!(files() > 0);
    drop(services);
    assert_eq!(files(), 0);
    let Err(ChannelError::Removed { root }) = PlantPorts::open(&name, &identity(), &channels) else {
        panic!("there is no run any more");
    };
    assert_eq!(root, name.root());
    tectum::channel::remove_domain(&name);
}
