//! Texts that must not change unnoticed, in `tests/support/snapshots`.

use std::path::Path;

use serde_json::Value;

/// Fails if `text` differs from the snapshot; `GRAPHFIX_ACCEPT=1` stores the new text.
pub(crate) fn assert(name: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/snapshots").join(name);
    if std::env::var_os("GRAPHFIX_ACCEPT").is_some() {
        std::fs::write(&path, text).unwrap();
    }
    let kept = std::fs::read_to_string(&path).unwrap_or_default();
    let line = kept.lines().zip(text.lines()).position(|(a, b)| a != b);
    assert!(
        kept == text,
        "{} differs from line {}; look at the change, then run with GRAPHFIX_ACCEPT=1",
        path.display(),
        line.unwrap_or_else(|| kept.lines().count().min(text.lines().count())) + 1
    );
}

/// The same document with the keys of every object in a fixed order, which JSON does not define.
pub(crate) fn sorted(document: &Value) -> Value {
    match document {
        Value::Object(members) => {
            let mut members: Vec<_> = members.iter().collect();
            members.sort_by_key(|(name, _)| *name);
            members.into_iter().map(|(name, value)| (name.clone(), sorted(value))).collect()
        }
        Value::Array(values) => values.iter().map(sorted).collect(),
        plain => plain.clone(),
    }
}
