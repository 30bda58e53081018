//! The log of a real run: it is complete in lockstep, states its losses in real time, and is thinned on request.

mod support;

use support::{TestFolder, assert_no_debris, content::read_log, slow::run_with_a_stopped_logger, stop_process_for};
use tectum::wire::{Gap, flag};

#[test]
fn a_lockstep_log_holds_every_tick_in_order() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "1")]);
    let summary = test_folder.run(&[&scenario, "--ticks", "20000", "--json"]).wait().expect(0).json();
    assert_no_debris(&test_folder.run_folder());
    let (reader, content) = read_log(&test_folder.log_path());
    assert!(reader.finished());
    let expected: Vec<(u64, u8)> = (0..20000).flat_map(|tick| [(tick, 0), (tick, 1), (tick, 2)]).collect();
    assert!(content.order == expected, "every tick once, its samples in order");
    assert!(content.gaps.is_empty());
    let totals = reader.totals().unwrap();
    assert_eq!((totals.lost, totals.thinned, totals.complete), ([0; 3], [0; 3], true));

    for (tick, (o, c)) in content.observations.iter().zip(&content.commands).enumerate() {
        let tick = tick as u64;
        for header in [&o.header, &c.header] {
            assert_eq!((header.tick, header.sequence, header.incarnation), (tick, tick, 0));
            assert_eq!(header.scheduled_ns, tick * 50_000_000, "lockstep has virtual time");
        }
        assert_eq!(o.header.flags & flag::FIRST != 0, tick == 0);
    }
    // The command of tick k is applied in tick k, which observation k+1 reports.
    for (c, o) in content.commands.iter().zip(&content.observations[1..]) {
        assert_eq!(c.drawn, o.applied);
    }
    for (c, l) in content.commands.iter().zip(&content.learnings) {
        for i in 0..8 {
            assert_eq!(c.drawn[i], c.mean[i] + l.noise[i]);
        }
        assert_eq!(l.header.flags & flag::LEARNED != 0, l.header.tick > 0);
        assert_eq!(l.header.flags & flag::HASHED != 0, l.header.tick % 1000 == 0 || l.header.tick == 19999);
    }
    let last = content.learnings.last().unwrap();
    assert_eq!(summary["weights_hash"], format!("{:016x}", last.weights_hash));
}

#[test]
fn two_lockstep_logs_have_the_same_messages() {
    let records = || {
        let test_folder = TestFolder::new();
        let scenario = test_folder.arm_scenario(&[("every", "1")]);
        test_folder.run(&[&scenario, "--ticks", "3000", "--seed", "5"]).wait().expect(0);
        let (_, mut content) = read_log(&test_folder.log_path());
        // The run's id differs from run to run; nothing else does.
        content.observations.iter_mut().for_each(|s| s.header.run = 0);
        content.learnings.iter_mut().for_each(|s| s.header.run = 0);
        (content.observations, content.learnings)
    };
    assert!(records() == records());
}

#[test]
fn a_thinned_log_states_that_it_is_thinned() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "7")]);
    test_folder.run(&[&scenario, "--ticks", "1000"]).wait().expect(0);
    let (reader, content) = read_log(&test_folder.log_path());
    let ticks: Vec<u64> = content.observations.iter().map(|o| o.header.tick).collect();
    assert_eq!(ticks, (0..1000).step_by(7).collect::<Vec<u64>>());
    assert_eq!(reader.run("every"), Some("7"));
    let totals = reader.totals().unwrap();
    assert_eq!((totals.thinned, totals.lost), ([1000 - 143; 3], [0; 3]));
}

/// In lockstep the loop waits for the logger, so that no sample is lost.
#[test]
fn lockstep_waits_for_a_stopped_logger() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "1")]);
    let mut run = test_folder.run(&[&scenario, "--ticks", "60000", "--json"]);
    let logger = run.child_pid("tectum-logger");
    run.wait_until_ticking();
    // This is far longer than the loop needs to get 1024 samples ahead.
    stop_process_for(logger, std::time::Duration::from_millis(300));
    let summary = run.wait().expect(0).json();
    assert_eq!((&summary["ticks"], &summary["lost"]), (&60000.into(), &0.into()));
    let (_, content) = read_log(&test_folder.log_path());
    assert!(content.observations.iter().map(|o| o.header.tick).eq(0..60000));
}

/// I8. The logger is stopped for three seconds, longer than its rings last. The loop continues, and the log states
/// what it lacks.
#[test]
fn a_stopped_logger_states_which_samples_it_lost() {
    let test_folder = TestFolder::new();
    let summary = run_with_a_stopped_logger(&test_folder, 3000);
    assert_no_debris(&test_folder.run_folder());
    assert!(summary["lost"].as_u64() > Some(500), "{summary}");
    let (reader, content) = read_log(&test_folder.log_path());
    assert!(reader.finished());
    let totals = reader.totals().unwrap();
    assert!(content.order.windows(2).all(|pair| pair[0] < pair[1]), "merged by tick, once each");
    // The stated gaps are the missing samples, channel by channel.
    let sequences: [Vec<u64>; 3] = [
        content.observations.iter().map(|s| s.header.sequence).collect(),
        content.commands.iter().map(|s| s.header.sequence).collect(),
        content.learnings.iter().map(|s| s.header.sequence).collect(),
    ];
    for (channel, sequences) in sequences.iter().enumerate() {
        let stated: Vec<&Gap> = content.gaps.iter().filter(|g| g.channel == channel as u64).collect();
        let lost: u64 = stated.iter().map(|g| g.count).sum();
        assert_eq!(lost, totals.lost[channel]);
        assert_eq!(Some(totals.lost[channel]), summary["lost_by_channel"][channel].as_u64());
        assert!(lost > 500, "channel {channel}: {lost}");
        let mut expected = 0;
        let mut missing = Vec::new();
        for &sequence in sequences {
            if sequence > expected {
                missing.push((expected, sequence - expected));
            }
            expected = sequence + 1;
        }
        assert_eq!(missing, stated.iter().map(|g| (g.first, g.count)).collect::<Vec<_>>());
    }
}
