//! The table of codes.

mod jobs;
mod operation;
mod requests;
mod sources;

use std::fmt;

use jobs::jobs;
use operation::operation;
use requests::requests;
use sources::sources;

/// Declares the codes with their name, class and remedy.
macro_rules! codes {
    ($(
        $(#[doc = $cause:literal])+
        $variant:ident = $name:literal, $class:ident, $remedy:literal;
    )+) => {
        /// Stable code of a refusal or failure.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Code {
            $($(#[doc = $cause])+ $variant,)+
        }

        impl Code {
            /// Every code.
            pub const ALL: &[Self] = &[$(Self::$variant,)+];

            /// The name as users see it, upper snake case.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)+
                }
            }

            /// The kind of refusal, which decides the status at each door.
            pub const fn class(self) -> super::Class {
                match self {
                    $(Self::$variant => super::Class::$class,)+
                }
            }

            /// What is wrong, without the values at fault.
            pub fn cause(self) -> &'static str {
                match self {
                    $(Self::$variant => concat!($($cause),+).trim_start(),)+
                }
            }

            /// What the user can do about it.
            pub const fn remedy(self) -> &'static str {
                match self {
                    $(Self::$variant => $remedy,)+
                }
            }
        }
    };
}

/// Declares the codes of all parts of the table, each of which passes on what is before it.
macro_rules! collected {
    ({ $($codes:tt)* }) => { codes! { $($codes)* } };
    ({ $($before:tt)* } $part:ident $($rest:ident)*) => {
        $part! { collected { $($before)* } $($rest)* }
    };
}

collected! { {} requests sources jobs operation }

impl Code {
    /// Where a service explains the code, as a path of its REST door.
    pub fn link(self) -> String {
        format!("/docs/errors#{}", self.name())
    }
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_upper_snake_case_and_distinct() {
        let mut seen = std::collections::BTreeSet::new();
        for code in Code::ALL {
            let plain = |c: char| c.is_ascii_uppercase() || c == '_';
            assert!(code.name().chars().all(plain), "{code}");
            assert!(seen.insert(code.name()), "{code} twice");
        }
    }
}
