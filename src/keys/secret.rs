//! Secrets of keys: 256 random bits, and their hash.
//!
//! The hash is SHA-256, once and without salt. A slow hash protects passwords, because people
//! choose them and few guesses find them. Nobody guesses 256 random bits, however cheap a guess is,
//! so a slow hash would only slow each call down. A salt would hide equal secrets, but equal
//! secrets do not occur.

use std::fmt;
use std::fmt::Write;

use sha2::{Digest, Sha256};

use super::KeyError;

/// Prefix of each secret, so that people and scanners recognise one.
const PREFIX: &str = "gfx_";
const BYTES: usize = 32;
/// Hexadecimal digits after the prefix.
const DIGITS: usize = 2 * BYTES;

/// The secret of a new key. It is never stored, and shown once.
#[derive(Clone, PartialEq, Eq)]
pub struct Secret(String);

impl Secret {
    /// A new random secret.
    ///
    /// # Errors
    /// The system has no random bits.
    pub(super) fn random() -> Result<Self, KeyError> {
        let mut bytes = [0; BYTES];
        getrandom::fill(&mut bytes).map_err(|error| KeyError::NoRandomness(error.to_string()))?;
        Ok(Self::of(&bytes))
    }

    /// A secret for a purpose, derived from a secret text. Whoever has the text can compute it, but
    /// it does not reveal the text.
    pub(super) fn derived(purpose: &str, text: &str) -> Self {
        Self::of(&Sha256::digest(format!("{purpose} {text}")).into())
    }

    fn of(bytes: &[u8; BYTES]) -> Self {
        let mut text = PREFIX.to_owned();
        for byte in bytes {
            write!(text, "{byte:02x}").expect("a text takes any text");
        }
        Self(text)
    }

    /// The secret as text, for its owner.
    pub fn text(&self) -> &str {
        &self.0
    }
}

/// Omits the secret, so that no log contains it.
impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret")
    }
}

/// The hash of a secret; `None` if the text does not have the form of a secret.
pub(super) fn hash(text: &str) -> Option<[u8; 32]> {
    let digits = text.strip_prefix(PREFIX)?;
    let is_lower_hex = |byte: u8| matches!(byte, b'0'..=b'9' | b'a'..=b'f');
    let has_form = digits.len() == DIGITS && digits.bytes().all(is_lower_hex);
    has_form.then(|| Sha256::digest(text.as_bytes()).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_secret_is_random_and_hashed_by_its_text() {
        let secret = Secret::random().unwrap();
        assert_ne!(secret, Secret::random().unwrap());
        assert_eq!(secret.text().len(), 68);
        assert_ne!(hash(secret.text()), hash(Secret::random().unwrap().text()));
        assert!(!format!("{secret:?}").contains(&secret.text()[4..12]));
    }

    /// The value is from `printf gfx_00…00 | sha256sum`.
    #[test]
    fn the_hash_is_that_of_the_standard() {
        let text = format!("gfx_{}", "0".repeat(64));
        let expected = "42563fd5c56fb637daa296e76983ca1f7f309a3f72c893d4fb3c76e3eeb48930";
        let digits: String =
            hash(&text).unwrap().iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(digits, expected);
    }

    /// The value is from `printf 'csrf gfx_00…00' | sha256sum`.
    #[test]
    fn a_derived_secret_is_a_hash_of_purpose_and_text() {
        let text = format!("gfx_{}", "0".repeat(64));
        let expected = "gfx_05a5596fd15d71ac5bb48888f48aef35242630fa820d2213ebe2344cf6b1bcf8";
        assert_eq!(Secret::derived("csrf", &text).text(), expected);
    }

    #[test]
    fn a_text_of_another_form_has_no_hash() {
        let good = "gfx_".to_owned() + &"a".repeat(64);
        assert!(hash(&good).is_some());
        let upper = good.to_uppercase();
        for wrong in ["", "gfx_", &good[..67], &good[4..], &upper, &format!("{good}a"), "gfx_é"] {
            assert_eq!(hash(wrong), None, "{wrong}");
        }
    }
}
