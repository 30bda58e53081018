//! `[link]`: a run whose plant and controller are on two machines (`tectum link`).

use std::net::IpAddr;

use serde::{Deserialize, Serialize};

use super::error::{Violation, quoted};
use super::gate::{GateConfig, is_zero};
use super::limits::MAX_AHEAD;

/// Most hosts that a scenario can name.
const MAX_HOSTS: usize = 16;

/// `[link]`: what both machines of a link have to agree on.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LinkConfig {
    /// IP addresses of the two machines. A link without a shared key uses these addresses and loopback only.
    pub hosts: Vec<String>,
    /// Commands for so many ticks after its own go with each command, from a controller that plans. The plant's gate
    /// uses them where it would hold the last command. They do so without a link, too.
    #[serde(skip_serializing_if = "is_zero")]
    pub ahead: u32,
}

impl LinkConfig {
    pub(super) fn is_usual(&self) -> bool {
        *self == Self::default()
    }

    /// Whether a link without a shared key may use `address`: loopback, or an address that the scenario names.
    pub fn names(&self, address: IpAddr) -> bool {
        let address = address.to_canonical();
        let named = |host: &String| host.parse::<IpAddr>().is_ok_and(|host| host.to_canonical() == address);
        address.is_loopback() || self.hosts.iter().any(named)
    }
}

/// Checks that hosts are addresses, and that no command ahead is for a tick in which the gate would no longer hold.
/// Names of hosts are refused, because what a name means is decided by the network.
pub(super) fn check(table: &LinkConfig, gate: &GateConfig) -> Result<(), Violation> {
    if table.ahead as usize > MAX_AHEAD {
        return Err(Violation::value("link.ahead", table.ahead, format_args!("give 0 to {MAX_AHEAD} ticks")));
    }
    if table.ahead > gate.hold_ticks {
        let hold = gate.hold_ticks;
        let remedy =
            format_args!("the gate uses such commands only while it would hold the last one, for {hold} ticks");
        return Err(Violation::value(
            "link.ahead",
            table.ahead,
            format_args!("{remedy}; give up to {hold}, or a larger gate.hold_ticks"),
        ));
    }
    if table.hosts.len() > MAX_HOSTS {
        return Err(Violation::new(
            "link.hosts",
            format_args!("has {} entries; give up to {MAX_HOSTS}", table.hosts.len()),
        ));
    }
    for (i, host) in table.hosts.iter().enumerate() {
        let key = format!("link.hosts[{i}]");
        let remedy = "give an IP address such as \"192.168.7.2\"";
        match host.parse::<IpAddr>() {
            Ok(address) if address.is_unspecified() || address.is_multicast() => {
                return Err(Violation::value(key, quoted(host), "give the address of one machine"));
            }
            Ok(_) => {}
            Err(_) => return Err(Violation::value(key, quoted(host), remedy)),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(hosts: &[&str]) -> LinkConfig {
        LinkConfig { hosts: hosts.iter().map(|host| (*host).to_owned()).collect(), ..LinkConfig::default() }
    }

    fn check_hosts(hosts: &[&str]) -> Result<(), Violation> {
        check(&table(hosts), &GateConfig::default())
    }

    #[test]
    fn loopback_and_named_addresses_need_no_key() {
        let link = table(&["192.168.7.2", "fd00::7"]);
        for (address, named) in [
            ("127.0.0.1", true),
            ("127.8.0.3", true),
            ("::1", true),
            ("192.168.7.2", true),
            ("::ffff:192.168.7.2", true),
            ("fd00::7", true),
            ("192.168.7.3", false),
            ("0.0.0.0", false),
        ] {
            assert_eq!(link.names(address.parse().unwrap()), named, "{address}");
        }
    }

    #[test]
    fn a_host_is_an_address_of_one_machine() {
        assert!(check_hosts(&["10.0.0.1", "fd00::7"]).is_ok());
        for wrong in ["robot", "10.0.0.1:7447", "0.0.0.0", "224.0.0.251", ""] {
            let Violation { key, text } = check_hosts(&["10.0.0.1", wrong]).unwrap_err();
            assert!(key == "link.hosts[1]" && text.contains("address"), "{wrong}: {text}");
        }
        assert!(check_hosts(&["10.0.0.1"; 17]).is_err());
    }

    #[test]
    fn no_command_ahead_is_for_a_tick_without_hold() {
        let gate = |hold_ticks| GateConfig { hold_ticks, ..GateConfig::default() };
        let ahead = |ahead| LinkConfig { ahead, ..LinkConfig::default() };
        assert!(check(&ahead(0), &gate(0)).is_ok() && check(&ahead(8), &gate(8)).is_ok());
        for (wrong, hold, word) in [(9, 20, "give 0 to 8 ticks"), (3, 2, "a larger gate.hold_ticks")] {
            let Violation { key, text } = check(&ahead(wrong), &gate(hold)).unwrap_err();
            assert!(key == "link.ahead" && text.contains(word), "{text}");
        }
    }
}
