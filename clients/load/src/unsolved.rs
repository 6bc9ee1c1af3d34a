//! What to say of a measurement in which no request was solved.

use std::collections::BTreeMap;

/// Why no request was solved and what to do about it, by the most frequent outcome. None if one was solved.
pub(crate) fn unsolved(outcomes: &BTreeMap<String, u64>) -> Option<String> {
    if outcomes.contains_key("solved") {
        return None;
    }
    let Some((outcome, count)) = outcomes.iter().max_by_key(|(_, count)| **count) else {
        return Some("no request was measured".to_owned());
    };
    let requests: u64 = outcomes.values().sum();
    let advice = advice(outcome);
    Some(format!(
        "no request was solved; {count} of {requests} ended with `{outcome}`: {advice}"
    ))
}

/// What an outcome says about a whole measurement.
fn advice(outcome: &str) -> &'static str {
    match outcome {
        "unreachable" | "no answer" | "timeout" => {
            "the service is gone, or access control does not pass these requests on: with certificates, state a --zenoh file whose \
             certificate admits the vehicles load/car-0 and so on"
        }
        _ if is_too_slow(outcome) => {
            "the service or this machine is too slow for so many vehicles; lower --vehicles, raise --budget, or give the service more \
             workers"
        }
        "refused: unknown_library" => {
            "the service no longer serves the library that the requests state; start again, or use a recording of its library"
        }
        "refused: draining" => "the service ends; start it again",
        _ => "look for the reason in the service's log, and whether `egp drive` gets plans from it",
    }
}

/// Whether an outcome only says that an answer came too late, or that the service had too much to do.
pub(crate) fn is_too_slow(outcome: &str) -> bool {
    [
        "late",
        "refused: too_late",
        "refused: overloaded",
        "refused: superseded",
    ]
    .contains(&outcome)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_frequent_outcome_gives_the_advice() {
        let told = |outcomes: &[(&str, u64)]| {
            let outcomes = outcomes
                .iter()
                .map(|(name, count)| ((*name).to_owned(), *count));
            unsolved(&outcomes.collect())
        };
        assert_eq!(told(&[]).as_deref(), Some("no request was measured"));
        assert_eq!(told(&[("late", 99), ("solved", 1)]), None);
        for (outcome, advice) in [
            ("unreachable", "certificate"),
            ("no answer", "certificate"),
            ("late", "--budget"),
            ("infeasible", "log"),
        ] {
            let told = told(&[("refused: internal", 2), (outcome, 3)]).unwrap_or_default();
            assert!(told.contains(advice), "{told}");
            assert!(
                told.contains(&format!("3 of 5 ended with `{outcome}`")),
                "{told}"
            );
        }
    }
}
