//! Pages of lists: their tokens, and the memory of their items.
//!
//! A token is the position at which a list continues. Clients send it back unread.

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use prost::Message;

use crate::contract::{Lease, Refusal, texts};
use crate::refusal::Code;

/// Bytes of a token that identify its list.
const TAG_BYTES: usize = 4;
/// Largest memory of a page (bytes). Its message then has less than the 4 MB that clients of gRPC
/// take unless they are told otherwise.
pub(super) const PAGE_BYTES: usize = 8 << 20;
/// Memory of the items that are read in one batch (bytes).
const BATCH_BYTES: usize = 1 << 20;

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

/// A page that is read in batches, each after memory is reserved for it. The page ends early if no
/// more memory is free, or with [`PAGE_BYTES`].
pub(super) struct Reading<T> {
    lease: Option<Lease>,
    item_bytes: usize,
    /// Number of items that the page may still have.
    left: usize,
    items: Vec<T>,
    /// The item after which the next batch begins.
    after: Option<String>,
}

impl<T> Reading<T> {
    /// A page of at most `size` items, which begins where `pages` begin. An item, its message and
    /// its JSON have at most `item_bytes` of memory.
    ///
    /// # Errors
    /// The size is not from 1 to `limit`.
    pub(super) fn of(
        pages: &Pages,
        (size, limit): (usize, usize),
        item_bytes: usize,
    ) -> Result<Self, Refusal> {
        if !(1..=limit).contains(&size) {
            let message = format!("a page of {size} is not from 1 to {limit}");
            return Err(Refusal::new(Code::PageSizeInvalid, message).at("pageSize"));
        }
        Ok(Self {
            lease: Lease::current(),
            item_bytes,
            left: size.min(PAGE_BYTES / item_bytes),
            items: Vec::new(),
            after: pages.after().map(ToOwned::to_owned),
        })
    }

    /// Reserves memory for the next batch. Returns its number of items; `None` at the end of the
    /// page.
    ///
    /// # Errors
    /// No memory is free, and the page has no items yet.
    pub(super) fn batch(&mut self) -> Result<Option<usize>, Refusal> {
        let size = self.left.min(BATCH_BYTES / self.item_bytes);
        if size == 0 {
            return Ok(None);
        }
        let bytes = size * self.item_bytes;
        match self.lease.as_ref().map_or(Ok(()), |lease| lease.reserve(bytes)) {
            Err(refusal) if self.items.is_empty() => Err(refusal),
            Err(_) => Ok(None),
            Ok(()) => Ok(Some(size)),
        }
    }

    /// The item after which the next batch begins, as the desk names it.
    pub(super) fn after(&self) -> Option<&str> {
        self.after.as_deref()
    }

    /// Adds a batch. `next` is the item after which the following one begins, if there are more.
    pub(super) fn add(&mut self, batch: impl IntoIterator<Item = T>, next: Option<String>) {
        let before = self.items.len();
        self.items.extend(batch);
        let added = self.items.len() - before;
        self.left = if next.is_some() { self.left.saturating_sub(added) } else { 0 };
        self.after = next;
    }

    /// The items of the page, and the last one, if there are more.
    pub(super) fn end(self) -> (Vec<T>, Option<String>) {
        (self.items, self.after)
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
    /// A page has as many items as its memory allows, in batches that it reserves one by one.
    #[test]
    fn a_page_ends_with_its_memory() {
        let pages = Pages::of("Sessions/List", &ListSessionsRequest::default(), "").unwrap();
        let read = |item_bytes: usize, of: usize| {
            let mut reading = Reading::of(&pages, (1000, 1000), item_bytes).unwrap();
            while let Some(size) = reading.batch().unwrap() {
                let begin = reading.after().map_or(0, |after| after.parse().unwrap());
                let end = of.min(begin + size);
                reading.add(begin..end, (end < of).then(|| end.to_string()));
            }
            reading.end()
        };
        let (items, next) = read(64 << 10, 2000);
        assert_eq!(items, (0..PAGE_BYTES / (64 << 10)).collect::<Vec<_>>());
        assert_eq!(next.as_deref(), Some("128"));
        assert_eq!(read(64 << 10, 20), ((0..20).collect(), None));
        assert_eq!(read(1024, 2000), ((0..1000).collect(), Some("1000".to_owned())));
        for size in [0, 1001] {
            let refusal = Reading::<()>::of(&pages, (size, 1000), 1024).err().unwrap();
            assert_eq!(refusal.code, Code::PageSizeInvalid);
        }
    }
}
