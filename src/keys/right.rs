//! Rights of a key.

use std::fmt;

use super::KeyError;

/// A right of a key. The table of calls states which calls need it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Right {
    /// Sends observations: what a receiver needs for its own sessions.
    Device,
    /// Reads sessions, solutions, bases and navigation.
    Read,
    /// Changes sessions, bases and navigation.
    Operate,
    /// Changes keys.
    Admin,
}

impl Right {
    /// Every right.
    pub const ALL: [Self; 4] = [Self::Device, Self::Read, Self::Operate, Self::Admin];

    /// The name as users see it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Device => "device",
            Self::Read => "read",
            Self::Operate => "operate",
            Self::Admin => "admin",
        }
    }
}

/// A set of rights.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Rights(u8);

impl Rights {
    /// No right.
    pub const NONE: Self = Self(0);
    /// Every right.
    pub const ALL: Self = Self::of(&Right::ALL);

    /// These rights.
    pub const fn of(rights: &[Right]) -> Self {
        let (mut bits, mut index) = (0, 0);
        while index < rights.len() {
            bits |= 1 << rights[index] as u8;
            index += 1;
        }
        Self(bits)
    }

    /// The rights with these names.
    ///
    /// # Errors
    /// A name is not the name of a right, or the list is empty.
    pub fn named(names: &[impl AsRef<str>]) -> Result<Self, KeyError> {
        let mut rights = Self::NONE;
        for (index, name) in names.iter().map(AsRef::as_ref).enumerate() {
            let right = Right::ALL.into_iter().find(|right| right.name() == name);
            let unknown = || KeyError::UnknownRight { index, name: name.to_owned() };
            rights.0 |= Self::of(&[right.ok_or_else(unknown)?]).0;
        }
        if rights == Self::NONE { Err(KeyError::NoRights) } else { Ok(rights) }
    }

    /// The rights in a column of the store. Names that this version does not know give no right.
    pub(super) fn stored(text: &str) -> Self {
        let is_named = |right: &Right| text.split(' ').any(|name| name == right.name());
        let known: Vec<Right> = Right::ALL.into_iter().filter(is_named).collect();
        Self::of(&known)
    }

    /// Whether one of these rights is among `others`.
    pub const fn meets(self, others: Self) -> bool {
        self.0 & others.0 != 0
    }

    /// The names, in the order of [`Right::ALL`].
    pub fn names(self) -> Vec<&'static str> {
        let has = |right: &Right| self.meets(Self::of(&[*right]));
        Right::ALL.into_iter().filter(has).map(Right::name).collect()
    }
}

impl fmt::Display for Rights {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.names().join(" "))
    }
}

impl fmt::Debug for Rights {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Rights({self})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rights_are_read_as_they_are_written() {
        for bits in 1..=Rights::ALL.0 {
            let rights = Rights(bits);
            assert_eq!(Rights::stored(&rights.to_string()), rights);
            assert_eq!(Rights::named(&rights.names()).unwrap(), rights);
        }
        assert_eq!(Rights::stored("read bill"), Rights::of(&[Right::Read]));
        assert_eq!(Rights::stored(""), Rights::NONE);
    }

    #[test]
    fn a_name_that_is_no_right_is_refused() {
        let error = Rights::named(&["read", "write"]).unwrap_err();
        assert!(matches!(error, KeyError::UnknownRight { index: 1, .. }), "{error}");
        assert!(matches!(Rights::named(&[""; 0]), Err(KeyError::NoRights)));
    }

    #[test]
    fn a_need_is_met_by_one_of_its_rights() {
        let need = Rights::of(&[Right::Device, Right::Read]);
        assert!(Rights::of(&[Right::Read, Right::Admin]).meets(need));
        assert!(!Rights::of(&[Right::Operate, Right::Admin]).meets(need));
    }
}
