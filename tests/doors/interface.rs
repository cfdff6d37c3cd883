//! The interface as a whole: how `proto/` is written, and that nothing of what is released changes.

use std::collections::BTreeSet;
use std::path::Path;

use graphfix::contract::access::CALLS;
use graphfix::contract::v1;
use graphfix::grpc::{DESCRIPTORS, grpc_code};
use graphfix::http::http_status;
use graphfix::refusal::{Class, Code};
use prost::Message;
use prost::encoding::{self, DecodeContext, WireType};
use prost_types::field_descriptor_proto::Type;
use prost_types::{
    DescriptorProto, EnumDescriptorProto, FieldDescriptorProto, FileDescriptorProto,
    FileDescriptorSet,
};
use serde_json::Value;

const PACKAGE: &str = "graphfix.v1";
/// The interface that clients were built against: one line for each thing that they may use.
const RELEASED: &str = "tests/support/released/interface.txt";

fn files() -> Vec<FileDescriptorProto> {
    let set = FileDescriptorSet::decode(DESCRIPTORS).unwrap();
    set.file.into_iter().filter(|file| file.package() == PACKAGE).collect()
}

/// Everything that a client may use, one line each. A line that is gone breaks clients; a further
/// one does not.
fn interface() -> BTreeSet<String> {
    let mut lines = BTreeSet::new();
    for file in files() {
        for service in &file.service {
            for method in &service.method {
                let stream = |is: bool| if is { "stream " } else { "" };
                lines.insert(format!(
                    "rpc {}/{} {}{} returns {}{}",
                    service.name(),
                    method.name(),
                    stream(method.client_streaming()),
                    method.input_type(),
                    stream(method.server_streaming()),
                    method.output_type(),
                ));
            }
        }
        file.message_type.iter().for_each(|message| lines.extend(fields(message)));
        file.enum_type.iter().for_each(|choice| lines.extend(values(choice)));
    }
    lines.extend(CALLS.iter().map(|call| format!("route {} {}", call.rest, call.grpc)));
    let codes = Code::ALL.iter().filter(|code| code.class() != Class::NoCall);
    lines.extend(codes.map(|code| {
        let class = code.class();
        format!("code {code} {} {:?}", http_status(class).as_u16(), grpc_code(class))
    }));
    lines.extend(rest());
    lines
}

fn fields(message: &DescriptorProto) -> impl Iterator<Item = String> {
    message.field.iter().map(|field| {
        let group = field.oneof_index.map_or("", |_| " of a group");
        format!(
            "field {}.{} = {} {:?} {:?} {}{group}",
            message.name(),
            field.name(),
            field.number(),
            field.label(),
            field.r#type(),
            field.type_name(),
        )
    })
}

fn values(choice: &EnumDescriptorProto) -> impl Iterator<Item = String> {
    choice
        .value
        .iter()
        .map(|value| format!("value {}.{} = {}", choice.name(), value.name(), value.number()))
}

/// Parameters and properties of the REST door.
fn rest() -> Vec<String> {
    let document = serde_json::to_value(graphfix::http::document()).unwrap();
    let object = |value: &Value| value.as_object().cloned().unwrap_or_default();
    let mut lines = Vec::new();
    for (path, methods) in object(&document["paths"]) {
        for (method, operation) in object(&methods) {
            lines.push(format!("operation {method} {path} {}", operation["operationId"]));
            for parameter in operation["parameters"].as_array().into_iter().flatten() {
                let (place, name) = (&parameter["in"], &parameter["name"]);
                lines.push(format!("parameter {method} {path} {place} {name}"));
            }
        }
    }
    for (name, schema) in object(&document["components"]["schemas"]) {
        for (property, schema) in object(&schema["properties"]) {
            lines.push(format!("property {name}.{property} {}", schema["type"]));
        }
    }
    lines
}

/// No field, number, type, call, route, parameter or code of the released interface is removed or
/// changed. At a release `GRAPHFIX_RELEASE=1` writes the file again.
#[test]
fn the_released_interface_still_holds() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(RELEASED);
    let present = interface();
    if std::env::var_os("GRAPHFIX_RELEASE").is_some() {
        let lines: Vec<String> = present.iter().cloned().collect();
        std::fs::write(&file, lines.join("\n") + "\n").unwrap();
    }
    let released = std::fs::read_to_string(file).unwrap();
    let gone: Vec<&str> = released.lines().filter(|line| !present.contains(*line)).collect();
    assert!(1000 < released.lines().count(), "{RELEASED} is not whole");
    assert!(gone.is_empty(), "clients need what is gone or has changed:\n{}", gone.join("\n"));
}

