//! Files of jobs that arrive in several requests.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use bytes::Bytes;
use futures::{Stream, StreamExt};

use crate::contract::{Caller, Refusal, texts, v1};
use crate::jobs::{UploadId, UploadInfo};
use crate::refusal::Code;

use super::utc;

/// An upload as a message, and when it is removed.
pub struct Answer {
    /// The message.
    pub upload: v1::Upload,
    /// When it is removed.
    pub expires: SystemTime,
}

/// Begins an upload of a file of this size. `name` is the name of the file on the user's side.
///
/// # Errors
/// The name is too long or has a control character, the service takes no jobs, the file is too
/// large, or the tenant's limit of uploads is reached.
pub async fn create(caller: &Caller, name: &str, length: u64) -> Result<Answer, Refusal> {
    texts::check_file_name("Upload-Metadata", name)?;
    Ok(Answer::of(&caller.jobs().begin_upload(name, length).await?))
}

/// An upload.
///
/// # Errors
/// The tenant has no upload with this id.
pub async fn get(caller: &Caller, upload: &str) -> Result<Answer, Refusal> {
    Ok(Answer::of(&caller.jobs().upload_info(&upload_id(upload)?).await?))
}

/// Appends bytes to an upload from this offset on. If the body ends early, its bytes so far stay.
///
/// # Errors
/// The offset is not that of the upload, another request appends to it, the bytes exceed the size
/// of the file or the space of all files, the tenant has no such upload, or the body ends early.
pub async fn append(
    caller: &Caller,
    upload: &str,
    offset: u64,
    mut body: impl Stream<Item = Result<Bytes, Refusal>> + Unpin,
) -> Result<Answer, Refusal> {
    let mut appending = caller.jobs().append_upload(&upload_id(upload)?, offset).await?;
    let mut arrived = Ok(());
    // After a failure nothing is awaited from the client.
    while arrived.is_ok() {
        arrived = match body.next().await {
            Some(Ok(bytes)) => appending.write(&bytes).await.map_err(Refusal::from),
            Some(Err(refusal)) => Err(refusal),
            None => break,
        };
    }
    let upload = appending.finish().await?;
    arrived.map(|()| Answer::of(&upload))
}

/// Removes an upload. Jobs that name its file keep it.
///
/// # Errors
/// The tenant has no upload with this id.
pub async fn remove(caller: &Caller, upload: &str) -> Result<(), Refusal> {
    Ok(caller.jobs().remove_upload(&upload_id(upload)?).await?)
}

/// The id of an upload.
pub(super) fn upload_id(text: &str) -> Result<UploadId, Refusal> {
    UploadId::parse(text).ok_or_else(|| {
        let message = format!("there is no upload {:?}", texts::brief(text));
        Refusal::new(Code::UploadNotFound, message).at("upload")
    })
}

impl Answer {
    fn of(upload: &UploadInfo) -> Self {
        let since = Duration::from_millis(upload.expires_unix_ms.unsigned_abs());
        let message = v1::Upload {
            upload: upload.id.to_string(),
            name: upload.name.clone(),
            length: upload.length,
            offset: upload.offset,
            hash: upload.hash.clone().unwrap_or_default(),
            expires_utc: utc(upload.expires_unix_ms),
        };
        Self { upload: message, expires: UNIX_EPOCH + since }
    }
}
