//! The OpenAPI document is valid by openapi-spec-validator.

use std::process::Command;

use crate::support::python;

#[test]
fn the_document_of_the_rest_door_is_valid() {
    let Some(python) = python::with("openapi_spec_validator") else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("openapi.json");
    std::fs::write(&file, serde_json::to_vec(&graphfix::http::document()).unwrap()).unwrap();
    let mut validate = Command::new(python);
    validate.args(["-m", "openapi_spec_validator", "--errors", "all"]).arg(file);
    let output = validate.output().expect("the program can be started");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
}
