//! Texts that need no allocation while they are short.

use std::fmt;
use std::ops::Deref;

use bytes::Buf;
use prost::DecodeError;
use prost::bytes::BufMut;
use prost::encoding::{self, DecodeContext, WireType};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Longest text that is stored inline (bytes).
const SHORT: usize = 7;

/// A text. Up to seven bytes are stored inline, a longer text on the heap.
#[derive(Clone)]
pub struct ShortText(Stored);

#[derive(Clone)]
enum Stored {
    Short { length: u8, bytes: [u8; SHORT] },
    Long(Box<str>),
}

impl ShortText {
    /// The text with these bytes, if they are valid UTF-8 and short.
    fn short(text: &[u8]) -> Option<Self> {
        let mut bytes = [0; SHORT];
        bytes.get_mut(..text.len())?.copy_from_slice(text);
        std::str::from_utf8(text).ok()?;
        Some(Self(Stored::Short { length: text.len() as u8, bytes }))
    }

    /// Appends the text as field number `tag`, unless it is empty.
    pub(super) fn encode(&self, tag: u32, buffer: &mut impl BufMut) {
        if !self.is_empty() {
            encoding::encode_key(tag, WireType::LengthDelimited, buffer);
            encoding::encode_varint(self.len() as u64, buffer);
            buffer.put_slice(self.as_bytes());
        }
    }

    /// Length of what [`Self::encode`] appends.
    pub(super) fn encoded_len(&self, tag: u32) -> usize {
        if self.is_empty() {
            return 0;
        }
        encoding::key_len(tag) + encoding::encoded_len_varint(self.len() as u64) + self.len()
    }

    /// Reads the content of a field.
    ///
    /// # Errors
    /// As for a `String`.
    pub(super) fn merge(
        &mut self,
        wire_type: WireType,
        buffer: &mut impl Buf,
        context: DecodeContext,
    ) -> Result<(), DecodeError> {
        if wire_type == WireType::LengthDelimited
            && let [length, rest @ ..] = buffer.chunk()
            && let Some(text) = rest.get(..usize::from(*length))
            && let Some(short) = Self::short(text)
        {
            buffer.advance(1 + text.len());
            *self = short;
            return Ok(());
        }
        let mut text = String::new();
        encoding::string::merge(wire_type, &mut text, buffer, context)?;
        *self = text.as_str().into();
        Ok(())
    }
}

impl From<&str> for ShortText {
    fn from(text: &str) -> Self {
        Self::short(text.as_bytes()).unwrap_or_else(|| Self(Stored::Long(text.into())))
    }
}

impl Default for ShortText {
    fn default() -> Self {
        Self(Stored::Short { length: 0, bytes: [0; SHORT] })
    }
}

impl Deref for ShortText {
    type Target = str;

    fn deref(&self) -> &str {
        match &self.0 {
            Stored::Short { length, bytes } => {
                let text = std::str::from_utf8(&bytes[..usize::from(*length)]);
                text.expect("it was a text when it was stored")
            }
            Stored::Long(text) => text,
        }
    }
}

impl PartialEq for ShortText {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl fmt::Debug for ShortText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&**self, f)
    }
}

impl Serialize for ShortText {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self)
    }
}

impl<'de> Deserialize<'de> for ShortText {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer).map(|text| text.as_str().into())
    }
}
