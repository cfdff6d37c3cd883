//! The architecture as a test: which module may name which, what must be absent, and size limits.
//!
//! The rules are in `ARCHITECTURE.md`; this test checks them. Sources are read as text, up to the
//! unit tests of each file: `source` separates code from comments and literals, `modules` finds
//! which module names which.

mod book;
mod modules;
mod source;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::Path;

use modules::Modules;
use source::{
    Function, all_files, before_tests, code_of, code_only, folder, functions, identifier, inside,
    literals, roots, rust_files,
};

/// Each module with the modules that it names, all of which are above it in this list. The list is
/// exact: an unused permission fails, and so does a missing one.
const MAY_NAME: &[(&str, &[&str])] = &[
    ("gnss", &[]),
    ("id", &[]),
    ("tenant", &[]),
    ("refusal", &[]),
    ("meters", &[]),
    ("panics", &[]),
    ("clock", &["gnss"]),
    ("config", &["gnss", "refusal"]),
    ("tls", &["refusal", "meters", "clock", "config"]),
    ("traces", &["refusal", "meters", "clock", "config", "tls"]),
    ("secrets", &["refusal"]),
    ("snapshot", &[]),
    ("graph", &["snapshot"]),
    ("lambda", &[]),
    ("models", &["gnss"]),
    ("formats", &["gnss", "refusal"]),
    ("simulation", &["gnss", "models"]),
    ("positioning", &["gnss", "config", "snapshot", "graph", "lambda", "models"]),
    ("store", &["gnss", "id", "tenant", "refusal", "meters", "panics", "config", "secrets"]),
    ("keys", &["id", "tenant", "refusal", "clock", "store"]),
    ("quotas", &["tenant", "refusal", "clock", "store"]),
    ("reception", &["gnss", "refusal", "formats"]),
    ("evaluation", &["gnss", "formats"]),
    (
        "aiding",
        &[
            "gnss",
            "id",
            "tenant",
            "refusal",
            "clock",
            "config",
            "models",
            "formats",
            "positioning",
            "store",
        ],
    ),
    ("cluster", &["meters", "store", "aiding"]),
    ("feeds", &["gnss", "tenant", "refusal", "panics", "clock", "tls", "formats", "aiding"]),
    ("recording", &["gnss", "config", "snapshot", "models", "formats", "positioning"]),
    (
        "session",
        &[
            "gnss",
            "id",
            "tenant",
            "refusal",
            "meters",
            "panics",
            "clock",
            "config",
            "snapshot",
            "positioning",
            "store",
            "quotas",
            "reception",
            "aiding",
            "recording",
            "traces",
        ],
    ),
    (
        "jobs",
        &[
            "gnss",
            "id",
            "tenant",
            "refusal",
            "clock",
            "quotas",
            "config",
            "formats",
            "evaluation",
            "store",
            "aiding",
            "feeds",
            "recording",
            "session",
            "snapshot",
        ],
    ),
    (
        "contract",
        &[
            "gnss",
            "tenant",
            "refusal",
            "meters",
            "clock",
            "config",
            "formats",
            "store",
            "reception",
            "aiding",
            "cluster",
            "feeds",
            "jobs",
            "session",
            "keys",
            "quotas",
            "tls",
            "secrets",
            "traces",
        ],
    ),
    ("grpc", &["refusal", "panics", "contract"]),
    ("http", &["refusal", "meters", "panics", "tls", "traces", "contract", "grpc"]),
    (
        "app",
        &[
            "gnss", "refusal", "config", "formats", "store", "aiding", "feeds", "jobs", "session",
            "cluster", "contract", "http", "keys", "quotas", "secrets", "tls", "traces",
        ],
    ),
    (
        "cli",
        &[
            "gnss",
            "tenant",
            "refusal",
            "meters",
            "clock",
            "keys",
            "quotas",
            "config",
            "formats",
            "simulation",
            "store",
            "evaluation",
            "aiding",
            "feeds",
            "recording",
            "session",
            "contract",
            "grpc",
            "app",
            "tls",
        ],
    ),
];

