//! Whether the runs on the two machines fit: the same checks as for a process that joins a run.

use tectum::runtime::Participant;
use tectum::wire::schema_hash;

use crate::message::Hello;
use crate::seal::LinkSide;

/// What this end says about the run of `participant`.
pub fn hello_of(participant: &Participant) -> Hello {
    let identity = participant.identity();
    Hello {
        run: participant.manifest.run_id(),
        mode: participant.manifest.mode.name().to_owned(),
        schema: schema_hash(),
        scenario: identity.scenario,
        build: identity.build,
        ..Hello::default()
    }
}

/// Why the other end's run does not fit, one sentence; `None` if it does. `side` is the end that is told.
pub fn mismatch(side: LinkSide, own: &Hello, other: &Hello) -> Option<String> {
    let there = match side {
        LinkSide::Plant => "the controller's machine",
        LinkSide::Controller => "the plant's machine",
    };
    if own.build != other.build {
        let (here, other) = (&own.build, &other.build);
        return Some(format!("{there} has build {other} and this one has {here}; build both from the same source"));
    }
    if own.schema != other.schema {
        return Some(format!("{there} has samples of another layout; build both from the same source"));
    }
    if own.scenario != other.scenario {
        return Some(format!(
            "{there} runs another scenario ({:016x}, here {:016x}); start both with the same file, --seed and --ticks",
            other.scenario, own.scenario
        ));
    }
    (own.mode != other.mode).then(|| {
        let (here, other) = (&own.mode, &other.mode);
        format!("{there} runs in {other} and this one in {here}; give both the same --mode")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_difference_has_its_sentence() {
        let own = Hello { build: "0.1.0 a".into(), mode: "realtime".into(), scenario: 1, ..Hello::default() };
        assert_eq!(mismatch(LinkSide::Plant, &own, &own), None);
        for (other, word) in [
            (Hello { build: "0.1.0 b".into(), ..own.clone() }, "same source"),
            (Hello { schema: 1, ..own.clone() }, "layout"),
            (Hello { scenario: 2, ..own.clone() }, "--ticks"),
            (Hello { mode: "lockstep".into(), ..own.clone() }, "--mode"),
        ] {
            let text = mismatch(LinkSide::Controller, &own, &other).unwrap();
            assert!(text.starts_with("the plant's machine") && text.contains(word), "{text}");
        }
    }
}
