//! The known models of both series, by the number in the model register.

use super::Protocol;

/// A servo reports a model number that is not one of those of its series.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "servo {id} says that it is {}, which is none of the {} that this program knows, so what its registers mean is not \
     known; docs/first-hour.md names the series that are; if it speaks the other protocol, give that",
    foreign_model(*.protocol, *.number), .protocol.series().name
)]
pub struct UnknownModel {
    /// The id.
    pub id: u8,
    /// The reported model number.
    pub number: i32,
    /// The protocol.
    pub protocol: Protocol,
}

/// What is known of a model number that is none of the series of `protocol`: the number, and the model and why its
/// registers mean something else, where that is documented.
///
/// A Feetech's model number is two bytes: the series (address 3), then the model in it (address 4).
pub fn foreign_model(protocol: Protocol, number: i32) -> String {
    let known = FOREIGN.iter().find(|known| known.protocol == protocol && i32::from(known.number) == number);
    let name = known.map_or("unknown", |known| known.name);
    let series = match (protocol, number & 0xff, number) {
        (Protocol::Dynamixel, _, 350) => "it has 1024 steps a turn and a control table of its own",
        (Protocol::Feetech, 5, _) => "series SCS, with 1024 steps a turn and the high byte of numbers first",
        (Protocol::Feetech, 6 | 8, _) => "series SM",
        (Protocol::Feetech, 9, _) if known.is_some() => "second generation of the series SCS",
        (Protocol::Feetech, 9, _) => "series STS, by its first byte; what else it has is not documented",
        (Protocol::Feetech, 10, _) => "series HLS",
        _ => return format!("model {number}"),
    };
    format!("model {number} ({name}: {series})")
}

/// A model of a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ServoModel {
    /// The manufacturer's name for it.
    pub name: &'static str,
    /// The value of its model register.
    pub number: u16,
    /// Its protocol.
    pub protocol: Protocol,
}

const fn dynamixel(name: &'static str, number: u16) -> ServoModel {
    ServoModel { name, number, protocol: Protocol::Dynamixel }
}

const fn feetech(name: &'static str, number: u16) -> ServoModel {
    ServoModel { name, number, protocol: Protocol::Feetech }
}

/// The known models. Their control tables are those of their series.
pub const MODELS: [ServoModel; 40] = [
    dynamixel("XL330-M288", 1200),
    dynamixel("XL330-M077", 1190),
    dynamixel("XC330-T181", 1210),
    dynamixel("XC330-T288", 1220),
    dynamixel("XC330-M181", 1230),
    dynamixel("XC330-M288", 1240),
    dynamixel("XL430-W250", 1060),
    dynamixel("2XL430-W250", 1090),
    dynamixel("XC430-W150", 1070),
    dynamixel("XC430-W240", 1080),
    dynamixel("XM430-W350", 1020),
    dynamixel("XM430-W210", 1030),
    dynamixel("XH430-W350", 1000),
    dynamixel("XH430-W210", 1010),
    dynamixel("XM540-W270", 1120),
    dynamixel("XM540-W150", 1130),
    dynamixel("XH540-W150", 1110),
    dynamixel("XH540-W270", 1100),
    dynamixel("XH430-V350", 1040),
    dynamixel("XH430-V210", 1050),
    dynamixel("XH540-V150", 1150),
    dynamixel("XH540-V270", 1140),
    dynamixel("XD430-T350", 1001),
    dynamixel("XD430-T210", 1011),
    dynamixel("XD540-T270", 1101),
    dynamixel("XD540-T150", 1111),
    dynamixel("XW430-T200", 1280),
    dynamixel("XW430-T333", 1270),
    dynamixel("XW540-T260", 1170),
    dynamixel("XW540-T140", 1180),
    dynamixel("XW540-H260", 1310),
    dynamixel("2XC430-W250", 1160),
    feetech("STS3215", 777),
    feetech("STS3032", 521),
    feetech("STS3040", 1033),
    feetech("STS3020", 1289),
    feetech("STS3046", 1545),
    feetech("STS3095", 2569),
    feetech("STS3250", 2825),
    feetech("SM8512BL", 11272),
];

/// Models that are known by their number and not driven, because their control tables are others.
pub(super) const FOREIGN: [ServoModel; 25] = [
    dynamixel("XL-320", 350),
    feetech("SCS0009", 1029),
    feetech("SCS2332", 2053),
    feetech("SCS45", 3077),
    feetech("SCS15", 3845),
    feetech("SCS315", 4101),
    feetech("SCS115", 6405),
    feetech("SCS215", 8965),
    feetech("SCS40", 10245),
    feetech("SCS6560", 15365),
    feetech("SM30-360M", 774),
    feetech("SM60-360M", 2054),
    feetech("SM80-360M", 3078),
    feetech("SM100-360M", 4102),
    feetech("SM150-360M", 5126),
    feetech("SM85-360M", 6150),
    feetech("SM30BL", 7688),
    feetech("SM40BLHV", 10248),
    feetech("SM45BLHV", 10760),
    feetech("SM120BLHV", 30728),
    feetech("SM200BLHV", 56328),
    feetech("SCS15-2", 3849),
    feetech("SCS225", 8969),
    feetech("SCS40-2", 10249),
    feetech("HLS3625", 3338),
];

/// The model with this number, if it is known for `protocol`.
pub fn model(protocol: Protocol, number: u16) -> Option<&'static ServoModel> {
    MODELS.iter().find(|model| model.protocol == protocol && model.number == number)
}
