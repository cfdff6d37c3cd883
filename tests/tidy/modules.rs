//! Which module names which, and where modules name each other in a circle.
//!
//! A module is a file; a folder's `mod.rs` is the folder itself. The names of a file are those of
//! its `use` declarations and of its paths that begin with `crate`, `super` or `self`. A name that
//! a folder re-exports is followed to the file that defines it. A call of a method names nothing.

use std::collections::{BTreeMap, BTreeSet};

use super::source::{all_files, code_of, identifier, inside, starts_word};

/// A module's path, or that of an item in it, without `crate`.
type ModulePath = Vec<String>;

/// All modules of a tree of sources, except those that only tests compile.
pub(super) struct Modules(BTreeMap<ModulePath, Module>);

/// The paths that a module names, and those that it re-exports, by their new names.
#[derive(Default)]
struct Module {
    named: BTreeSet<ModulePath>,
    reexported: BTreeMap<String, ModulePath>,
}

impl Modules {
    /// Reads the sources of both packages, as the one tree that the service makes of them.
    pub(super) fn read() -> Self {
        let mut sources: BTreeMap<ModulePath, String> = BTreeMap::new();
        for file in all_files() {
            let inside = inside(&file).with_extension("");
            let mut path: ModulePath =
                inside.iter().map(|part| part.to_string_lossy().into_owned()).collect();
            path.pop_if(|name| name == "mod" || name == "lib");
            // Each package has a root.
            sources.entry(path).or_default().push_str(&code_of(&file));
        }
        Self::of(&sources)
    }

    /// The modules of these sources.
    fn of(sources: &BTreeMap<ModulePath, String>) -> Self {
        let of_tests: Vec<ModulePath> =
            sources.iter().flat_map(|(path, code)| modules_of_tests(path, code)).collect();
        let is_compiled = |path: &&ModulePath| !of_tests.iter().any(|test| path.starts_with(test));
        let paths: BTreeSet<&ModulePath> = sources.keys().filter(is_compiled).collect();
        let module = |path: &&ModulePath| ((*path).clone(), module(path, &sources[*path], &paths));
        Self(paths.iter().map(module).collect())
    }

    /// First-level modules that a first-level module names anywhere below it.
    pub(super) fn neighbours(&self, module: &str) -> BTreeSet<String> {
        let below = self.0.iter().filter(|(path, _)| path.first().is_some_and(|m| m == module));
        let named = below.flat_map(|(_, inside)| &inside.named).filter_map(|path| path.first());
        named.filter(|name| *name != module).cloned().collect()
    }

    /// Circles among the modules of one folder, for folders of every depth. Files in a module's own
    /// folder count as this module. Each circle is a text of module paths.
    pub(super) fn circles(&self) -> Vec<String> {
        let mut circles = BTreeSet::new();
        let folders: BTreeSet<&[String]> =
            self.0.keys().flat_map(|path| (0..path.len()).map(|depth| &path[..depth])).collect();
        for folder in folders {
            let arrows = self.arrows(folder);
            for start in arrows.keys() {
                let there = reached(&arrows, start);
                if there.contains(start) {
                    let comes_back = |name: &&&String| reached(&arrows, name).contains(start);
                    let circle: Vec<&str> =
                        there.iter().filter(comes_back).map(|name| name.as_str()).collect();
                    circles.insert(format!("{}: {}", folder.join("::"), circle.join(", ")));
                }
            }
        }
        circles.into_iter().collect()
    }

    /// Child of a folder → other children that it names.
    fn arrows(&self, folder: &[String]) -> BTreeMap<&String, BTreeSet<&String>> {
        let mut arrows: BTreeMap<&String, BTreeSet<&String>> = BTreeMap::new();
        for (path, module) in &self.0 {
            let Some((from, _)) = below(path, folder) else { continue };
            for name in &module.named {
                let Some((to, _)) = self.definition(name).and_then(|to| below(to, folder)) else {
                    continue;
                };
                if from != to {
                    arrows.entry(from).or_default().insert(to);
                }
            }
        }
        arrows
    }

    /// The module that defines the target of a path; `None` outside the crate.
    fn definition(&self, path: &[String]) -> Option<&ModulePath> {
        let mut path = path;
        // A chain of re-exports is no longer than the tree is deep.
        for _ in 0..10 {
            let depth =
                (0..=path.len()).rev().find(|depth| self.0.contains_key(&path[..*depth]))?;
            let (here, module) = self.0.get_key_value(&path[..depth])?;
            match path.get(depth).and_then(|name| module.reexported.get(name)) {
                Some(further) => path = further,
                None => return Some(here),
            }
        }
        None
    }
}

/// The child of a folder in which a path lies, and the path's rest.
fn below<'a>(path: &'a [String], folder: &[String]) -> Option<(&'a String, &'a [String])> {
    path.strip_prefix(folder)?.split_first()
}

/// The modules that can be reached from a start by one arrow or more.
fn reached<'a>(
    arrows: &BTreeMap<&'a String, BTreeSet<&'a String>>,
    start: &String,
) -> BTreeSet<&'a String> {
    let mut reached = BTreeSet::new();
    let mut open: Vec<&String> = arrows.get(start).into_iter().flatten().copied().collect();
    while let Some(next) = open.pop() {
        if reached.insert(next) {
            open.extend(arrows.get(next).into_iter().flatten());
        }
    }
    reached
}

