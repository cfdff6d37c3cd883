//! Solutions: what was stored.

use crate::contract::{Refusal, Service, convert, v1};
use crate::store::SolutionQuery;

use super::{page_size, page_token, session_id};

/// Solutions on a page where no size is asked for.
const PAGE: usize = 1000;

/// Stored solutions of a session in order of seq and revision.
///
/// # Errors
/// No such session, or a page token, size, time or status that is refused.
pub async fn list(
    service: &Service,
    request: v1::ListSolutionsRequest,
) -> Result<v1::ListSolutionsResponse, Refusal> {
    let id = session_id(&request.session)?;
    let query = SolutionQuery {
        from: convert::time(request.from, "from")?,
        to: convert::time(request.to, "to")?,
        status: convert::status_filter(request.status)?,
        revisions: convert::revisions(request.revisions)?,
        page_size: page_size(request.page_size, PAGE),
        page_token: page_token(&request.page_token).map(ToOwned::to_owned),
    };
    let page = service.sessions().solutions(&id, &query).await?;
    Ok(v1::ListSolutionsResponse {
        solutions: page.items.iter().map(convert::stored).collect(),
        next_page_token: page.next_page_token.unwrap_or_default(),
    })
}
