//! The files of the image name only arguments, variables and options that the program has.
//! `scripts/check-image` runs the recipe.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

fn graphfix(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_graphfix")).args(arguments).output().unwrap();
    String::from_utf8([output.stdout, output.stderr].concat()).unwrap()
}

fn read(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docker").join(name);
    std::fs::read_to_string(path).unwrap()
}

/// Words that begin with `GRAPHFIX_`.
fn variables(text: &str) -> BTreeSet<&str> {
    let words = text.split(|c: char| !c.is_ascii_uppercase() && c != '_');
    words.filter(|word| word.starts_with("GRAPHFIX_")).collect()
}

#[test]
fn the_image_names_what_the_program_has() {
    let help = ["serve", "health", "keys"].map(|command| graphfix(&[command, "--help"])).concat();
    let help = help + &graphfix(&["keys", "create", "--help"]);
    for file in ["Dockerfile", "compose.yml"] {
        let text = read(file);
        let unknown: Vec<_> = variables(&text).difference(&variables(&help)).copied().collect();
        assert!(unknown.is_empty(), "{file}: {unknown:?}");
    }
    // The program knows every option of the configuration. It stops at the certificate, which is
    // not on this machine.
    let configuration = Path::new(env!("CARGO_MANIFEST_DIR")).join("docker/graphfix.toml");
    let said = graphfix(&[
        "serve",
        "--listen",
        "127.0.0.1:0",
        "--config",
        configuration.to_str().unwrap(),
    ]);
    let refusal = "error[TLS_FILE_INVALID]: /etc/graphfix/tls/service.pem";
    assert!(said.contains(refusal), "{said}");
}
