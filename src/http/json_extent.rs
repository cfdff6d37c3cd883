//! Counts the content of a JSON body, before it is read as a message.

use memchr::memchr2;

use crate::contract::Extent;

/// Depth at which the elements of a request's own lists begin: `{"epochs": [`.
const OF_REQUEST: usize = 2;
/// Depth at which the elements of an epoch's lists begin: `{"epochs": [{"observations": [`.
const OF_EPOCH: usize = 4;

/// Counts the objects and values of `text`, whatever their names. Text that is not JSON is left to
/// the reader.
pub(super) fn extent_of(text: &[u8]) -> Extent {
    let (mut extent, mut depth, mut at) = (Extent::default(), 0_usize, 0);
    // Observations of the present epoch.
    let mut observations = None;
    while let Some(byte) = text.get(at) {
        at += 1;
        match byte {
            b'"' => at = end_of_text(text, at),
            b'{' | b'[' => {
                match (byte, depth) {
                    (b'{', OF_REQUEST) => observations = Some(0),
                    (b'{', OF_EPOCH) => observations = observations.map(|count| count + 1),
                    _ => extent.add_fields(1),
                }
                depth += 1;
            }
            b'}' | b']' => {
                depth = depth.saturating_sub(1);
                if let (b'}', OF_REQUEST, Some(count)) = (byte, depth, observations) {
                    extent.add_epoch(count);
                    observations = None;
                }
            }
            // The values of epochs and observations are counted with them.
            b',' if depth <= OF_REQUEST => extent.add_fields(1),
            _ => {}
        }
    }
    // The text ends within this epoch.
    observations.into_iter().for_each(|count| extent.add_epoch(count));
    extent
}

/// The offset after the closing quote of a string whose content begins at `at`.
fn end_of_text(text: &[u8], mut at: usize) -> usize {
    while let Some(found) = memchr2(b'"', b'\\', &text[at..]) {
        at += found + 1;
        if text[at - 1] == b'"' {
            return at;
        }
        at = (at + 1).min(text.len());
    }
    text.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(epochs: &[usize], fields: usize) -> Extent {
        let mut extent = Extent::default();
        epochs.iter().for_each(|observations| extent.add_epoch(*observations));
        extent.add_fields(fields);
        extent
    }

    #[test]
    fn epochs_and_observations_are_counted() {
        let text = br#"{"session": "{[{[{", "epochs": [
            {"seq": 1, "observations": [{"satellite": "G\"05", "code": "1C"}, {}]},
            {"odometry": {"displacementM": [1, 2, 3]}, "observations": []}]}"#;
        // Besides the epochs: braces and brackets of other lists and objects, and commas outside
        // of the epochs: {, epochs[, observations[ twice, odometry{, displacementM[; two commas.
        assert_eq!(extent_of(text), counted(&[2, 0], 8));
        assert_eq!(extent_of(b"{\"epochs\":[{\"observations\":[{},{},"), counted(&[2], 3));
        assert_eq!(extent_of(br#"{"bases":["","",""]}"#), counted(&[], 4));
        for text in [&b""[..], b"\"", b"\"\\", b"]]]}}}", b"{\"a\\\"\":[[[["] {
            extent_of(text);
        }
    }
}
