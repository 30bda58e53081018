//! What the user is told of a machine that falls silent and is heard again.

/// Silence that the user is told of, ns.
const TOLD_NS: u64 = 5_000_000_000;

/// One line when the other machine has been silent for five seconds, and one when it is heard again.
#[derive(Default)]
pub struct SilenceNotice {
    before_ns: u64,
}

impl SilenceNotice {
    /// Looks at how long nothing has been heard, ns. Returns what there is to say.
    pub fn look(&mut self, silent_ns: u64) -> Option<String> {
        let before_ns = std::mem::replace(&mut self.before_ns, silent_ns);
        match (before_ns > TOLD_NS, silent_ns > TOLD_NS) {
            (false, true) => {
                Some("tectum-link: nothing has been heard of the other machine for 5 s; waiting for it".to_owned())
            }
            (true, false) => {
                let seconds = before_ns / 1_000_000_000;
                Some(format!("tectum-link: the other machine is heard again, after {seconds} s"))
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_and_its_end_are_told_once() {
        let mut notice = SilenceNotice::default();
        let said: Vec<Option<String>> =
            [0, 2, 4, 6, 8, 12, 0, 1, 0].into_iter().map(|s| notice.look(s * 1_000_000_000)).collect();
        assert_eq!(said.iter().flatten().count(), 2, "{said:?}");
        assert!(said[3].as_ref().unwrap().contains("for 5 s") && said[6].as_ref().unwrap().ends_with("after 12 s"));
    }
}
