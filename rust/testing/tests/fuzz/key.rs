//! Keys of queries.

use egp_wire::keys::{self, Name, Target};
use egp_wire::library_keys;

use crate::edits::Words;
use crate::fuzz;

const WORDS: Words = Words::Texts(&[
    "step", "library", "0f", "health", "ready", "metrics", "*", "$*", "@live", "a/b", "", "/",
]);

#[test]
fn a_key_names_what_it_was_made_from() {
    let name = |text: &str| text.parse::<Name>().unwrap();
    let [replica, fleet, vehicle] = ["main", "depot", "car-7"].map(name);
    let examples = [
        keys::step(&replica, &fleet, &vehicle),
        keys::health(&replica),
        keys::ready(&replica),
        keys::metrics(&replica),
        keys::live(&replica),
        keys::load(&replica),
        library_keys::library(&replica, &[0x7f; 32]),
        library_keys::library_part(&replica, &[0x7f; 32], 12),
    ];
    let examples = examples.map(String::into_bytes);
    fuzz!(examples, WORDS, |bytes: Vec<u8>| {
        let key = String::from_utf8_lossy(&bytes);
        let Some(target) = keys::parse(&key) else {
            return;
        };
        let replica = key.split('/').nth(3).unwrap();
        let rest = match target {
            Target::Step { fleet, vehicle } => {
                assert_eq!(fleet.as_str().parse(), Ok(fleet.clone()));
                assert_eq!(vehicle.as_str().parse(), Ok(vehicle.clone()));
                format!("{fleet}/{vehicle}/step")
            }
            Target::Health => "health".to_owned(),
            Target::Ready => "ready".to_owned(),
            Target::Metrics => "metrics".to_owned(),
            Target::Library { id, part } => {
                let replica = name("main");
                let mut made = match part {
                    None => library_keys::library(&replica, &id),
                    Some(part) => library_keys::library_part(&replica, &id, part),
                };
                made.split_off("egp/v1/r/main/".len())
            }
        };
        assert_eq!(key, format!("egp/v1/r/{replica}/{rest}"));
    });
}
