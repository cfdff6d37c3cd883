//! The architecture as a test: who may name whom, what is absent where, and how long things may be.
//!
//! The rules stand in `ARCHITECTURE.md`; here they are held. Sources are read as text, with
//! comments and the contents of string literals blanked, up to the unit tests of each file.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Module → modules it may name, floor by floor: a module names only what stands above it here.
const MAY_NAME: &[(&str, &[&str])] = &[
    ("gnss", &[]),
    ("refusal", &[]),
    ("id", &[]),
    ("clock", &["gnss"]),
    ("config", &["gnss", "refusal"]),
    ("snapshot", &[]),
    ("graph", &["snapshot"]),
    ("lambda", &[]),
    ("models", &["gnss"]),
    ("formats", &["gnss", "refusal"]),
    ("simulation", &["gnss", "models"]),
    ("positioning", &["gnss", "config", "snapshot", "models", "graph", "lambda"]),
    ("store", &["gnss", "refusal", "config"]),
    ("reception", &["gnss", "refusal", "formats"]),
    ("evaluation", &["gnss", "formats"]),
    (
        "aiding",
        &["gnss", "refusal", "id", "clock", "config", "models", "formats", "positioning", "store"],
    ),
    ("feeds", &["gnss", "refusal", "clock", "config", "formats", "aiding"]),
    (
        "session",
        &[
            "gnss",
            "refusal",
            "id",
            "clock",
            "config",
            "snapshot",
            "models",
            "positioning",
            "store",
            "reception",
            "aiding",
        ],
    ),
    (
        "contract",
        &[
            "gnss",
            "refusal",
            "clock",
            "config",
            "formats",
            "positioning",
            "store",
            "reception",
            "aiding",
            "feeds",
            "session",
        ],
    ),
    ("grpc", &["gnss", "refusal", "config", "aiding", "session", "contract"]),
    ("http", &["gnss", "refusal", "config", "aiding", "session", "contract", "grpc"]),
    (
        "cli",
        &[
            "gnss",
            "refusal",
            "config",
            "models",
            "formats",
            "simulation",
            "positioning",
            "evaluation",
            "store",
            "aiding",
            "feeds",
            "session",
            "contract",
            "grpc",
            "http",
        ],
    ),
];

/// Modules that compute and nothing else, and what must not occur in them.
const PURE: &[&str] =
    &["gnss", "snapshot", "models", "graph", "lambda", "formats", "positioning", "reception"];
const IMPURE: &[&str] = &[
    "async ",
    ".await",
    "Instant",
    "SystemTime",
    "rand::",
    "std::fs",
    "std::net",
    "File::",
    "tokio::",
    "tracing::",
    "println!",
    "eprintln!",
    "std::env",
    "std::thread",
];

/// Words of satellite navigation, none of which `graph` and `lambda` know.
const GNSS_WORDS: &[&str] = &[
    "gnss",
    "gps",
    "satellite",
    "pseudorange",
    "doppler",
    "ephemeris",
    "ecef",
    "galileo",
    "beidou",
    "glonass",
    "receiver",
];

const FILE_LINES: usize = 500;
const FUNCTION_LINES: usize = 70;
const LINE_CHARACTERS: usize = 100;

