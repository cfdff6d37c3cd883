//! A key that encrypts stored secrets.

use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use ring::aead::{AES_256_GCM, Aad, LessSafeKey, NONCE_LEN, Nonce, UnboundKey};

use super::SecretsError;

/// Length of a key (bytes).
const KEY_BYTES: usize = 32;
/// Longest file that is read: a key of 64 digits and a line end have 66 bytes.
const FILE_BYTES: u64 = 4096;
/// Length of a key's id (hexadecimal digits). The id names the key and does not reveal it.
const ID_DIGITS: usize = 8;

/// A key of 256 bits. `Debug` shows its id only.
pub struct SecretsKey {
    id: String,
    cipher: LessSafeKey,
    /// The key for keyed hashes.
    hashing: [u8; 32],
}

impl SecretsKey {
    /// Reads the key in a file.
    ///
    /// # Errors
    /// [`SecretsError::Key`].
    pub fn read(path: &Path) -> Result<Self, SecretsError> {
        let named = |why: String| SecretsError::Key { what: path.display().to_string(), why };
        let mut text = String::new();
        let file = File::open(path).map_err(|error| named(error.to_string()))?;
        let read = file.take(FILE_BYTES).read_to_string(&mut text);
        read.map_err(|error| named(error.to_string()))?;
        Self::parse(&text).map_err(|error| match error {
            SecretsError::Key { why, .. } => named(why),
            other => other,
        })
    }

    /// The key of a text: 64 hexadecimal digits.
    ///
    /// # Errors
    /// [`SecretsError::Key`]; it does not repeat the text.
    pub fn parse(text: &str) -> Result<Self, SecretsError> {
        let invalid = || SecretsError::Key {
            what: "the key".to_owned(),
            why: format!("a key is {} hexadecimal digits and nothing else", 2 * KEY_BYTES),
        };
        let digits = text.trim();
        if digits.len() != 2 * KEY_BYTES || !digits.bytes().all(|b| b.is_ascii_hexdigit()) {
            return Err(invalid());
        }
        let mut bytes = [0; KEY_BYTES];
        for (byte, index) in bytes.iter_mut().zip((0..digits.len()).step_by(2)) {
            *byte = u8::from_str_radix(&digits[index..index + 2], 16).map_err(|_| invalid())?;
        }
        let cipher = UnboundKey::new(&AES_256_GCM, &bytes).expect("the cipher's length of a key");
        let id = blake3::Hash::from(blake3::derive_key("graphfix id of a key of secrets", &bytes));
        Ok(Self {
            id: id.to_hex()[..ID_DIGITS].to_owned(),
            cipher: LessSafeKey::new(cipher),
            hashing: blake3::derive_key("graphfix hashes of requests with secrets", &bytes),
        })
    }

    /// The id, which names the key.
    pub(super) fn id(&self) -> &str {
        &self.id
    }

    /// Nonce, ciphertext and tag of a secret of `owner`, in base64.
    pub(super) fn seal(&self, owner: &str, secret: &str) -> String {
        let mut nonce = [0; NONCE_LEN];
        getrandom::fill(&mut nonce).expect("the system gives random bytes");
        let mut sealed = secret.as_bytes().to_vec();
        let unique = Nonce::assume_unique_for_key(nonce);
        let done = self.cipher.seal_in_place_append_tag(unique, Aad::from(owner), &mut sealed);
        done.expect("a secret is far shorter than the cipher's limit");
        STANDARD.encode([&nonce[..], &sealed].concat())
    }

    /// The secret of `owner`; `None` if the text was not made by this key for this owner.
    pub(super) fn unseal(&self, owner: &str, text: &str) -> Option<String> {
        let bytes = STANDARD.decode(text).ok()?;
        let (nonce, sealed) = bytes.split_first_chunk::<NONCE_LEN>()?;
        let (nonce, mut sealed) = (Nonce::assume_unique_for_key(*nonce), sealed.to_vec());
        let secret = self.cipher.open_in_place(nonce, Aad::from(owner), &mut sealed).ok()?;
        String::from_utf8(secret.to_vec()).ok()
    }

    /// A hash that only the holder of this key can compute.
    pub(super) fn hash(&self, content: &[u8]) -> blake3::Hash {
        blake3::keyed_hash(&self.hashing, content)
    }
}

impl fmt::Debug for SecretsKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SecretsKey({})", self.id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_has_64_digits() {
        let text = "0123456789abcdefABCDEF0123456789".repeat(2);
        assert_eq!(SecretsKey::parse(&format!("{text}\n")).unwrap().id().len(), 8);
        for wrong in ["", "12", &text[1..], &format!("{text}0"), &text.replace('a', "g")] {
            let error = SecretsKey::parse(wrong).unwrap_err();
            assert!(wrong.len() < 3 || !error.to_string().contains(wrong), "{error}");
        }
    }
}
