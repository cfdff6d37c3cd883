//! The documentation: every page is in the book, and every link inside the repository leads
//! somewhere.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The repository.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Pages of `docs/`, by their path below it.
fn pages() -> BTreeSet<PathBuf> {
    let docs = root().join("docs");
    let mut folders = vec![docs.clone()];
    let mut pages = BTreeSet::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                pages.insert(path.strip_prefix(&docs).unwrap().to_owned());
            }
        }
    }
    pages
}

/// Lines of a page that are text, not code.
fn text_lines(page: &Path) -> Vec<String> {
    let (mut fenced, mut kept) = (false, Vec::new());
    for line in fs::read_to_string(page).unwrap().lines() {
        if line.starts_with("```") {
            fenced = !fenced;
        } else if !fenced && !line.starts_with("    ") {
            kept.push(line.to_owned());
        }
    }
    kept
}

/// Targets of the links of a page, images too.
fn links(page: &Path) -> Vec<String> {
    let lines = text_lines(page);
    let targets = lines.iter().flat_map(|line| line.split("](").skip(1));
    targets.map(|rest| rest.split(')').next().unwrap().to_owned()).collect()
}

/// The anchors of a page's headings, as GitHub and mdbook make them.
fn anchors(page: &Path) -> BTreeSet<String> {
    let lines = text_lines(page);
    let headings = lines.iter().filter(|line| line.starts_with('#'));
    let anchor = |heading: &str| {
        let lower = heading.to_lowercase();
        let kept = lower.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
        kept.map(|c| if c == ' ' { '-' } else { c }).collect()
    };
    headings.map(|line| anchor(line.trim_start_matches('#').trim())).collect()
}

/// The reason why a link of a page is wrong, or `None`.
fn fault(page: &Path, link: &str) -> Option<String> {
    if link.contains("://") {
        return None;
    }
    let (file, anchor) = link.split_once('#').map_or((link, None), |(f, a)| (f, Some(a)));
    let target = match file {
        "" => page.to_owned(),
        file => page.parent().unwrap().join(file),
    };
    let Ok(target) = target.canonicalize() else { return Some(format!("{link} does not exist")) };
    let docs = root().join("docs").canonicalize().unwrap();
    let is_of_the_book = page.canonicalize().unwrap().starts_with(&docs);
    if is_of_the_book && !target.starts_with(&docs) {
        return Some(format!("{link} leads out of docs/, where the book has nothing"));
    }
    match anchor {
        Some(anchor) if !anchors(&target).contains(anchor) => {
            Some(format!("{link} has no such heading"))
        }
        _ => None,
    }
}

#[test]
fn every_page_is_in_the_book() {
    let summary = root().join("docs/SUMMARY.md");
    let listed: Vec<PathBuf> = links(&summary).iter().map(PathBuf::from).collect();
    let once: BTreeSet<PathBuf> = listed.iter().cloned().collect();
    assert_eq!(listed.len(), once.len(), "a page is twice in docs/SUMMARY.md");
    let mut pages = pages();
    assert!(pages.remove(Path::new("SUMMARY.md")));
    assert_eq!(pages, once, "left: pages of docs/; right: those of docs/SUMMARY.md");
}

#[test]
fn every_link_leads_somewhere() {
    let docs = pages().into_iter().map(|page| root().join("docs").join(page));
    let others = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "clients/python/README.md"];
    let (mut count, mut faults) = (0, Vec::new());
    for page in docs.chain(others.map(|page| root().join(page))) {
        for link in links(&page) {
            count += 1;
            faults.extend(fault(&page, &link).map(|why| format!("{}: {why}", page.display())));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(50 < count, "only {count} links: are they found?");
}

#[test]
fn wrong_links_are_found() {
    let page = root().join("docs/guides/operator.md");
    for (link, right) in [
        ("../operations.md#alerts", true),
        ("https://example.org/none.md", true),
        ("../operations.md#no-such-heading", false),
        ("../none.md", false),
        ("../../README.md", false),
    ] {
        assert_eq!(fault(&page, link).is_none(), right, "{link}");
    }
}
