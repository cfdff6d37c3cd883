//! The API key that a client's requests carry.

use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::{Request, Status};

use crate::refusal::Code;

use super::Failure;

/// The value of `authorization`; `None` without a key.
#[derive(Clone)]
pub(super) struct Bearer(Option<MetadataValue<Ascii>>);

impl Bearer {
    /// The value for `key`.
    ///
    /// # Errors
    /// `key` has characters that no API key has.
    pub(super) fn of(key: Option<&str>) -> Result<Self, Failure> {
        let value = key.map(|key| format!("Bearer {key}").parse::<MetadataValue<Ascii>>());
        let mut value = value.transpose().map_err(|_| {
            let message = "--key has characters that no key has";
            Failure::new(Code::Usage, message, "give the secret that graphfix keys create printed")
        })?;
        value.iter_mut().for_each(|value| value.set_sensitive(true));
        Ok(Self(value))
    }
}

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(value) = &self.0 {
            request.metadata_mut().insert("authorization", value.clone());
        }
        Ok(request)
    }
}
