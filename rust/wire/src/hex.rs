//! Bytes as hexadecimal digits.

/// The bytes that a text of `2 N` hexadecimal digits states; none for another text. Lower and upper case are alike.
pub fn from_hex<const N: usize>(digits: &str) -> Option<[u8; N]> {
    let (pairs, []) = digits.as_bytes().as_chunks::<2>() else {
        return None;
    };
    if pairs.len() != N {
        return None;
    }
    let mut bytes = [0; N];
    for (byte, [high, low]) in bytes.iter_mut().zip(pairs) {
        let digit = |digit: &u8| char::from(*digit).to_digit(16);
        *byte = u8::try_from(16 * digit(high)? + digit(low)?).ok()?;
    }
    Some(bytes)
}

/// The bytes as hexadecimal digits in lower case.
pub fn hex(bytes: &[u8]) -> String {
    let digit = |value: u8| char::from_digit(value.into(), 16).unwrap_or_default();
    bytes
        .iter()
        .flat_map(|byte| [digit(byte >> 4), digit(byte & 15)])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_read_back_and_other_texts_are_none() {
        let bytes = [0x00, 0x0f, 0xa7, 0xff];
        assert_eq!(hex(&bytes), "000fa7ff");
        for text in ["000fa7ff", "000FA7FF", "000fA7Ff"] {
            assert_eq!(from_hex(text), Some(bytes), "{text}");
        }
        for text in [
            "",
            "000fa7f",
            "000fa7ff0",
            "000fa7ff00",
            "+00fa7ff",
            "000fa7fg",
            " 00fa7ff",
            "00äa7ff",
        ] {
            assert_eq!(from_hex::<4>(text), None, "{text}");
        }
        assert_eq!(from_hex::<0>(""), Some([]));
    }
}
