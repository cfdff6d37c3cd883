//! JSON forms that differ from protobuf's: statuses by name, and named values as an object.

/// A status by its name in the API; empty if absent.
pub(crate) mod status {
    use serde::{Deserialize, Deserializer, Serializer};

    use crate::contract::v1;

    const PREFIX: &str = "STATUS_";

    /// Writes the name without the enumeration's prefix.
    ///
    /// # Errors
    /// The serialiser fails.
    pub(crate) fn serialize<S: Serializer>(number: &i32, serializer: S) -> Result<S::Ok, S::Error> {
        let status = v1::Status::try_from(*number).unwrap_or(v1::Status::Unspecified);
        serializer.serialize_str(status.as_str_name().trim_start_matches(PREFIX))
    }

    /// Reads the number of a name.
    ///
    /// # Errors
    /// The name is not a status.
    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<i32, D::Error> {
        let name = String::deserialize(deserializer)?;
        v1::Status::from_str_name(&format!("{PREFIX}{name}"))
            .map(i32::from)
            .ok_or_else(|| serde::de::Error::custom(format!("{name:?} is not a status")))
    }
}

/// Named values as a JSON object.
pub(crate) mod values {
    use std::collections::BTreeMap;

    use prost_types::value::Kind;
    use prost_types::{ListValue, Struct, Value};
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use serde_json::Value as Json;

    /// Writes the object.
    ///
    /// # Errors
    /// The serialiser fails.
    pub(crate) fn serialize<S: Serializer>(
        values: &Option<Struct>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        let fields = values.iter().flat_map(|values| &values.fields);
        let object: BTreeMap<_, _> = fields.map(|(name, value)| (name, to_json(value))).collect();
        object.serialize(serializer)
    }

    /// Reads the values of an object.
    ///
    /// # Errors
    /// The JSON is not an object.
    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<Struct>, D::Error> {
        let object = BTreeMap::<String, Json>::deserialize(deserializer)?;
        let fields = object.into_iter().map(|(name, value)| (name, from_json(value))).collect();
        Ok(Some(Struct { fields }))
    }

    fn to_json(value: &Value) -> Json {
        match &value.kind {
            None | Some(Kind::NullValue(_)) => Json::Null,
            Some(Kind::BoolValue(truth)) => Json::Bool(*truth),
            Some(Kind::NumberValue(number)) => Json::from(*number),
            Some(Kind::StringValue(text)) => Json::from(text.as_str()),
            Some(Kind::ListValue(list)) => list.values.iter().map(to_json).collect(),
            Some(Kind::StructValue(inner)) => {
                inner.fields.iter().map(|(name, value)| (name.clone(), to_json(value))).collect()
            }
        }
    }

    fn from_json(json: Json) -> Value {
        let kind = match json {
            Json::Null => Kind::NullValue(0),
            Json::Bool(truth) => Kind::BoolValue(truth),
            Json::Number(number) => Kind::NumberValue(number.as_f64().unwrap_or(f64::NAN)),
            Json::String(text) => Kind::StringValue(text),
            Json::Array(list) => {
                Kind::ListValue(ListValue { values: list.into_iter().map(from_json).collect() })
            }
            Json::Object(object) => Kind::StructValue(Struct {
                fields: object.into_iter().map(|(name, v)| (name, from_json(v))).collect(),
            }),
        };
        Value { kind: Some(kind) }
    }
}
