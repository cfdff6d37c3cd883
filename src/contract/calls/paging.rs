//! Page tokens: the position at which a list continues. Clients send them back unread.

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use prost::Message;

use crate::contract::{Refusal, texts};
use crate::refusal::Code;

/// Bytes of a token that identify its list.
const TAG_BYTES: usize = 4;

/// The pages of one list with one filter. Tokens of other lists or filters are refused.
pub(super) struct Pages {
    tag: [u8; TAG_BYTES],
    after: Option<String>,
}

impl Pages {
    /// The pages of a call, beginning at a token, or at the first page if the token is empty.
    /// `request` is the request without its page size and token.
    ///
    /// # Errors
    /// The token comes from another call or another request.
    pub(super) fn of<M: Message>(call: &str, request: &M, token: &str) -> Result<Self, Refusal> {
        texts::check("pageToken", token, texts::NAME_MAX)?;
        let mut list = blake3::Hasher::new();
        list.update(call.as_bytes()).update(&[0]).update(&request.encode_to_vec());
        let mut tag = [0; TAG_BYTES];
        tag.copy_from_slice(&list.finalize().as_bytes()[..TAG_BYTES]);
        if token.is_empty() {
            return Ok(Self { tag, after: None });
        }
        let bytes = URL_SAFE_NO_PAD.decode(token).unwrap_or_default();
        let after = bytes.strip_prefix(&tag).and_then(|after| std::str::from_utf8(after).ok());
        match after {
            Some(after) => Ok(Self { tag, after: Some(after.to_owned()) }),
            None => {
                let message = "the token is not of this list, or other fields have changed";
                Err(Refusal::new(Code::PageTokenInvalid, message).at("pageToken"))
            }
        }
    }

    /// The item after which the page begins, as the desk names it.
    pub(super) fn after(&self) -> Option<&str> {
        self.after.as_deref()
    }

    /// The token of the next page; empty after the last one.
    pub(super) fn token(&self, next: Option<String>) -> String {
        let Some(next) = next else { return String::new() };
        URL_SAFE_NO_PAD.encode([&self.tag, next.as_bytes()].concat())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contract::v1::ListSessionsRequest;

    #[test]
    fn a_token_is_of_one_list_and_filter() {
        let all = ListSessionsRequest::default();
        let pages = Pages::of("Sessions/List", &all, "").unwrap();
        assert_eq!((pages.after(), pages.token(None)), (None, String::new()));
        let token = pages.token(Some("ses_1".to_owned()));
        assert!(!token.contains("ses_1"), "{token}");
        let next = Pages::of("Sessions/List", &all, &token).unwrap();
        assert_eq!(next.after(), Some("ses_1"));
        let open = ListSessionsRequest { closed: Some(false), ..all.clone() };
        for wrong in [
            Pages::of("Sessions/List", &open, &token),
            Pages::of("Sessions/Heads", &all, &token),
            Pages::of("Sessions/List", &all, "ses_1"),
        ] {
            assert_eq!(wrong.err().map(|refusal| refusal.code), Some(Code::PageTokenInvalid));
        }
    }
}