fn source_root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten() {
        let path = entry.expect("folder can be listed").path();
        if path.is_dir() {
            found.extend(rust_files(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// A file's text up to its unit tests.
fn before_tests(file: &Path) -> String {
    let text = fs::read_to_string(file).expect("source is UTF-8");
    let end = text.find("#[cfg(test)]\nmod ").unwrap_or(text.len());
    text[..end].to_owned()
}

/// Comments and the contents of literals turned to blanks, line structure kept.
fn code_only(text: &str) -> String {
    let mut code = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let (length, keep) = token(rest, first);
        let (token, after) = rest.split_at(length);
        if keep {
            code.push_str(token);
        } else {
            code.extend(token.chars().map(|c| if c == '\n' { '\n' } else { ' ' }));
        }
        rest = after;
    }
    code
}

/// Length of the next token in bytes, and whether it is code.
fn token(rest: &str, first: char) -> (usize, bool) {
    let upto = |end: Option<usize>| end.unwrap_or(rest.len());
    if rest.starts_with("//") {
        return (upto(rest.find('\n')), false);
    }
    if rest.starts_with("/*") {
        return (upto(rest.find("*/").map(|i| i + 2)), false);
    }
    for hashes in ["###", "##", "#", ""] {
        let open = format!("r{hashes}\"");
        if rest.starts_with(&open) {
            let close = format!("\"{hashes}");
            let end = rest[open.len()..].find(&close).map(|i| i + open.len() + close.len());
            return (upto(end), false);
        }
    }
    if first == '"' {
        let mut escaped = false;
        let end = rest[1..].find(|c| {
            let closes = c == '"' && !escaped;
            escaped = c == '\\' && !escaped;
            closes
        });
        return (upto(end.map(|i| i + 2)), false);
    }
    if first == '\'' {
        let mut chars = rest[1..].char_indices();
        match (chars.next(), chars.next()) {
            (Some((_, '\\')), _) => {
                return (upto(rest[2..].find('\'').map(|i| i + 3)).max(4), false);
            }
            (Some((_, c)), Some((_, '\''))) => return (2 + c.len_utf8(), false),
            _ => return (1, true),
        }
    }
    if first.is_alphanumeric() || first == '_' {
        return (upto(rest.find(|c: char| !c.is_alphanumeric() && c != '_')), true);
    }
    (first.len_utf8(), true)
}

/// The identifier that `text` begins with.
fn identifier(text: &str) -> &str {
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len());
    &text[..end]
}

#[test]
fn every_folder_has_its_rule() {
    let folders: BTreeSet<String> = fs::read_dir(source_root())
        .expect("src exists")
        .map(|entry| entry.expect("src can be listed").path())
        .filter(|path| path.is_dir())
        .map(|path| path.file_name().expect("has a name").to_string_lossy().into_owned())
        .collect();
    let ruled: BTreeSet<String> = MAY_NAME.iter().map(|(module, _)| (*module).to_owned()).collect();
    assert_eq!(folders, ruled, "folders of src and the table must be the same");
}

#[test]
fn the_table_has_no_cycle() {
    let mut seen = BTreeSet::new();
    for (module, allowed) in MAY_NAME {
        for name in *allowed {
            assert!(seen.contains(name), "{module} may name {name}, which stands below it");
        }
        seen.insert(module);
    }
}

#[test]
fn modules_name_only_what_they_may() {
    for (module, allowed) in MAY_NAME {
        let files = rust_files(&source_root().join(module));
        assert!(!files.is_empty(), "src/{module} has no files: has it moved?");
        for file in files {
            let code = code_only(&before_tests(&file));
            for named in code.split("crate::").skip(1) {
                // `crate::{a, b}` gives "" and fails: one module per `use`.
                let name = identifier(named);
                assert!(
                    name == *module || allowed.contains(&name),
                    "{} names {name:?}, which {module} may not",
                    file.display()
                );
            }
            assert!(!code.contains("super::super::"), "{}: super::super::", file.display());
        }
    }
}

#[test]
fn pure_modules_do_nothing_but_compute() {
    for module in PURE {
        for file in rust_files(&source_root().join(module)) {
            let code = code_only(&before_tests(&file));
            for word in IMPURE {
                let found = code.lines().position(|line| line.contains(word));
                assert!(found.is_none(), "{}:{}: {word:?}", file.display(), found.unwrap_or(0) + 1);
            }
        }
    }
}

#[test]
fn graph_and_lambda_know_no_gnss_word() {
    for module in ["graph", "lambda"] {
        for file in rust_files(&source_root().join(module)) {
            let text = fs::read_to_string(&file).expect("source is UTF-8").to_lowercase();
            for word in GNSS_WORDS {
                assert!(!text.contains(word), "{} says {word:?}", file.display());
            }
        }
    }
}

#[test]
fn the_vocabulary_is_not_serialised() {
    for file in rust_files(&source_root().join("gnss")) {
        let code = code_only(&before_tests(&file));
        assert!(!code.contains("erialize"), "{}", file.display());
    }
}

#[test]
fn only_the_store_speaks_sql() {
    for (module, _) in MAY_NAME.iter().filter(|(module, _)| *module != "store") {
        for file in rust_files(&source_root().join(module)) {
            assert!(!code_only(&before_tests(&file)).contains("sqlx::"), "{}", file.display());
        }
    }
}

#[test]
fn nothing_is_called_util() {
    for file in rust_files(&source_root()) {
        for part in file.iter().map(|part| part.to_string_lossy()) {
            let stem = part.trim_end_matches(".rs");
            let banned = ["util", "utils", "common", "helper", "helpers", "manager", "misc"];
            assert!(!banned.contains(&stem), "{}", file.display());
        }
    }
}

#[test]
fn files_functions_and_lines_are_short() {
    let mut wrong = Vec::new();
    for file in rust_files(&source_root()) {
        let text = before_tests(&file);
        let lines = text.lines().count();
        if FILE_LINES < lines {
            wrong.push(format!("{} has {lines} lines before its tests", file.display()));
        }
        for (line, length, name) in functions(&code_only(&text)) {
            if FUNCTION_LINES < length {
                wrong.push(format!("{}:{line}: fn {name} has {length} lines", file.display()));
            }
        }
        for (index, line) in text.lines().enumerate() {
            if LINE_CHARACTERS < line.chars().count() {
                wrong.push(format!("{}:{}: a long line", file.display(), index + 1));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Functions of a text whose comments and literals are blanked: first line, lines, name.
fn functions(code: &str) -> Vec<(usize, usize, String)> {
    let mut found = Vec::new();
    for (at, _) in code.match_indices("fn ") {
        let starts_word = !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_');
        let name = identifier(&code[at + 3..]);
        let Some(open) = code[at..].find(['{', ';']) else { continue };
        if !starts_word || name.is_empty() || code[at + open..].starts_with(';') {
            continue;
        }
        let mut depth = 0;
        let end = code[at + open..].find(|c| {
            depth += i32::from(c == '{') - i32::from(c == '}');
            depth == 0
        });
        let body = &code[at..at + open + end.expect("braces close")];
        let first = code[..at].matches('\n').count() + 1;
        found.push((first, body.matches('\n').count() + 1, name.to_owned()));
    }
    found
}

/// Child modules of one folder may not name each other in a circle.
#[test]
fn siblings_name_each_other_without_a_circle() {
    for (module, _) in MAY_NAME {
        let folder = source_root().join(module);
        let named = sibling_names(&folder);
        for start in named.keys() {
            let mut reached = BTreeSet::new();
            let mut open: Vec<&String> = named[start].iter().collect();
            while let Some(next) = open.pop() {
                if reached.insert(next) {
                    open.extend(named.get(next).into_iter().flatten());
                }
            }
            assert!(!reached.contains(start), "src/{module}/{start} names itself in a circle");
        }
    }
}

/// Child module → siblings it names, through `super::` or the folder's re-exports.
fn sibling_names(folder: &Path) -> BTreeMap<String, BTreeSet<String>> {
    let own = code_only(&before_tests(&folder.join("mod.rs")));
    let children: BTreeSet<String> = own
        .lines()
        .filter_map(|line| line.trim_start().trim_start_matches("pub ").strip_prefix("mod "))
        .map(|rest| identifier(rest).to_owned())
        .collect();
    let mut exported = BTreeMap::new();
    for statement in own.split("pub use ").skip(1) {
        let statement = statement.split(';').next().unwrap_or("");
        let child = identifier(statement);
        for name in statement.split(|c: char| !c.is_alphanumeric() && c != '_') {
            if children.contains(child) && !name.is_empty() {
                exported.insert(name.to_owned(), child.to_owned());
            }
        }
    }
    let mut named: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for child in &children {
        let mut files = rust_files(&folder.join(child));
        files.extend(Some(folder.join(format!("{child}.rs"))).filter(|file| file.is_file()));
        let into = named.entry(child.clone()).or_default();
        for file in files {
            // Inside a child's own folder `super` is the child, so only its `mod.rs` counts.
            let nested = folder.join(child).join("mod.rs") != file && file.parent() != Some(folder);
            let code = code_only(&before_tests(&file));
            for mention in code.split("super::").skip(1).filter(|_| !nested) {
                let mention = mention.split(';').next().unwrap_or("");
                let until = if mention.starts_with('{') { mention } else { identifier(mention) };
                for name in until.split(|c: char| !c.is_alphanumeric() && c != '_') {
                    let target = children.get(name).or_else(|| exported.get(name));
                    into.extend(target.filter(|target| *target != child).cloned());
                }
            }
        }
    }
    named
}

/// The rules themselves work: what they should find they find.
#[test]
fn the_scanner_sees_code_and_not_words() {
    let code = code_only("let a = \"crate::x\"; // crate::y\nlet b = '\"'; crate::z /* } */ 'a {}");
    assert!(!code.contains("crate::x") && !code.contains("crate::y") && code.contains("crate::z"));
    let lengths = functions("fn a() {\n  {\n  }\n}\nfn b();\nimpl X { fn c(&self) {} }");
    let seen: Vec<_> = lengths.iter().map(|(line, n, name)| (*line, *n, name.as_str())).collect();
    assert_eq!(seen, [(1, 4, "a"), (6, 1, "c")]);
}
