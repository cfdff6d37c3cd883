//! Checks of the texts in a request: their lengths, and that they can be stored and printed.

use std::collections::BTreeMap;

use crate::refusal::Code;

use super::Refusal;

/// Longest name of a mode, option, base or page (characters), and longest value of an option.
pub(super) const NAME_MAX: usize = 200;
/// Longest name of an antenna (characters). The IGS uses 20.
pub(super) const ANTENNA_MAX: usize = 60;
/// Longest address of a caster or archive (characters).
pub(super) const ADDRESS_MAX: usize = 2000;

/// Checks the text of `field`: at most `most` characters, none of them a control character.
///
/// # Errors
/// [`Code::InvalidField`].
pub(super) fn check(field: &str, text: &str, most: usize) -> Result<(), Refusal> {
    let refused = |message: String| Err(Refusal::new(Code::InvalidField, message).at(field));
    if let Some(at) = text.chars().position(char::is_control) {
        return refused(format!("character {} is a control character", at + 1));
    }
    match text.chars().count() {
        count if most < count => refused(format!("{count} characters, at most {most} are taken")),
        _ => Ok(()),
    }
}

/// Checks a label. The desk checks its length.
///
/// # Errors
/// [`Code::InvalidField`].
pub(super) fn check_label(label: &str) -> Result<(), Refusal> {
    check("label", label, usize::MAX)
}

/// Checks the name of a file on the user's side. `field` names the part or header that has it.
///
/// # Errors
/// [`Code::InvalidField`].
pub(super) fn check_file_name(field: &str, name: &str) -> Result<(), Refusal> {
    check(field, name, NAME_MAX).map_err(|mut refusal| {
        refusal.message = format!("the name of the file: {}", refusal.message);
        refusal
    })
}

/// Checks names, each with its field.
///
/// # Errors
/// [`Code::InvalidField`].
pub(super) fn check_names<'a>(
    names: impl IntoIterator<Item = (&'a str, &'a str)>,
) -> Result<(), Refusal> {
    names.into_iter().try_for_each(|(field, name)| check(field, name, NAME_MAX))
}

/// Checks overrides of options.
///
/// # Errors
/// [`Code::InvalidField`].
pub(super) fn check_overrides(overrides: &BTreeMap<String, String>) -> Result<(), Refusal> {
    for (key, value) in overrides {
        check("overrides", key, NAME_MAX)?;
        check(&format!("overrides.{key}"), value, NAME_MAX)?;
    }
    Ok(())
}

/// The beginning of a text, for a message.
pub(super) fn brief(text: &str) -> &str {
    text.char_indices().nth(NAME_MAX).map_or(text, |(end, _)| &text[..end])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_have_a_length_and_no_control_characters() {
        assert!(check("antenna", "TRM59800.00     SCIS é", 60).is_ok());
        for (text, most) in [("a\0b", 60), ("a\nb", 60), ("\u{85}", 60), ("abc", 2)] {
            let refusal = check("antenna", text, most).unwrap_err();
            let at_fault = (refusal.code, refusal.field.as_deref());
            assert_eq!(at_fault, (Code::InvalidField, Some("antenna")), "{text:?}");
        }
        assert_eq!(brief(&"é".repeat(5_000_000)).chars().count(), NAME_MAX);
    }
}
