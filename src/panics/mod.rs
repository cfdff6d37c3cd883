//! The words of panics that are caught.

use std::any::Any;

/// The words of a panic, from what unwinding carries.
pub(crate) fn words(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no words")
}

#[cfg(test)]
mod tests {
    use std::panic::{catch_unwind, panic_any};

    use super::*;

    #[test]
    fn a_panic_has_words_or_none() {
        let said = |panicking: fn()| words(&*catch_unwind(panicking).unwrap_err()).to_owned();
        assert_eq!(said(|| panic!("singular at {}", 3)), "singular at 3");
        assert_eq!(said(|| panic!("singular")), "singular");
        assert_eq!(said(|| panic_any(3)), "no words");
    }
}
