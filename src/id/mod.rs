//! Public ids: a prefix for the kind, and 122 random bits, so that nobody can guess an id.

use std::fmt;
use std::hash::{Hash, Hasher};
use std::marker::PhantomData;
use std::sync::Arc;

use uuid::Uuid;

/// The kind of object that an [`Id`] identifies.
pub trait Kind {
    /// Prefix of its ids.
    const PREFIX: &str;
}

/// The id of a `K`, such as `ses_` and 32 hexadecimal digits. Ids of two kinds are different types.
pub struct Id<K> {
    text: Arc<str>,
    kind: PhantomData<fn() -> K>,
}

impl<K: Kind> Id<K> {
    /// A new random id.
    pub fn random() -> Self {
        Self::of(format!("{}{}", K::PREFIX, Uuid::new_v4().simple()).into())
    }

    /// Reads an id; `None` if the text does not have the form of this kind's ids.
    pub fn parse(text: &str) -> Option<Self> {
        let digits = text.strip_prefix(K::PREFIX)?;
        let is_lower_hex = |byte: u8| matches!(byte, b'0'..=b'9' | b'a'..=b'f');
        (digits.len() == 32 && digits.bytes().all(is_lower_hex)).then(|| Self::of(text.into()))
    }
}

impl<K> Id<K> {
    const fn of(text: Arc<str>) -> Self {
        Self { text, kind: PhantomData }
    }

    /// The id as text.
    pub fn as_str(&self) -> &str {
        &self.text
    }
}

// Derived implementations would require the same traits of `K`.

impl<K> Clone for Id<K> {
    fn clone(&self) -> Self {
        Self::of(self.text.clone())
    }
}

impl<K> PartialEq for Id<K> {
    fn eq(&self, other: &Self) -> bool {
        self.text == other.text
    }
}

impl<K> Eq for Id<K> {}

impl<K> PartialOrd for Id<K> {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl<K> Ord for Id<K> {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.text.cmp(&other.text)
    }
}

impl<K> Hash for Id<K> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.text.hash(state);
    }
}

impl<K> fmt::Display for Id<K> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl<K> fmt::Debug for Id<K> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Example;

    impl Kind for Example {
        const PREFIX: &str = "exa_";
    }

    #[test]
    fn ids_are_parsed_by_their_form() {
        let id = Id::<Example>::random();
        assert_eq!(Id::parse(id.as_str()), Some(id.clone()));
        assert_ne!(Id::random(), id);
        let upper = id.as_str().to_uppercase();
        let other = format!("ses_{}", &id.as_str()[4..]);
        for wrong in ["", "exa_", "exa_12", &id.as_str()[4..], &upper, &other] {
            assert_eq!(Id::<Example>::parse(wrong), None, "{wrong}");
        }
    }
}
