//! Tags are HMAC-SHA-256 as documented, and belong to one question only.

use egp_wire::keys::Name;
use egp_wire::{KeyError, KeyRing, Seal, VehicleKey, hex};

fn name(text: &str) -> Name {
    text.parse().unwrap()
}

fn key() -> VehicleKey {
    let text = format!(
        "# a comment\n\n depot/car-7  {}\ndepot/car-8 {}\n",
        "0b".repeat(32),
        "AA".repeat(32)
    );
    let ring = KeyRing::parse(&text).unwrap();
    ring.get(&name("depot"), &name("car-7")).unwrap().clone()
}

/// The expected tags come from Python's `hmac`; `tests/service/test_security.py` computes them again.
#[test]
fn tags_are_those_of_another_implementation() {
    let question = key().question("egp/v1/r/main/depot/car-7/step", 3, 258, b"request");
    assert_eq!(
        hex(&question),
        "b740a3d3ddd72e43f7162c04e6c79eb2f114d0cd7d1b4e4ed6968c89b2d7ef69"
    );
    assert_eq!(
        hex(&key().answer(&question, b"reply")),
        "83a6e78a3cdad0a62d4581aebd84cde8d71b04e2b653f0047417898cc4d94645"
    );
}

#[test]
fn a_seal_belongs_to_one_question() {
    let key = key();
    let seal = Seal {
        vehicle: (name("depot"), name("car-7")),
        run: 3,
        number: 9,
        tag: key.question("a/b", 3, 9, b"payload"),
    };
    let read = Seal::decode(&seal.encode()).unwrap();
    assert_eq!(read, seal);
    assert!(key.is_question("a/b", &seal, b"payload"));
    assert!(!key.is_question("a/c", &seal, b"payload"));
    assert!(!key.is_question("a/b", &seal, b"payloae"));
    for other in [
        Seal {
            run: 4,
            ..seal.clone()
        },
        Seal {
            number: 10,
            ..seal.clone()
        },
    ] {
        assert!(!key.is_question("a/b", &other, b"payload"));
    }
    assert_eq!(Seal::decode(b"\xff"), None);
    assert_eq!(Seal::decode(b""), None);
}

#[test]
fn an_answer_belongs_to_one_question() {
    let key = key();
    let [first, second] = [1, 2].map(|number| key.question("a/b", 3, number, b"payload"));
    let tag = key.answer(&first, b"reply");
    assert!(key.is_answer(&first, b"reply", &tag));
    assert!(!key.is_answer(&second, b"reply", &tag));
    assert!(!key.is_answer(&first, b"replz", &tag));
    assert!(!key.is_answer(&first, b"reply", &tag[..31]));
    assert!(!key.is_answer(&first, b"reply", b""));
}

#[test]
fn a_text_without_keys_is_an_error_that_shows_none() {
    let digits = "0b".repeat(32);
    for (text, error) in [
        (format!("depot/car-7 {}", &digits[1..]), KeyError::Line(1)),
        (format!("\ndepot {digits}"), KeyError::Line(2)),
        (format!("depot/car-7 {}+1", &digits[2..]), KeyError::Line(1)),
        (
            format!("depot/a {digits}\ndepot/a {digits}"),
            KeyError::Twice(2),
        ),
    ] {
        assert_eq!(KeyRing::parse(&text), Err(error.clone()), "{text}");
        assert!(!error.to_string().contains("0b0b"));
    }
    assert!(!format!("{:?}", key()).contains("11"));
    let none = KeyRing::default();
    let missing = none.get(&name("depot"), &name("car-7"));
    assert!(missing.unwrap_err().to_string().contains("depot/car-7"));
}

#[test]
fn a_file_of_keys_is_read_and_no_key_is_shown() {
    let file = std::env::temp_dir().join(format!("egp-wire-{}.keys", std::process::id()));
    std::fs::write(&file, format!("depot/car-7 {}\n", "0b".repeat(32))).unwrap();
    let ring = KeyRing::read(&file);
    std::fs::write(&file, "depot/car-7 0b\n").unwrap();
    let short = KeyRing::read(&file).unwrap_err().to_string();
    std::fs::remove_file(&file).unwrap();
    assert_eq!(
        ring.unwrap().get(&name("depot"), &name("car-7")),
        Ok(&key())
    );
    let file = file.display().to_string();
    assert!(short.starts_with(&file), "{short}");
    let missing = KeyRing::read(file.as_ref()).unwrap_err().to_string();
    assert!(missing.contains(&file), "{missing}");
    assert_eq!(format!("{:?}", key()), "VehicleKey(..)");
}
