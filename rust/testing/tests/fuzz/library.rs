//! Library files that are sealed again after each edit, because otherwise only the check of the seal would be tested.

use egp_core::library::{encode, hex};
use egp_core::{GpInput, Kernel, Library, VarianceScratch};
use egp_testing::libraries;
use sha2::{Digest, Sha256};

use crate::edits::Words;
use crate::fuzz;

const DIGITS: usize = 64;

/// The largest magnitude of each GP input in a request.
const REQUESTED: GpInput = GpInput::new(150.0, 150.0, 50.0, 1.6, 1e6, 20.0);

/// The digits that seal a file written by [`encode`].
fn seal_of(file: &[u8]) -> Vec<u8> {
    let key = br#"\"sha256\":\""#;
    let found = file.windows(key.len()).position(|window| window == key);
    let start = found.unwrap() + key.len();
    file[start..start + DIGITS].to_vec()
}

/// `file` with the digits of the first of `seals` that is left replaced by those that seal it as it now is.
fn sealed(mut file: Vec<u8>, seals: &[Vec<u8>]) -> Vec<u8> {
    let place = |seal: &Vec<u8>| file.windows(DIGITS).position(|digits| digits == seal);
    if let Some(start) = seals.iter().find_map(place) {
        file[start..start + DIGITS].fill(b'0');
        let seal = hex(&Sha256::digest(&file));
        file[start..start + DIGITS].copy_from_slice(seal.as_bytes());
    }
    file
}

#[test]
fn an_accepted_library_predicts_finite_numbers() {
    let examples =
        Kernel::ALL.map(|kernel| encode(&libraries::spec(kernel, &[0.5, 1.1], 6, 3)).unwrap());
    let seals = examples.each_ref().map(|file| seal_of(file));
    for (file, seal) in examples.iter().zip(&seals) {
        assert_eq!(&sealed(file.clone(), std::slice::from_ref(seal)), file);
    }
    fuzz!(examples, Words::Doubles, |bytes: Vec<u8>| {
        let bytes = sealed(bytes, &seals);
        let Ok(library) = Library::from_bytes(&bytes) else {
            return;
        };
        assert_eq!(library.id(), <[u8; 32]>::from(Sha256::digest(&bytes)));
        assert!(library.dt() > 0.0 && !library.members().is_empty());
        for member in library.members() {
            let (lower, upper) = member.envelope();
            assert!(
                lower
                    .iter()
                    .zip(&upper)
                    .all(|(lower, upper)| lower <= upper)
            );
            let centre = 0.5 * lower + 0.5 * upper;
            let centre = centre.zip_map(&REQUESTED, |value, limit| value.clamp(-limit, limit));
            assert!(member.mean(&centre).iter().all(|value| value.is_finite()));
            let variance = member.variance(&centre, &mut VarianceScratch::default());
            assert!(
                variance
                    .iter()
                    .all(|value| value.is_finite() && *value >= 0.0)
            );
        }
    });
}
