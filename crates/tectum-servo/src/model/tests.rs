//! The registers against rustypot's tables, and number formats against the manuals.

use super::*;
use proptest::prelude::*;
use rustypot::servo::dynamixel::{xl330, xl430};
use rustypot::servo::feetech::sts3215;
use rustypot::servo::{Encoding, RegisterInfo};

fn named_registers(series: &ServoSeries) -> Vec<(&'static str, Register)> {
    let mut all = vec![
        ("model_number", series.model),
        ("id", series.id),
        ("baud_rate", series.baud),
        ("return_delay_time", series.return_delay),
        ("operating_mode", series.operating_mode),
        ("min_voltage_limit", series.min_voltage),
        ("max_voltage_limit", series.max_voltage),
        ("min_position_limit", series.min_position),
        ("max_position_limit", series.max_position),
        ("torque_enable", series.torque_enable),
        ("goal_velocity", series.goal_velocity),
        ("goal_position", series.goal_position),
        ("present_velocity", series.velocity),
        ("present_position", series.position),
        ("present_temperature", series.temperature),
        ("moving", series.moving),
    ];
    all.extend(match series.protocol {
        Protocol::Dynamixel => vec![
            ("status_return_level", series.response_level),
            ("temperature_limit", series.temperature_limit),
            ("shutdown", series.shutdown),
            ("hardware_error_status", series.hardware_error),
            ("profile_acceleration", series.profile_acceleration),
            ("profile_velocity", series.profile_velocity),
            ("present_current", series.load),
            ("present_input_voltage", series.voltage),
            ("velocity_limit", series.velocity_limit.expect("a limit of speed")),
            ("bus_watchdog", series.bus_watchdog.expect("a watchdog")),
        ],
        Protocol::Feetech => vec![
            ("max_temperature_limit", series.temperature_limit),
            ("unloading_condition", series.shutdown),
            ("status", series.hardware_error),
            ("acceleration", series.profile_acceleration),
            ("goal_speed", series.profile_velocity),
            ("present_load", series.load),
            ("present_voltage", series.voltage),
            ("lock", series.lock.expect("a lock")),
        ],
    });
    all
}

fn assert_agreement(series: &ServoSeries, find: impl Fn(&str) -> Option<RegisterInfo>, signs: bool) {
    for (name, ours) in named_registers(series) {
        let theirs = find(name).unwrap_or_else(|| panic!("rustypot has no {name}"));
        assert_eq!((ours.address, ours.width), (theirs.addr, theirs.size), "{}: {name}", series.name);
        let sign = match theirs.encoding {
            Encoding::TwosComplement => SignEncoding::TwosComplement,
            Encoding::SignMagnitude { sign_bit } => SignEncoding::Magnitude(sign_bit),
            _ => SignEncoding::Unsigned,
        };
        // rustypot declares the limits of the XL330 as signed and those of the XL430 as unsigned; they are
        // never negative.
        if signs && !name.ends_with("_limit") {
            assert_eq!(ours.sign, sign, "{}: {name}", series.name);
        }
    }
}

#[test]
fn registers_agree_with_rustypot() {
    assert_agreement(&DYNAMIXEL_X, xl330::register, true);
    assert_agreement(&DYNAMIXEL_X, xl430::register, true);
    assert_agreement(&FEETECH_STS, sts3215::register, true);
    for (series, info) in [(&DYNAMIXEL_X, xl330::INFO), (&DYNAMIXEL_X, xl430::INFO), (&FEETECH_STS, sts3215::INFO)] {
        assert_eq!(info.resolution, Some(4096));
        assert_eq!(info.baudrates, series.bauds, "{}", series.name);
        assert_eq!(info.factory_baudrate, Some(series.factory_baud));
        assert!(info.operating_modes.contains(&("position", series.position_mode)));
        assert!(info.operating_modes.contains(&("velocity", series.velocity_mode)));
    }
    for (name, number) in [("XL330-M288", 1200), ("XM430-W350", 1020), ("STS3215", 777)] {
        let (theirs, _) = rustypot::servo::find_model(name).expect("a model of rustypot's");
        assert_eq!(theirs, number);
        assert!(MODELS.iter().any(|model| model.name == name && model.number == number));
    }
}

#[test]
fn models_that_are_not_driven_are_told_by_name() {
    for (protocol, number, told) in [
        (Protocol::Feetech, 1029, "model 1029 (SCS0009: series SCS, with 1024 steps"),
        (Protocol::Feetech, 8965, "model 8965 (SCS215: series SCS, "),
        (Protocol::Feetech, 5, "model 5 (unknown: series SCS, "),
        (Protocol::Feetech, 10249, "model 10249 (SCS40-2: second generation"),
        (Protocol::Feetech, 0x6309, "model 25353 (unknown: series STS, by its first byte"),
        (Protocol::Feetech, 99, "model 99"),
        (Protocol::Dynamixel, 350, "model 350 (XL-320: it has 1024 steps"),
        (Protocol::Dynamixel, 12, "model 12"),
    ] {
        let text = foreign_model(protocol, number);
        assert!(text.starts_with(told), "{text}");
        let error = UnknownModel { id: 3, number, protocol }.to_string();
        assert!(error.contains(told) && error.contains(protocol.series().name), "{error}");
    }
    // No number stands in both lists, or twice in one.
    let numbers = |protocol: Protocol| {
        let of = move |model: &&ServoModel| model.protocol == protocol;
        MODELS.iter().chain(&models::FOREIGN).filter(of).map(|model| model.number).collect::<Vec<_>>()
    };
    for protocol in [Protocol::Dynamixel, Protocol::Feetech] {
        let mut all = numbers(protocol);
        all.sort_unstable();
        assert!(all.windows(2).all(|pair| pair[0] != pair[1]), "{all:?}");
    }
}

#[test]
fn the_registers_of_a_tick_are_in_one_block() {
    for series in [&DYNAMIXEL_X, &FEETECH_STS] {
        let bytes = [0; 32];
        for register in [series.position, series.velocity, series.load] {
            let held = &bytes[..usize::from(series.motion.length)];
            assert_eq!(series.motion.decode(register, held), Some(0));
        }
        for register in [series.position, series.velocity, series.load, series.voltage, series.temperature] {
            let held = &bytes[..usize::from(series.state.length)];
            assert_eq!(series.state.decode(register, held), Some(0));
        }
        assert_eq!(series.motion.decode(series.temperature, &bytes[..usize::from(series.motion.length)]), None);
    }
}

#[test]
fn signs_follow_the_manuals() {
    let position = FEETECH_STS.position;
    assert_eq!(position.encode(-100)[..2], [100, 0x80]);
    assert_eq!(position.decode(&[100, 0x80]), -100);
    assert_eq!(FEETECH_STS.load.decode(&[5, 0x04]), -5);
    assert_eq!(DYNAMIXEL_X.velocity.encode(-1), [255; 4]);
    assert_eq!(DYNAMIXEL_X.load.decode(&[0xff, 0xff]), -1);
    assert_eq!(FEETECH_STS.id.encode(1000)[0], 255);
}

proptest! {
    #[test]
    fn a_value_that_fits_is_restored(value in -1023_i32..1024) {
        for series in [&DYNAMIXEL_X, &FEETECH_STS] {
            for (_, register) in named_registers(series) {
                let fits = match register.sign {
                    SignEncoding::Unsigned => value >= 0 && (register.width > 1 || value < 256),
                    _ => register.width > 1,
                };
                if fits {
                    prop_assert_eq!(register.decode(&register.encode(value)), value);
                }
            }
        }
    }
}
