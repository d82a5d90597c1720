//! Numbers, vectors and matrices in COMPOTE's JSON files.

use nalgebra::{Dim, Matrix, RawStorage};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use serde_json::{Value, json};

use crate::error::{Error, Result};

/// Finite number, written as a number or as a string.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Number(pub f64);

/// Distance, which may be infinite, written like a [`Number`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Distance(pub f64);

/// Whole number, written as a number or as a string.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Integer(pub i64);

/// Vector, written as a list or as a matrix of one row or column.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Vector(Vec<f64>);

fn text(value: &Value) -> std::result::Result<String, String> {
    match value {
        Value::Number(number) => Ok(number.to_string()),
        Value::String(string) => Ok(string.trim().to_owned()),
        other => Err(format!("expected a number, found {other}")),
    }
}

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        let Distance(value) = Distance::deserialize(deserializer)?;
        if value.is_finite() {
            return Ok(Self(value));
        }
        Err(D::Error::custom(format!("'{value}' is not a finite number")))
    }
}

impl<'de> Deserialize<'de> for Distance {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        let text = text(&Value::deserialize(deserializer)?).map_err(D::Error::custom)?;
        match text.parse::<f64>() {
            Ok(value) if !value.is_nan() => Ok(Self(value)),
            _ => Err(D::Error::custom(format!("'{text}' is not a number"))),
        }
    }
}

impl<'de> Deserialize<'de> for Integer {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        let text = text(&Value::deserialize(deserializer)?).map_err(D::Error::custom)?;
        text.parse()
            .map(Self)
            .map_err(|_| D::Error::custom(format!("'{text}' is not a whole number")))
    }
}

impl<'de> Deserialize<'de> for Vector {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        let Value::Array(rows) = Value::deserialize(deserializer)? else {
            return Err(D::Error::custom("expected a list of numbers"));
        };
        let flat = rows.into_iter().flat_map(|row| match row {
            Value::Array(numbers) => numbers,
            number => vec![number],
        });
        let number = |value| Number::deserialize(value).map(|n| n.0).map_err(D::Error::custom);
        flat.map(number).collect::<std::result::Result<_, _>>().map(Self)
    }
}

impl Integer {
    pub(super) fn positive(self, name: &str) -> Result<i32> {
        match i32::try_from(self.0) {
            Ok(value) if value > 0 => Ok(value),
            _ => Err(Error::invalid(format!("the {name} is {}, which is not possible", self.0))),
        }
    }

    pub(super) fn count(self, name: &str) -> Result<usize> {
        usize::try_from(self.0)
            .map_err(|_| Error::invalid(format!("{name} is {}, but must not be negative", self.0)))
    }
}

impl Vector {
    pub(super) fn fixed<const N: usize>(&self, name: &str) -> Result<[f64; N]> {
        self.0.as_slice().try_into().map_err(|_| {
            Error::invalid(format!("{name} has {} numbers, but needs {N}", self.0.len()))
        })
    }
}

pub(super) fn number(value: f64) -> Value {
    json!(value.to_string())
}

pub(super) fn vector(values: &[f64]) -> Value {
    json!([values.iter().map(|&v| number(v)).collect::<Vec<_>>()])
}

pub(super) fn matrix<R: Dim, C: Dim, S: RawStorage<f64, R, C>>(m: &Matrix<f64, R, C, S>) -> Value {
    let rows: Vec<Vec<Value>> =
        m.row_iter().map(|row| row.iter().map(|&v| number(v)).collect()).collect();
    json!(rows)
}
