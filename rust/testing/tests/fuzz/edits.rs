//! Random edits of valid examples, because random bytes alone fail the first check of a decoder.

use bolero::TypeGenerator;

/// The position of an edit in the example, as a fraction of its length in units of 1/65536.
type Place = u16;

/// The number of an example, and the edits to it.
#[derive(Clone, Debug, TypeGenerator)]
pub struct Edits {
    example: u8,
    #[generator(bolero::produce::<Vec<Edit>>().with().len(0_usize..5))]
    edits: Vec<Edit>,
}

#[derive(Clone, Debug, TypeGenerator)]
enum Edit {
    /// Changes one bit.
    Flip { at: Place, bit: u8 },
    /// Inserts any bytes.
    Insert { at: Place, bytes: Vec<u8> },
    /// Removes some bytes.
    Remove { at: Place, length: u8 },
    /// Inserts a second copy of some bytes.
    Copy { from: Place, length: u8, at: Place },
    /// Removes everything from here on.
    Cut { at: Place },
    /// Replaces the bytes at a position by a word of the dictionary.
    Replace { at: Place, word: u8 },
}

/// Words that decoders of one kind treat specially.
pub enum Words {
    /// Doubles at the borders of domains; each replaces eight bytes.
    Doubles,
    /// Texts; each replaces a whole number or name.
    Texts(&'static [&'static str]),
}

const DOUBLES: [f64; 12] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    1e-6,
    1e9,
    f64::MAX,
    f64::MIN_POSITIVE,
    5e-324,
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
];

impl Edits {
    /// The chosen example after the edits; one choice is an empty example.
    pub fn apply(&self, examples: &[Vec<u8>], words: &Words) -> Vec<u8> {
        let choice = usize::from(self.example) % (examples.len() + 1);
        let mut bytes = examples.get(choice).cloned().unwrap_or_default();
        for edit in &self.edits {
            edit.apply(&mut bytes, words);
        }
        bytes
    }
}

impl Edit {
    fn apply(&self, bytes: &mut Vec<u8>, words: &Words) {
        let end = bytes.len();
        let index = |place: Place| usize::from(place) * (end + 1) / (usize::from(Place::MAX) + 1);
        let range =
            |place: Place, length: u8| index(place)..end.min(index(place) + usize::from(length));
        match self {
            Self::Flip { at, bit } => {
                if let Some(byte) = bytes.get_mut(index(*at)) {
                    *byte ^= 1 << (bit % 8);
                }
            }
            Self::Insert { at, bytes: new } => {
                let at = index(*at);
                bytes.splice(at..at, new.iter().copied());
            }
            Self::Remove { at, length } => drop(bytes.drain(range(*at, *length))),
            Self::Copy { from, length, at } => {
                let (copy, at) = (bytes[range(*from, *length)].to_vec(), index(*at));
                bytes.splice(at..at, copy);
            }
            Self::Cut { at } => bytes.truncate(index(*at)),
            Self::Replace { at, word } => match words {
                Words::Doubles => {
                    let word = DOUBLES[usize::from(*word) % DOUBLES.len()];
                    bytes.splice(range(*at, 8), word.to_le_bytes());
                }
                Words::Texts(texts) => {
                    let word = texts[usize::from(*word) % texts.len()];
                    let (before, after) = bytes.split_at(index(*at));
                    let is_part =
                        |byte: &u8| byte.is_ascii_alphanumeric() || b"._+-".contains(byte);
                    let left = before.iter().rev().take_while(|byte| is_part(byte)).count();
                    let right = after.iter().take_while(|byte| is_part(byte)).count();
                    let at = before.len();
                    bytes.splice(at - left..at + right, word.bytes());
                }
            },
        }
    }
}
