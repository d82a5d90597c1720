//! Common functions of the readers of JSON files.

use std::fmt;
use std::path::Path;

use serde::de::{DeserializeOwned, DeserializeSeed, Error as _, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Number, Value};

use super::read_text;
use super::spelling::plain;
use crate::error::{Error, Result};

/// Reads a JSON file. A repeated key of an object is an error, since the intended value is not known.
pub fn read_json(path: &Path) -> Result<Value> {
    json_from(&read_text(path)?).map_err(|e| e.in_file(path))
}

/// Parses a JSON document; the byte order mark of some editors may precede it.
pub(super) fn json_from(text: &str) -> Result<Value> {
    serde_json::from_str::<Document>(text.trim_start_matches('\u{feff}'))
        .map(|document| document.0)
        .map_err(|e| Error::invalid(format!("this is not valid JSON: {e}")))
}

/// Parses a document of a format; an error names the wrong field.
pub(super) fn document_of<T: DeserializeOwned>(value: Value, format: &str) -> Result<T> {
    serde_path_to_error::deserialize(value).map_err(|e| {
        Error::invalid(format!("not a valid {format} file: {}", plain(&e.to_string())))
    })
}

/// Returns an error unless a document has a version from 1 to the newest one.
pub(super) fn check_version(document: &Value, format: &str, newest: u64) -> Result<()> {
    let known = if newest == 1 { "version 1 is" } else { "versions up to {} are" };
    let known = known.replace("{}", &newest.to_string());
    match document.get("version") {
        Some(version) if version.as_u64().is_some_and(|v| (1..=newest).contains(&v)) => Ok(()),
        Some(version @ Value::Number(_)) => Err(Error::invalid(format!(
            "this is a {format} file of version {version}, but only {known} known"
        ))),
        Some(other) => Err(Error::invalid(format!(
            "the version of this {format} file is {other}, but has to be a number: write \"version\": {newest}"
        ))),
        None => Err(Error::invalid(format!(
            "this {format} file has no version: write \"version\": {newest}"
        ))),
    }
}

/// Value without repeated keys.
struct Document(Value);

impl<'de> Deserialize<'de> for Document {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        deserializer.deserialize_any(Values).map(Self)
    }
}

struct Values;

impl<'de> DeserializeSeed<'de> for Values {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(
        self,
        deserializer: D,
    ) -> std::result::Result<Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Values {
    type Value = Value;

    fn expecting(&self, out: &mut fmt::Formatter) -> fmt::Result {
        write!(out, "a JSON value")
    }

    fn visit_bool<E>(self, value: bool) -> std::result::Result<Value, E> {
        Ok(Value::Bool(value))
    }

    fn visit_i64<E>(self, value: i64) -> std::result::Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E>(self, value: u64) -> std::result::Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E>(self, value: f64) -> std::result::Result<Value, E> {
        Ok(Number::from_f64(value).map_or(Value::Null, Value::Number))
    }

    fn visit_str<E>(self, value: &str) -> std::result::Result<Value, E> {
        Ok(value.into())
    }

    fn visit_unit<E>(self) -> std::result::Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> std::result::Result<Value, A::Error> {
        let mut list = Vec::new();
        while let Some(item) = items.next_element_seed(Self)? {
            list.push(item);
        }
        Ok(Value::Array(list))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut fields: A) -> std::result::Result<Value, A::Error> {
        let mut object = Map::new();
        while let Some(key) = fields.next_key::<String>()? {
            if object.contains_key(&key) {
                return Err(A::Error::custom(format!("'{key}' is given twice: remove one")));
            }
            let value = fields.next_value_seed(Self)?;
            object.insert(key, value);
        }
        Ok(Value::Object(object))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_given_once() {
        let text = r#"{"a": [1, -2, 0.5, null, true, "x", {"b": 1e300, "c": {}}], "d": []}"#;
        assert_eq!(json_from(text).unwrap(), serde_json::from_str::<Value>(text).unwrap());
        assert_eq!(json_from("\u{feff}1").unwrap(), Value::from(1));
        let error = json_from("{\"a\": 1,\n \"b\": {\"c\": 1, \"c\": 1}}").unwrap_err().to_string();
        assert!(error.contains("'c' is given twice") && error.contains("line 2"), "{error}");
    }

    /// Messages name the field in every format.
    #[test]
    fn a_field_of_another_kind_is_named() {
        let camera = |value: &str| {
            let text =
                r#"{"format": "plenocal-camera", "version": 2, "sensor": {"width_px": VALUE}}"#;
            let document = json_from(&text.replace("VALUE", value)).unwrap();
            super::super::camera_file::camera_from(document).unwrap_err().to_string()
        };
        assert!(camera("\"x\"").contains("sensor.width_px"), "{}", camera("\"x\""));
        let poses = r#"{"format": "plenocal-poses", "version": 1, "poses": [{"frame": 1.5}]}"#;
        let why = super::super::poses_file::poses_from(json_from(poses).unwrap()).unwrap_err();
        assert!(why.to_string().contains("poses[0].frame"), "{why}");
    }
}
