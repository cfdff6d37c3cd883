//! Webhooks that are informed of the end of a job, and the signature of the message.
//!
//! Source: Standard Webhooks 1.0.0, symmetric signatures: HMAC-SHA256 over id, time and body.

use std::fmt;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hmac::{Hmac, Mac};
use sha2::Sha256;

use crate::feeds::{Connector, Url};

use super::JobError;

/// Prefix of a secret's text.
const PREFIX: &str = "whsec_";
/// Number of bytes of a secret.
const SECRET_BYTES: std::ops::RangeInclusive<usize> = 24..=64;

/// A webhook: its URL and its secret.
#[derive(Clone, Debug)]
pub struct Webhook {
    /// The URL.
    pub url: String,
    /// Secret that signs the messages.
    pub secret: WebhookSecret,
}

/// A secret that client and service share: `whsec_` and 24 to 64 bytes in base64. `Debug` does not
/// print it.
#[derive(Clone)]
pub struct WebhookSecret {
    text: String,
    key: Vec<u8>,
}

impl Webhook {
    /// Checks that clients may name this webhook.
    ///
    /// # Errors
    /// The URL or the secret is invalid, or the operator does not list the host.
    pub(super) fn check(&self, connector: &Connector) -> Result<(), JobError> {
        let refused = |error| JobError::Fetch { field: "options.webhook.url", error };
        let url: Url = self.url.parse().map_err(refused)?;
        connector.policy().check(&url.host, url.port).map_err(refused)
    }
}

impl WebhookSecret {
    /// Parses the text of a secret.
    ///
    /// # Errors
    /// The text is not a secret.
    pub fn parse(text: &str) -> Result<Self, JobError> {
        let encoded = text.strip_prefix(PREFIX);
        let key = encoded.and_then(|encoded| STANDARD.decode(encoded).ok());
        match key.filter(|key| SECRET_BYTES.contains(&key.len())) {
            Some(key) => Ok(Self { text: text.to_owned(), key }),
            None => Err(JobError::InvalidOption {
                field: "options.webhook.secret",
                message: "it is not whsec_ and 24 to 64 bytes in base64".to_owned(),
            }),
        }
    }

    /// The text.
    pub(super) fn text(&self) -> &str {
        &self.text
    }

    /// The signature of a message, as in its head.
    pub(super) fn sign(&self, id: &str, unix_s: i64, body: &[u8]) -> String {
        let mut hmac = Hmac::<Sha256>::new_from_slice(&self.key).expect("it takes any length");
        hmac.update(format!("{id}.{unix_s}.").as_bytes());
        hmac.update(body);
        format!("v1,{}", STANDARD.encode(hmac.finalize().into_bytes()))
    }
}

impl fmt::Debug for WebhookSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("WebhookSecret")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of Standard Webhooks and its libraries.
    #[test]
    fn a_signature_is_that_of_the_standard() {
        let secret = WebhookSecret::parse("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw").unwrap();
        let id = "msg_p5jXN8AQM9LWM0D4loKWxJek";
        let signature = secret.sign(id, 1_614_265_330, br#"{"test": 2432232314}"#);
        assert_eq!(signature, "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
        assert_eq!(format!("{secret:?}"), "WebhookSecret");
    }

    #[test]
    fn a_secret_is_long_and_has_its_prefix() {
        for (bytes, is_taken) in [(23, false), (24, true), (64, true), (65, false)] {
            let text = format!("whsec_{}", STANDARD.encode(vec![7; bytes]));
            assert_eq!(WebhookSecret::parse(&text).is_ok(), is_taken, "{bytes}");
        }
        let bare = STANDARD.encode([7; 32]);
        for wrong in ["", "whsec_", "secret", bare.as_str(), "whsec_###"] {
            assert!(WebhookSecret::parse(wrong).is_err(), "{wrong:?}");
        }
    }
}
