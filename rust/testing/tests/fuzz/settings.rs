//! Settings as TOML.

use egp_core::{Settings, VehicleParameters};

use crate::edits::Words;
use crate::fuzz;

const WORDS: Words = Words::Texts(&[
    "0",
    "-0.0",
    "-1",
    "1",
    "20",
    "0.5",
    "1e-320",
    "1e308",
    "1e400",
    "nan",
    "inf",
    "-inf",
    "true",
    "\"\"",
    "[]",
    "{}",
    "horizon",
    "cost",
    "limits",
    "9223372036854775808",
]);

#[test]
fn accepted_settings_are_valid_and_read_back() {
    let examples = [
        Settings::default().to_toml().unwrap(),
        Settings::default()
            .complete(0.05, 0.5, &VehicleParameters::FORD_ESCORT, None, None)
            .to_toml()
            .unwrap(),
        "horizon = 25\n[cost]\nlateral = 30.0".to_owned(),
    ];
    let examples = examples.map(String::into_bytes);
    fuzz!(examples, WORDS, |bytes: Vec<u8>| {
        let Ok(settings) = Settings::from_toml(&String::from_utf8_lossy(&bytes)) else {
            return;
        };
        settings.validate().unwrap();
        let valid = |mass: f64| mass > 0.0 && mass.is_finite();
        assert!(settings.mass.is_none_or(valid));
        let again = Settings::from_toml(&settings.to_toml().unwrap()).unwrap();
        assert_eq!(again, settings);
    });
}