/// Modules that only compute. [`IMPURE`] lists the words that must not occur in them.
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

/// Words of satellite navigation, none of which may occur in `graph` and `lambda`.
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
/// Maximum lines of 90 % of the functions.
const MOST_FUNCTION_LINES: usize = 26;
/// Maximum number of parameters of a function, without `self`.
const PARAMETERS: usize = 5;
/// Functions with more: file, name, parameters.
const MANY_PARAMETERS: &[(&str, &str, usize)] = &[
    ("graph/optimizer.rs", "run_stage", 6),
    ("graph/sharing.rs", "add_group_border", 6),
    ("models/ionosphere/mod.rs", "broadcast_delay_m", 6),
    ("models/ionosphere/nequick.rs", "nequick_delay_m", 6),
    ("contract/service.rs", "new", 7),
    ("positioning/rtk/observed/residuals.rs", "gather", 6),
    ("session/batch.rs", "advance", 7),
    ("session/configuration.rs", "settings", 6),
    ("session/state.rs", "advance", 6),
];

#[test]
fn every_folder_has_its_rule() {
    let mut folders = BTreeSet::new();
    for root in roots() {
        let entries = fs::read_dir(&root).expect("the sources exist");
        let paths = entries.map(|entry| entry.expect("sources can be listed").path());
        for path in paths.filter(|path| path.is_dir()) {
            let name = path.file_name().expect("has a name").to_string_lossy().into_owned();
            assert!(folders.insert(name), "{} is in both packages", path.display());
        }
    }
    let ruled: BTreeSet<String> = MAY_NAME.iter().map(|(module, _)| (*module).to_owned()).collect();
    assert_eq!(folders, ruled, "folders of the sources and the table must be the same");
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
fn modules_name_what_the_table_says() {
    let modules = Modules::read();
    for (module, allowed) in MAY_NAME {
        let files = rust_files(&folder(module));
        assert!(!files.is_empty(), "{module} has no files: has it moved?");
        for file in files {
            let code = code_of(&file);
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
        let named = modules.neighbours(module);
        let unused: Vec<_> = allowed.iter().filter(|name| !named.contains(**name)).collect();
        assert!(unused.is_empty(), "{module} may name {unused:?}, and does not: take them out");
    }
}

/// Calls reach the desks by a `Caller`, which has a tenant, and not by the `Service`.
#[test]
fn calls_have_a_caller() {
    let files = rust_files(&folder("contract").join("calls"));
    assert!(!files.is_empty(), "src/contract/calls has no files: has it moved?");
    for file in files {
        assert!(!code_of(&file).contains("Service"), "{}: a call has the service", file.display());
    }
}

const FLOORS_BEGIN: &str = "<!-- floors: GRAPHFIX_ACCEPT=1 cargo test --test main tidy -->\n";
const FLOORS_END: &str = "<!-- end of floors -->";

/// The floors in `ARCHITECTURE.md` are those of the table: a module is one floor above the highest
/// module that it names.
#[test]
fn the_floors_are_those_of_the_map() {
    let mut floors: BTreeMap<&str, usize> = BTreeMap::new();
    for (module, named) in MAY_NAME {
        let above = named.iter().map(|name| floors[name] + 1).max();
        floors.insert(module, above.unwrap_or(0));
    }
    let top = floors.values().max().copied().unwrap_or(0);
    let mut table = "| floor | modules |\n|---|---|\n".to_owned();
    for floor in (0..=top).rev() {
        let of_floor = MAY_NAME.iter().filter(|(module, _)| floors[module] == floor);
        let names: Vec<_> = of_floor.map(|(module, _)| format!("`{module}`")).collect();
        writeln!(table, "| {floor} | {} |", names.join(", ")).unwrap();
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("ARCHITECTURE.md");
    let text = fs::read_to_string(&path).unwrap();
    let (before, rest) = text.split_once(FLOORS_BEGIN).expect("floors begin with their marker");
    let (printed, after) = rest.split_once(FLOORS_END).expect("floors end with their marker");
    if std::env::var_os("GRAPHFIX_ACCEPT").is_some() {
        fs::write(&path, format!("{before}{FLOORS_BEGIN}{table}{FLOORS_END}{after}")).unwrap();
    } else {
        assert_eq!(printed, table, "look at the change, then run with GRAPHFIX_ACCEPT=1");
    }
}

#[test]
fn pure_modules_do_nothing_but_compute() {
    for module in PURE {
        for file in rust_files(&folder(module)) {
            let code = code_of(&file);
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
        for file in rust_files(&folder(module)) {
            let text = fs::read_to_string(&file).expect("source is UTF-8").to_lowercase();
            for word in GNSS_WORDS {
                assert!(!text.contains(word), "{} says {word:?}", file.display());
            }
        }
    }
}

#[test]
fn the_vocabulary_is_not_serialised() {
    for file in rust_files(&folder("gnss")) {
        let code = code_of(&file);
        assert!(!code.contains("erialize"), "{}", file.display());
    }
}

#[test]
fn only_the_store_speaks_sql() {
    for (module, _) in MAY_NAME.iter().filter(|(module, _)| *module != "store") {
        for file in rust_files(&folder(module)) {
            let code = code_of(&file);
            assert!(!code.contains("sqlx::") && !code.contains("rusqlite::"), "{}", file.display());
        }
    }
}

#[test]
fn nothing_is_called_util() {
    for file in all_files() {
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
    for file in all_files() {
        let text = before_tests(&file);
        let lines = text.lines().count();
        if FILE_LINES < lines {
            wrong.push(format!("{} has {lines} lines before its tests", file.display()));
        }
        for Function { name, line, lines, .. } in functions(&code_only(&text)) {
            if FUNCTION_LINES < lines {
                wrong.push(format!("{}:{line}: fn {name} has {lines} lines", file.display()));
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

/// Functions with more than [`PARAMETERS`] are listed, with the number they have.
#[test]
fn functions_take_few_parameters() {
    let (mut wrong, mut listed) = (Vec::new(), BTreeSet::new());
    let mut lengths = Vec::new();
    for file in all_files() {
        let path = inside(&file).display().to_string();
        for Function { name, line, lines, parameters } in functions(&code_of(&file)) {
            lengths.push(lines);
            let entry = (path.as_str(), name.as_str(), parameters);
            match MANY_PARAMETERS.iter().find(|many| **many == entry) {
                Some(many) => _ = listed.insert(many),
                None if PARAMETERS < parameters => {
                    wrong.push(format!("{path}:{line}: fn {name} has {parameters} parameters"));
                }
                None => {}
            }
        }
    }
    let unused = MANY_PARAMETERS.iter().filter(|many| !listed.contains(many));
    wrong.extend(unused.map(|(path, name, n)| format!("{path}: no fn {name} with {n} parameters")));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));

    lengths.sort_unstable();
    let (count, tenth) = (lengths.len(), lengths[lengths.len() * 9 / 10]);
    println!("{count} functions, nine of ten have at most {tenth} lines");
    assert!(tenth <= MOST_FUNCTION_LINES, "nine of ten functions have at most {tenth} lines");
}

/// The modules of a folder, at any depth, do not name each other in a circle.
#[test]
fn no_module_names_itself_in_a_circle() {
    let circles = Modules::read().circles();
    assert!(circles.is_empty(), "modules name each other in a circle:\n{}", circles.join("\n"));
}

/// Messages are written for people who read English as a second language.
#[test]
fn messages_are_in_plain_words() {
    for file in all_files() {
        let text = before_tests(&file);
        for (line, literal) in literals(&text) {
            for riddle in ["is none", "are none"] {
                assert!(!literal.contains(riddle), "{}:{line}: {literal}", file.display());
            }
        }
    }
}
