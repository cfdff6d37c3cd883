//! Sources as text: the list of files, and their division into code, comments and literals.

use std::fs;
use std::path::{Path, PathBuf};

/// The folders of the sources: those of the package that computes, and those of the service.
const ROOTS: [&str; 2] = ["compute/src", "src"];

pub(super) fn roots() -> [PathBuf; 2] {
    ROOTS.map(|root| Path::new(env!("CARGO_MANIFEST_DIR")).join(root))
}

/// The folder of a module of the first level.
pub(super) fn folder(module: &str) -> PathBuf {
    let [compute, service] = roots().map(|root| root.join(module));
    if compute.exists() { compute } else { service }
}

/// Every Rust file of both packages, in order.
pub(super) fn all_files() -> Vec<PathBuf> {
    roots().iter().flat_map(|root| rust_files(root)).collect()
}

/// A file's path inside the sources of its package.
pub(super) fn inside(file: &Path) -> &Path {
    let found = roots().into_iter().find_map(|root| file.strip_prefix(root).ok());
    found.expect("found below one of them")
}

/// Every Rust file below a folder, in order.
pub(super) fn rust_files(folder: &Path) -> Vec<PathBuf> {
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
pub(super) fn before_tests(file: &Path) -> String {
    let text = fs::read_to_string(file).expect("source is UTF-8");
    let end = text.find("#[cfg(test)]\nmod tests {").unwrap_or(text.len());
    text[..end].to_owned()
}

/// A file's code up to its unit tests: comments and literals are blank, lines stay lines.
pub(super) fn code_of(file: &Path) -> String {
    code_only(&before_tests(file))
}

/// The kind of a token of a source.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Code,
    Comment,
    Literal,
}

/// Comments and the contents of literals turned to blanks, line structure kept.
pub(super) fn code_only(text: &str) -> String {
    let mut code = String::with_capacity(text.len());
    for (token, kind) in tokens(text) {
        if kind == Kind::Code {
            code.push_str(token);
        } else {
            code.extend(token.chars().map(|c| if c == '\n' { '\n' } else { ' ' }));
        }
    }
    code
}

/// The literals of a text, quotes included, each with its first line.
pub(super) fn literals(text: &str) -> Vec<(usize, &str)> {
    let mut line = 1;
    let mut found = Vec::new();
    for (token, kind) in tokens(text) {
        if kind == Kind::Literal {
            found.push((line, token));
        }
        line += token.matches('\n').count();
    }
    found
}

fn tokens(text: &str) -> impl Iterator<Item = (&str, Kind)> {
    let mut rest = text;
    std::iter::from_fn(move || {
        let first = rest.chars().next()?;
        let (length, kind) = token(rest, first);
        let (token, after) = rest.split_at(length);
        rest = after;
        Some((token, kind))
    })
}

/// Length of the next token in bytes, and what it is.
fn token(rest: &str, first: char) -> (usize, Kind) {
    let upto = |end: Option<usize>| end.unwrap_or(rest.len());
    if rest.starts_with("//") {
        return (upto(rest.find('\n')), Kind::Comment);
    }
    if rest.starts_with("/*") {
        return (upto(rest.find("*/").map(|i| i + 2)), Kind::Comment);
    }
    for hashes in ["###", "##", "#", ""] {
        let open = format!("r{hashes}\"");
        if rest.starts_with(&open) {
            let close = format!("\"{hashes}");
            let end = rest[open.len()..].find(&close).map(|i| i + open.len() + close.len());
            return (upto(end), Kind::Literal);
        }
    }
    if first == '"' {
        let mut escaped = false;
        let end = rest[1..].find(|c| {
            let closes = c == '"' && !escaped;
            escaped = c == '\\' && !escaped;
            closes
        });
        return (upto(end.map(|i| i + 2)), Kind::Literal);
    }
    if first == '\'' {
        let mut chars = rest[1..].char_indices();
        match (chars.next(), chars.next()) {
            (Some((_, '\\')), _) => {
                return (upto(rest[2..].find('\'').map(|i| i + 3)).max(4), Kind::Literal);
            }
            (Some((_, c)), Some((_, '\''))) => return (2 + c.len_utf8(), Kind::Literal),
            _ => return (1, Kind::Code),
        }
    }
    if first.is_alphanumeric() || first == '_' {
        return (identifier(rest).len(), Kind::Code);
    }
    (first.len_utf8(), Kind::Code)
}

