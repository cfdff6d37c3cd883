//! Stored solutions.

use crate::contract::{Refusal, Service, convert, texts, v1};
use crate::session::SolutionPage;
use crate::store::SolutionQuery;

use super::{page_size, page_token, session_id};

/// Solutions on a page if the request gives no size.
const PAGE: usize = 1000;

/// A page of a session's stored solutions in order of seq and revision.
///
/// # Errors
/// The session does not exist, or the page token, size, time or status is invalid.
pub async fn list(
    service: &Service,
    request: v1::ListSolutionsRequest,
) -> Result<v1::ListSolutionsResponse, Refusal> {
    let id = session_id(&request.session)?;
    texts::check("pageToken", &request.page_token, texts::NAME_MAX)?;
    let query = SolutionQuery {
        from: convert::time(request.from, "from")?,
        to: convert::time(request.to, "to")?,
        status: convert::status_filter(request.status)?,
        revisions: convert::revisions(request.revisions)?,
        page_size: page_size(request.page_size, PAGE),
        page_token: page_token(&request.page_token).map(ToOwned::to_owned),
    };
    let SolutionPage { page, oldest_available } = service.sessions().solutions(&id, &query).await?;
    Ok(v1::ListSolutionsResponse {
        solutions: page.items.iter().map(convert::stored).collect(),
        next_page_token: page.next_page_token.unwrap_or_default(),
        oldest_available_seq: oldest_available,
    })
}
