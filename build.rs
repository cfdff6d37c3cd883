//! Compiles `proto/` to Rust: messages once, with their JSON twins, and the services over them; with
//! them `proto-google/`, which is apart because clients have code for it already; and
//! lists the files of the dashboard, which `scripts/web` makes.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use prost::Message;
use prost_types::{FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};

const SERVICES: [&str; 11] = [
    "proto/graphfix/v1/sessions.proto",
    "proto/graphfix/v1/positioning.proto",
    "proto/graphfix/v1/solutions.proto",
    "proto/graphfix/v1/navigation.proto",
    "proto/graphfix/v1/bases.proto",
    "proto/graphfix/v1/jobs.proto",
    "proto/graphfix/v1/keys.proto",
    "proto/graphfix/v1/tenants.proto",
    "proto/graphfix/v1/audit.proto",
    "proto/graphfix/v1/history.proto",
    "proto-google/google/longrunning/operations.proto",
];
const PACKAGE: &str = "graphfix.v1";
/// Names of messages of gRPC's streams, which HTTP does not have, begin with this.
const OF_STREAMS: &str = "Stream";
/// Travel as bare bodies over HTTP.
const WITHOUT_JSON: [&str; 10] = [
    "PushNavigationRequest",
    "UploadBaseRequest",
    "PushRawRequest",
    "CreateJobRequest",
    "JobPart",
    "JobResultResponse",
    "SessionObservationsRequest",
    "SessionObservationsResponse",
    "TrackRequest",
    "TrackResponse",
];
const JSON: &str = "#[derive(serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
    #[serde(rename_all = \"camelCase\", default, deny_unknown_fields, expecting = \"an object\")]";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=proto");
    println!("cargo::rerun-if-changed=proto-google");
    println!("cargo::rerun-if-changed=web/dist");
    list_dashboard()?;
    let descriptors = protox::compile(SERVICES, ["proto", "proto-google"])?;
    let folder = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(folder.join("descriptors.bin"), descriptors.encode_to_vec())?;
    let (messages, services) = (folder.join("messages"), folder.join("services"));
    std::fs::create_dir_all(&messages)?;
    std::fs::create_dir_all(&services)?;

    // Those of other packages have no JSON, and stand beside their service.
    let messages_of = FileDescriptorSet {
        file: descriptors.file.iter().filter(|file| is_message_file(file)).cloned().collect(),
    };
    let mut build = tonic_prost_build::configure()
        .build_client(false)
        .build_server(false)
        .out_dir(messages)
        .extern_path(".graphfix.v1.Observation", "crate::contract::v1::Observation")
        .bytes(".graphfix.v1.PushNavigationRequest.content")
        .bytes(".graphfix.v1.UploadBaseRequest.content")
        .bytes(".graphfix.v1.PushRawRequest.content")
        .bytes(".graphfix.v1.StreamRawRequest.content")
        .bytes(".graphfix.v1.TrackResponse.content")
        .bytes(".graphfix.v1.SessionObservationsResponse.content")
        .bytes(".graphfix.v1.JobResultResponse.content")
        .bytes(".graphfix.v1.CreateJobRequest.content.chunk")
        .btree_map(".");
    let in_package = descriptors.file.iter().filter(|file| file.package() == PACKAGE);
    for message in in_package.flat_map(|file| &file.message_type) {
        let name = message.name();
        if !WITHOUT_JSON.contains(&name) && !name.starts_with(OF_STREAMS) {
            build = build.message_attribute(format!(".{PACKAGE}.{}", message.name()), JSON);
        }
    }
    let as_name = "#[serde(with = \"crate::contract::json::status\")]
        #[schema(value_type = String, example = \"SINGLE\", default = json!(\"UNSPECIFIED\"))]";
    let as_object = "#[serde(with = \"crate::contract::json::values\")]
        #[schema(value_type = Object)]";
    // JSON has them as the texts beside them.
    for file in descriptors.file.iter().filter(|file| file.package() == PACKAGE) {
        for message in &file.message_type {
            for field in message.field.iter().filter(|field| is_typed_twin(field)) {
                let path = format!(".{PACKAGE}.{}.{}", message.name(), field.name());
                build = build.field_attribute(path, "#[serde(skip)]");
            }
        }
    }
    build
        .field_attribute(".graphfix.v1.Solution.status", as_name)
        .field_attribute(".graphfix.v1.ListSolutionsRequest.status", as_name)
        .field_attribute(".graphfix.v1.SessionHead.status", as_name)
        .field_attribute(".graphfix.v1.SeriesStatus.status", as_name)
        .field_attribute(".graphfix.v1.SeriesInterval.status", as_name)
        .field_attribute(".graphfix.v1.SeriesInterval.worst_status", as_name)
        .field_attribute(".graphfix.v1.SeriesInterval.best_status", as_name)
        .field_attribute(".graphfix.v1.HistoryInterval.status", as_name)
        .field_attribute(".graphfix.v1.HistoryInterval.worst_status", as_name)
        .field_attribute(".graphfix.v1.HistoryInterval.best_status", as_name)
        .field_attribute(".graphfix.v1.Reason.values", as_object)
        .compile_fds(messages_of)?;

    tonic_prost_build::configure()
        .out_dir(services)
        .extern_path(".graphfix.v1", "crate::contract::v1")
        .extern_path(".google.rpc", "::tonic_types::pb")
        .codec_path("crate::grpc::Codec")
        .compile_fds(descriptors)?;
    Ok(())
}

/// Whether a file has messages of this service, or what they are made of.
fn is_message_file(file: &FileDescriptorProto) -> bool {
    [PACKAGE, "google.protobuf"].contains(&file.package())
}

/// Whether a field has the type of what another field of its message has as text.
fn is_typed_twin(field: &FieldDescriptorProto) -> bool {
    let kinds = ["JobState", "DeliveryState", "SourceState", "SatelliteRole"];
    let kinds = kinds.map(|kind| format!(".{PACKAGE}.{kind}"));
    field.type_name() == ".google.protobuf.Timestamp"
        || kinds.iter().any(|k| field.type_name() == k)
}

/// Writes the table of the dashboard's files: path of the service, and content.
fn list_dashboard() -> std::io::Result<()> {
    // Asked at run time: a build script that is already built serves another checkout, too.
    let root = std::env::var("CARGO_MANIFEST_DIR").expect("cargo names the folder");
    let root = Path::new(&root).join("web/dist");
    let mut files = vec![root.join("index.html"), root.join("licences.txt")];
    for entry in std::fs::read_dir(root.join("assets"))? {
        files.push(entry?.path());
    }
    files.sort();
    let mut table = String::from("&[\n");
    for file in files {
        let path = file.strip_prefix(&root).expect("it is a file of the folder");
        let written = writeln!(table, "(\"/{}\", include_bytes!({file:?})),", path.display());
        written.expect("a text takes any text");
    }
    table.push(']');
    let out = PathBuf::from(std::env::var("OUT_DIR").expect("cargo names the folder"));
    std::fs::write(out.join("dashboard.rs"), table)
}
