//! Secrets that the service stores and must use again, such as passwords at casters. They are
//! encrypted with the operator's key. API keys are not among them, because their hash suffices.
//!
//! AES-256 in Galois/counter mode (NIST SP 800-38D) with 96 random bits as nonce. The owner of a
//! secret is authenticated with it, so a secret that is moved to another row cannot be opened.

mod error;
mod key;

pub use error::SecretsError;
pub use key::SecretsKey;

/// The keys that encrypt and decrypt stored secrets.
#[derive(Default)]
pub struct Secrets {
    /// The key that encrypts; `None` if secrets are stored in plain text.
    current: Option<SecretsKey>,
    /// Keys that only decrypt.
    former: Vec<SecretsKey>,
}

/// A secret as it is stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct StoredSecret {
    /// The secret, or in base64 its nonce, ciphertext and tag.
    pub(crate) text: String,
    /// Id of the key; `None` if the secret is not encrypted.
    pub(crate) key: Option<String>,
}

impl Secrets {
    /// Secrets under a key; those under `former` keys can still be read.
    pub const fn new(current: SecretsKey, former: Vec<SecretsKey>) -> Self {
        Self { current: Some(current), former }
    }

    /// Id of the key that encrypts; `None` while nothing is encrypted.
    pub fn key_id(&self) -> Option<&str> {
        self.current.as_ref().map(SecretsKey::id)
    }

    /// The secret of `owner` in its stored form. An empty text is not encrypted.
    pub(crate) fn seal(&self, owner: &str, secret: &str) -> StoredSecret {
        match self.current.as_ref().filter(|_| !secret.is_empty()) {
            None => StoredSecret { text: secret.to_owned(), key: None },
            Some(key) => {
                StoredSecret { text: key.seal(owner, secret), key: Some(key.id().to_owned()) }
            }
        }
    }

    /// The secret of `owner`.
    ///
    /// # Errors
    /// No key has this id, or the text was not made by this key for this owner.
    pub(crate) fn unseal(
        &self,
        owner: &str,
        stored: &StoredSecret,
    ) -> Result<String, SecretsError> {
        let Some(id) = &stored.key else { return Ok(stored.text.clone()) };
        let known = self.current.iter().chain(&self.former).find(|key| key.id() == id);
        let key = known.ok_or_else(|| SecretsError::KeyUnknown { key: id.clone() })?;
        let opened = key.unseal(owner, &stored.text);
        opened.ok_or_else(|| SecretsError::Damaged { owner: owner.to_owned() })
    }

    /// Hash of content that contains a secret. Without the key nobody can find the secret by
    /// trying.
    pub(crate) fn hash(&self, content: &[u8]) -> String {
        let hash = match &self.current {
            None => blake3::hash(content),
            Some(key) => key.hash(content),
        };
        hash.to_hex().to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(digit: &str) -> SecretsKey {
        SecretsKey::parse(&digit.repeat(64)).unwrap()
    }

    #[test]
    fn a_secret_opens_with_its_key_for_its_owner() {
        let secrets = Secrets::new(key("a"), Vec::new());
        let stored = secrets.seal("base 1", "open sesame");
        assert_eq!(stored.key.as_deref(), secrets.key_id());
        assert!(!stored.text.contains("sesame"));
        assert_eq!(secrets.unseal("base 1", &stored).unwrap(), "open sesame");
        let moved = secrets.unseal("base 2", &stored);
        assert!(matches!(moved, Err(SecretsError::Damaged { .. })), "{moved:?}");
        // Equal secrets have different stored texts.
        assert_ne!(secrets.seal("base 1", "open sesame"), stored);
    }

    #[test]
    fn a_changed_text_does_not_open() {
        let secrets = Secrets::new(key("a"), Vec::new());
        let stored = secrets.seal("base 1", "open sesame");
        for index in 0..stored.text.len() {
            let mut text = stored.text.clone().into_bytes();
            text[index] = if text[index] == b'A' { b'B' } else { b'A' };
            let changed =
                StoredSecret { text: String::from_utf8(text).unwrap(), key: stored.key.clone() };
            assert!(secrets.unseal("base 1", &changed).is_err(), "{index}");
        }
        let short = StoredSecret { text: "AAAA".to_owned(), key: stored.key };
        assert!(secrets.unseal("base 1", &short).is_err());
    }

    #[test]
    fn a_former_key_opens_and_does_not_seal() {
        let before = Secrets::new(key("a"), Vec::new()).seal("job 1", "secret");
        let rotated = Secrets::new(key("b"), vec![key("a")]);
        assert_eq!(rotated.unseal("job 1", &before).unwrap(), "secret");
        assert_eq!(rotated.seal("job 1", "secret").key.as_deref(), Some(key("b").id()));
        let unknown = Secrets::new(key("b"), Vec::new()).unseal("job 1", &before);
        assert!(matches!(unknown, Err(SecretsError::KeyUnknown { .. })), "{unknown:?}");
    }

    #[test]
    fn without_a_key_a_secret_is_as_it_is() {
        let stored = Secrets::default().seal("base 1", "open sesame");
        assert_eq!(stored, StoredSecret { text: "open sesame".to_owned(), key: None });
        let sealing = Secrets::new(key("a"), Vec::new());
        assert_eq!(sealing.unseal("base 1", &stored).unwrap(), "open sesame");
        assert_eq!(sealing.seal("base 1", "").key, None);
    }

    #[test]
    fn a_hash_needs_the_key() {
        let [one, other] = ["a", "b"].map(|digit| Secrets::new(key(digit), Vec::new()));
        assert_eq!(one.hash(b"content"), one.hash(b"content"));
        assert_ne!(one.hash(b"content"), other.hash(b"content"));
        assert_ne!(one.hash(b"content"), Secrets::default().hash(b"content"));
    }
}
