//! The calls, one file per service, one function per call: a request in, an answer or a refusal
//! out.

pub mod navigation;
pub mod positioning;
pub mod sessions;
pub mod solutions;

use crate::session::SessionId;

use super::{Code, Refusal};

/// What an empty mode stands for.
const MODE: &str = "spp";
/// What an empty profile stands for.
const PROFILE: &str = "general";

fn session_id(text: &str) -> Result<SessionId, Refusal> {
    SessionId::parse(text).ok_or_else(|| {
        Refusal::new(Code::SessionNotFound, format!("there is no session {text:?}")).at("session")
    })
}

/// `text`, or what an empty one stands for.
fn or_standard(text: String, standard: &str) -> String {
    if text.is_empty() { standard.to_owned() } else { text }
}

fn page_token(token: &str) -> Option<&str> {
    Some(token).filter(|token| !token.is_empty())
}

/// Zero stands for the call's standard size.
const fn page_size(asked: u32, standard: usize) -> usize {
    if asked == 0 { standard } else { asked as usize }
}
