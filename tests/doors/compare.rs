//! `graphfix compare` as users call it, on a simulated recording.

use std::path::Path;
use std::process::{Command, Output};

fn graphfix(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_graphfix"))
        .current_dir(folder)
        .args(arguments)
        .output()
        .expect("the program can be started")
}

/// A minute of the urban canyon in `folder`.
fn simulate(folder: &Path) {
    let arguments =
        ["simulate", "--scenario", "urban-canyon", "--seed", "5", "--duration", "60", "--output"];
    let output = graphfix(folder, &[&arguments[..], &["."]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

const INPUT: [&str; 5] = ["compare", "--rover", "rover.obs", "--nav", "navigation.rnx"];

#[test]
fn a_report_holds_the_table_and_the_figures() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path());
    let what = ["--truth", "truth.csv", "--modes", "spp@paper,fgo:batch", "--output", "r.html"];
    let output = graphfix(folder.path(), &[&INPUT[..], &what].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let printed = String::from_utf8(output.stdout).unwrap();
    assert_eq!(printed.lines().filter(|line| line.contains("available 100.0 %")).count(), 2);
    let page = std::fs::read_to_string(folder.path().join("r.html")).unwrap();
    for part in ["MEAN 2D (m)", "STD 2D (m)", "MAX 2D (m)", "Tracks over the truth", "FGO batch"] {
        assert!(page.contains(part), "{part}");
    }
    assert_eq!(page.matches("role=\"img\"").count(), 3, "tracks, errors, satellites");
    for elsewhere in ["src=", "@import", "<script", "<link"] {
        assert!(!page.contains(elsewhere), "the page needs {elsewhere}");
    }
}

#[test]
fn what_cannot_be_compared_is_refused_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path());
    let refusal = |what: &[&str]| {
        let output = graphfix(folder.path(), &[&INPUT[..], what].concat());
        assert!(!output.status.success(), "{what:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    for (modes, output, code) in [
        ("spp,ppp", "r.html", "UNKNOWN_MODE"),
        ("spp:batch", "r.html", "USAGE"),
        ("fgo:later", "r.html", "allowed: causal"),
        ("fgo@moon", "r.html", "UNKNOWN_PROFILE"),
        ("spp", "r.pdf", "UNKNOWN_OUTPUT_FORMAT"),
        ("spp,spp,spp,spp,spp,spp,spp,spp", "r.html", "USAGE"),
    ] {
        let message = refusal(&["--modes", modes, "--output", output]);
        assert!(message.contains(code), "{modes} {output}: {message}");
        assert_eq!(message.lines().count(), 1, "{message}");
    }
    let message = refusal(&["--modes", "spp", "--from", "1", "--to", "2", "--output", "r.html"]);
    assert!(message.contains("NO_EPOCHS"), "{message}");
    assert!(!folder.path().join("r.html").exists(), "a refused run leaves no report");
}