/// The identifier that `text` begins with.
pub(super) fn identifier(text: &str) -> &str {
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len());
    &text[..end]
}

/// A function of a text.
pub(super) struct Function {
    pub(super) name: String,
    /// First line, from one.
    pub(super) line: usize,
    pub(super) lines: usize,
    /// Parameters besides `self`.
    pub(super) parameters: usize,
}

/// Functions with a body, of a text whose comments and literals are blanked.
pub(super) fn functions(code: &str) -> Vec<Function> {
    let mut found = Vec::new();
    for (at, _) in code.match_indices("fn ") {
        let name = identifier(&code[at + 3..]);
        let Some(open) = signature_end(&code[at..]) else { continue };
        if !starts_word(code, at) || name.is_empty() || code[at + open..].starts_with(';') {
            continue;
        }
        let mut depth = 0;
        let end = code[at + open..].find(|c| {
            depth += i32::from(c == '{') - i32::from(c == '}');
            depth == 0
        });
        let body = &code[at..at + open + end.expect("braces close")];
        found.push(Function {
            name: name.to_owned(),
            line: code[..at].matches('\n').count() + 1,
            lines: body.matches('\n').count() + 1,
            parameters: parameters(&code[at + 3 + name.len()..at + open]),
        });
    }
    found
}

/// Byte at which a function's body begins, or the `;` in its place. The `;` of `[u8; 4]` does not
/// count.
fn signature_end(code: &str) -> Option<usize> {
    let mut depth = 0;
    code.find(|c| {
        depth += i32::from("([".contains(c)) - i32::from(")]".contains(c));
        depth == 0 && "{;".contains(c)
    })
}

/// Number of parameters besides `self` in a signature, which begins behind the function's name.
fn parameters(signature: &str) -> usize {
    // An arrow's `>` closes nothing.
    let signature = signature.replace("->", "  ");
    let (mut depth, mut is_listed) = (0, false);
    let (mut count, mut parameter) = (0, String::new());
    for c in signature.chars() {
        match c {
            '(' if depth == 0 => is_listed = true,
            ',' | ')' if is_listed && depth == 1 => {
                let is_self = parameter.split([':', ' ', '&']).any(|word| word == "self");
                count += usize::from(!parameter.trim().is_empty() && !is_self);
                parameter.clear();
                if c == ')' {
                    return count;
                }
            }
            c if is_listed => parameter.push(c),
            _ => {}
        }
        depth += i32::from("([<".contains(c)) - i32::from(")]>".contains(c));
    }
    panic!("the parameters do not end: {signature}")
}

/// Whether a word begins at that byte: no character of an identifier is before it.
pub(super) fn starts_word(code: &str, at: usize) -> bool {
    !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_')
}

/// The scanner finds code, literals and functions where they are, and nowhere else.
#[test]
fn the_scanner_sees_code_and_not_words() {
    let text = "let a = \"crate::x\"; // crate::y\nlet b = '\"'; crate::z /* } */ 'a {}";
    let code = code_only(text);
    assert!(!code.contains("crate::x") && !code.contains("crate::y") && code.contains("crate::z"));
    assert_eq!(literals(text), [(1, "\"crate::x\""), (2, "'\"'")]);
    let text = "fn a() {\n  {\n  }\n}\nfn b();\nimpl X { fn c(&mut self, _: u8) {} }
        fn d<F: Fn(u8, u8) -> u8>(\n f: [F; 2],\n by: BTreeMap<u8, (u8, u8)>,\n) -> (u8, u8) {}";
    let found = functions(text);
    let seen: Vec<_> =
        found.iter().map(|f| (f.line, f.lines, f.name.as_str(), f.parameters)).collect();
    assert_eq!(seen, [(1, 4, "a", 0), (6, 1, "c", 1), (7, 4, "d", 2)]);
}