/// Modules that a module declares for tests alone.
fn modules_of_tests(path: &ModulePath, code: &str) -> Vec<ModulePath> {
    let declared = code.split("#[cfg(test)]").skip(1).filter_map(|rest| {
        let (declaration, _) = rest.split_once(';')?;
        let (visibility, name) = declaration.split_once("mod ")?;
        let visibility = visibility.trim();
        (visibility.is_empty() || visibility.starts_with("pub")).then(|| identifier(name))
    });
    let child = |name: &str| path.iter().cloned().chain([name.to_owned()]).collect();
    declared.map(child).collect()
}

/// The paths that a module's code names and re-exports.
fn module(path: &ModulePath, code: &str, paths: &BTreeSet<&ModulePath>) -> Module {
    let mut module = Module::default();
    for (at, _) in code.match_indices("use ").filter(|(at, _)| starts_word(code, *at)) {
        let Some((tree, _)) = code[at + 4..].split_once(';') else { continue };
        let line = code[..at].rsplit('\n').next().unwrap_or("").trim_start();
        for (name, target) in leaves(tree) {
            let Some(target) = absolute(&target, path, paths) else { continue };
            if line.starts_with("pub") {
                module.reexported.insert(name, target.clone());
            }
            module.named.insert(target);
        }
    }
    for start in ["crate::", "super::", "self::"] {
        for (at, _) in code.match_indices(start).filter(|(at, _)| starts_path(code, *at)) {
            let end = code[at..].find(|c: char| !c.is_alphanumeric() && c != '_' && c != ':');
            let written = &code[at..end.map_or(code.len(), |end| at + end)];
            module.named.extend(absolute(&parts(written), path, paths));
        }
    }
    module
}

fn starts_path(code: &str, at: usize) -> bool {
    starts_word(code, at) && !code[..at].ends_with("::")
}

/// The paths of a `use` tree, each with the name that it gets.
fn leaves(tree: &str) -> Vec<(String, ModulePath)> {
    let Some((prefix, inside)) = tree.split_once('{') else {
        let (written, alias) = tree.split_once(" as ").unwrap_or((tree, ""));
        let mut path = parts(written);
        path.pop_if(|last| last == "self" && written.contains("::"));
        let last = path.last().cloned().unwrap_or_default();
        let name = if alias.is_empty() { last } else { alias.trim().to_owned() };
        return vec![(name, path)];
    };
    let inside = inside.rsplit_once('}').map_or(inside, |(inside, _)| inside);
    let mut depth = 0;
    let members = inside.split(|c| {
        depth += i32::from(c == '{') - i32::from(c == '}');
        c == ',' && depth == 0
    });
    members
        .filter(|member| !member.trim().is_empty())
        .flat_map(|member| leaves(&format!("{prefix}{}", member.trim())))
        .collect()
}

fn parts(path: &str) -> ModulePath {
    path.split("::").map(|part| part.trim().to_owned()).filter(|part| !part.is_empty()).collect()
}

/// A path as from the crate's root; `None` where it begins outside the crate.
fn absolute(
    path: &[String],
    module: &ModulePath,
    paths: &BTreeSet<&ModulePath>,
) -> Option<ModulePath> {
    let (first, rest) = path.split_first()?;
    let from = |base: &[String], rest: &[String]| [base, rest].concat();
    match first.as_str() {
        "crate" => Some(rest.to_vec()),
        "self" => Some(from(module, rest)),
        "super" => {
            let (_, parent) = module.split_last()?;
            match rest.first().is_some_and(|next| next == "super") {
                true => absolute(rest, &parent.to_vec(), paths),
                false => Some(from(parent, rest)),
            }
        }
        _ => {
            let child = from(module, std::slice::from_ref(first));
            paths.contains(&child).then(|| from(module, path))
        }
    }
}

/// Circles of two and three are found: through a re-export, a folder, a deep path, and the middle
/// of a file that declares a module of tests. No circle is reported where none exists.
#[test]
fn circles_are_seen_at_every_depth() {
    let circles = |sources: &[(&str, &str)]| {
        let sources = sources.iter().map(|(path, code)| (parts(path), (*code).to_owned()));
        Modules::of(&sources.collect()).circles()
    };
    let hub = ("x", "mod a;\n#[cfg(test)]\nmod sample;\nmod b;\npub use b::{C as D, E};");
    let (top, sample) = (("", "pub mod x;"), ("x::sample", "use super::{a, b};"));
    let b = ("x::b", "use super::a::A;");
    assert_eq!(circles(&[top, hub, sample, b, ("x::a", "use super::D;")]), ["x: a, b"]);
    assert_eq!(circles(&[top, hub, sample, b, ("x::a", "fn f() { super::E::g() }")]), ["x: a, b"]);
    assert_eq!(circles(&[top, hub, sample, b, ("x::a", "use super::{sample, N};")]).len(), 0);
    let deep = [("x::a", "mod c;"), ("x::a::c", "use crate::x::{self, b::{self}};")];
    assert_eq!(circles(&[top, hub, b, deep[0], deep[1]]), ["x: a, b"]);
    let three =
        [("x::a", "use super::b;"), ("x::b", "use super::c::Y;"), ("x::c", "use super::a;")];
    assert_eq!(circles(&[top, ("x", ""), three[0], three[1], three[2]]), ["x: a, b, c"]);
    let up = [("y", "use crate::x::a;"), ("x::a", "use super::super::y::Z;")];
    assert_eq!(circles(&[top, ("x", ""), up[0], up[1]]), [": x, y"]);
}