/// The message of observations is written by hand: it has the fields of the schema, with their
/// numbers, kinds on the wire and names in JSON.
#[test]
fn observations_have_the_fields_of_the_schema() {
    let values = [1.0, 2.0, 3.0, 4.0].map(Some);
    let [pseudorange_m, carrier_phase_cycles, doppler_hz, cn0_db_hz] = values;
    let observation = v1::Observation {
        satellite: "G05".into(),
        code: "1C".into(),
        pseudorange_m,
        carrier_phase_cycles,
        doppler_hz,
        cn0_db_hz,
        loss_of_lock: true,
        half_cycle: true,
    };
    let mut written = BTreeSet::new();
    let mut bytes = &*observation.encode_to_vec();
    while !bytes.is_empty() {
        let (number, kind) = encoding::decode_key(&mut bytes).unwrap();
        encoding::skip_field(kind, number, &mut bytes, DecodeContext::default()).unwrap();
        written.insert((number as i32, kind as i32));
    }
    let mut messages = files().into_iter().flat_map(|file| file.message_type);
    let schema = messages.find(|message| message.name() == "Observation").unwrap();
    let kind = |field: &FieldDescriptorProto| match field.r#type() {
        Type::String => WireType::LengthDelimited as i32,
        Type::Double => WireType::SixtyFourBit as i32,
        Type::Bool => WireType::Varint as i32,
        other => panic!("{} is {other:?}", field.name()),
    };
    let numbers = schema.field.iter().map(|field| (field.number(), kind(field)));
    assert_eq!(written, numbers.collect());
    let json = serde_json::to_value(&observation).unwrap();
    let names: BTreeSet<&str> = json.as_object().unwrap().keys().map(String::as_str).collect();
    assert_eq!(names, schema.field.iter().map(FieldDescriptorProto::json_name).collect());
}

/// `proto/` has the style that `buf lint` requires. Field numbers are consecutive: a missing number
/// was removed, and must be reserved.
#[test]
fn the_schema_is_written_by_its_rules() {
    let mut wrong = Vec::new();
    for file in files() {
        let commented: BTreeSet<Vec<i32>> = file
            .source_code_info
            .iter()
            .flat_map(|info| &info.location)
            .filter(|location| !location.leading_comments().trim().is_empty())
            .map(|location| location.path.clone())
            .collect();
        let mut check = |is_right: bool, what: String| {
            if !is_right {
                wrong.push(format!("{}: {what}", file.name()));
            }
        };
        for (index, service) in file.service.iter().enumerate() {
            let path = vec![6, index as i32];
            check(commented.contains(&path), format!("{} has no comment", service.name()));
            for (method_index, method) in service.method.iter().enumerate() {
                let name = format!("{}.{}", service.name(), method.name());
                let path = vec![6, index as i32, 2, method_index as i32];
                check(commented.contains(&path), format!("{name} has no comment"));
                check(is_pascal(method.name()), format!("{name} is not PascalCase"));
                check(method.input_type().ends_with("Request"), format!("{name} takes no Request"));
            }
        }
        for (index, message) in file.message_type.iter().enumerate() {
            let name = message.name();
            let is_of_call = name.ends_with("Request") || name.ends_with("Response");
            let has_comment = commented.contains(&vec![4, index as i32]);
            check(is_of_call || has_comment, format!("{name} has no comment"));
            check(is_pascal(name), format!("{name} is not PascalCase"));
            check_numbers(message, &mut check);
        }
        for (index, choice) in file.enum_type.iter().enumerate() {
            let name = choice.name();
            check(commented.contains(&vec![5, index as i32]), format!("{name} has no comment"));
            for (number, value) in choice.value.iter().enumerate() {
                let rest = value.name().strip_prefix(&format!("{}_", upper_snake(name)));
                check(rest.is_some(), format!("{} lacks the prefix of {name}", value.name()));
                let is_first = number == 0;
                let is_unspecified = rest == Some("UNSPECIFIED");
                check(is_first == is_unspecified, format!("{name} begins with UNSPECIFIED"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn check_numbers(message: &DescriptorProto, check: &mut impl FnMut(bool, String)) {
    let mut used: BTreeSet<i32> = message.field.iter().map(|field| field.number()).collect();
    used.extend(message.reserved_range.iter().flat_map(|range| range.start()..range.end()));
    let last = used.last().copied().unwrap_or_default();
    let is_whole = used.len() == last as usize;
    check(is_whole, format!("{} has unused numbers that are not reserved", message.name()));
    for field in &message.field {
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        let name = field.name();
        check(name.chars().all(plain), format!("{}.{name} is not snake_case", message.name()));
    }
}

/// `JOB_STATE` of `JobState`.
fn upper_snake(name: &str) -> String {
    let mut text = String::new();
    for letter in name.chars() {
        if letter.is_ascii_uppercase() && !text.is_empty() {
            text.push('_');
        }
        text.push(letter.to_ascii_uppercase());
    }
    text
}

fn is_pascal(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_uppercase()) && name.chars().all(char::is_alphanumeric)
}
