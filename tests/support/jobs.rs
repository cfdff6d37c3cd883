//! Recordings for batch jobs, and bodies that upload them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use graphfix::formats::rinex::{
    ObservationHeader, ObservationWriter, RinexVersion, write_navigation,
};
use graphfix::simulation::{Scenario, Simulator};
use serde_json::Value;

use super::wait::until;

/// Separates the parts of a body.
pub(crate) const BOUNDARY: &str = "a-boundary-of-no-file";

/// Files of a simulated rover with its base.
pub(crate) struct Files {
    pub(crate) rover: Vec<u8>,
    pub(crate) base: Vec<u8>,
    pub(crate) navigation: Vec<u8>,
}

/// A minute under open sky.
pub(crate) static MINUTE: LazyLock<Files> = LazyLock::new(|| simulated(60.0));
/// Five minutes.
pub(crate) static LONG: LazyLock<Files> = LazyLock::new(|| simulated(300.0));
/// An hour, which a fast machine computes in some seconds.
pub(crate) static HOUR: LazyLock<Files> = LazyLock::new(|| simulated(3_600.0));

fn simulated(duration_s: f64) -> Files {
    let scenario = Scenario { duration_s, ..Scenario::by_name("rtk-open").unwrap() };
    let mut header = ObservationHeader::new(RinexVersion::new(3, 5));
    for constellation in &scenario.constellations {
        header.codes[constellation.index()] = scenario.signals(*constellation).collect();
    }
    let simulator = Simulator::new(scenario, 3);
    let mut navigation = Vec::new();
    write_navigation(&mut navigation, simulator.navigation()).unwrap();
    let writer = || ObservationWriter::new(Vec::new(), &header).unwrap();
    let (mut rover, mut base) = (writer(), writer());
    for epoch in simulator {
        rover.write_epoch(&epoch.rover).unwrap();
        base.write_epoch(&epoch.base.unwrap()).unwrap();
    }
    Files { rover: rover.finish().unwrap(), base: base.finish().unwrap(), navigation }
}

/// A body with these parts: name, and content. All but `options` are files.
pub(crate) fn body(parts: &[(&str, &[u8])]) -> Vec<u8> {
    let mut body = Vec::new();
    for (name, content) in parts {
        let file = if *name == "options" { "" } else { "; filename=\"a.file\"" };
        let head = format!(
            "--{BOUNDARY}\r\nContent-Disposition: form-data; name=\"{name}\"{file}\r\n\r\n"
        );
        body.extend_from_slice(head.as_bytes());
        body.extend_from_slice(content);
        body.extend_from_slice(b"\r\n");
    }
    body.extend_from_slice(format!("--{BOUNDARY}--\r\n").as_bytes());
    body
}

/// The arguments with which curl sends a job of these files and options.
pub(crate) fn form(files: &[PathBuf; 3], options: &str) -> Vec<String> {
    let [rover, navigation, base] = files.each_ref().map(|path| path.display());
    let parts = [
        format!("rover=@{rover}"),
        format!("navigation=@{navigation}"),
        format!("base=@{base}"),
        format!("options={options}"),
    ];
    parts.into_iter().flat_map(|part| ["-F".to_owned(), part]).collect()
}

/// Whether a job has ended.
pub(crate) fn has_ended(job: &Value) -> bool {
    job["state"].as_str().is_some_and(|state| state != "QUEUED" && state != "RUNNING")
}

/// Requests a job until it has ended.
///
/// Panics if the job makes no progress for a time. There is no limit of the whole time, since a
/// busy machine may need long for a long recording.
pub(crate) async fn until_ended(mut ask: impl AsyncFnMut() -> Value) -> Value {
    let progress = |job: &Value| job["progress"]["epochs"].as_u64();
    let mut last = None;
    loop {
        let goes_on = |job: &Value| has_ended(job) || progress(job) != last;
        let job = until("ended or further", &mut ask, goes_on).await;
        if has_ended(&job) {
            return job;
        }
        last = progress(&job);
    }
}

impl Files {
    /// A body with all files and these options.
    pub(crate) fn body(&self, options: &Value) -> Vec<u8> {
        body(&[
            ("rover", &self.rover),
            ("navigation", &self.navigation),
            ("base", &self.base),
            ("options", options.to_string().as_bytes()),
        ])
    }

    /// The files in a folder.
    pub(crate) fn write(&self, folder: &Path) -> [PathBuf; 3] {
        let files =
            [("rover", &self.rover), ("navigation", &self.navigation), ("base", &self.base)];
        files.map(|(name, content)| {
            let path = folder.join(name);
            fs::write(&path, content).unwrap();
            path
        })
    }

    /// The file that `graphfix solve` writes.
    pub(crate) fn solved(&self, arguments: &[&str], format: &str) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let [rover, navigation, base] = self.write(folder.path());
        let output = folder.path().join(format!("solved.{format}"));
        let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
        command.arg("solve").arg("--rover").arg(rover).arg("--nav").arg(navigation);
        command.arg("--base").arg(base).arg("--output").arg(&output).args(arguments);
        let done = command.output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        fs::read(output).unwrap()
    }
}
