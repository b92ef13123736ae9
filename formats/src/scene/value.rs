//! TOML as a tree of values that know their line.

use brickmarch::{Error, ErrorKind, Result};
use std::collections::BTreeMap;
use std::path::Path;
use toml::de::{DeTable, DeValue};

/// Longest scene file.
const MAX_BYTES: u64 = 16 << 20;

/// A value and the line on which it begins.
#[derive(Clone, Debug)]
pub(super) struct Item {
    pub(super) line: usize,
    pub(super) value: Value,
}

#[derive(Clone, Debug)]
pub(super) enum Value {
    Text(String),
    Number(f64),
    Switch,
    List(Vec<Item>),
    Table(Table),
}

/// Values by key.
pub(super) type Table = BTreeMap<String, Item>;

impl Value {
    /// What it is, for messages.
    pub(super) fn noun(&self) -> &'static str {
        match self {
            Value::Text(_) => "a text",
            Value::Number(_) => "a number",
            Value::Switch => "true or false",
            Value::List(_) => "a list",
            Value::Table(_) => "a table",
        }
    }
}

/// Reads and parses a file.
///
/// # Errors
/// When it cannot be read, is too long, or is no TOML.
pub(super) fn read(path: &Path) -> Result<Table> {
    let failed = |e| Error::io(path, "reading the scene", e);
    let about = std::fs::metadata(path).map_err(failed)?;
    if !about.is_file() {
        return Err(Error::bad_input(format!(
            "{}: is not a regular file: name a scene file",
            path.display()
        )));
    }
    if about.len() > MAX_BYTES {
        return Err(Error::new(
            ErrorKind::LimitExceeded,
            format!(
                "{}: {} bytes: a scene has at most {MAX_BYTES}",
                path.display(),
                about.len()
            ),
        ));
    }
    let text = std::fs::read_to_string(path).map_err(failed)?;
    parse(&text).map_err(|(line, message)| {
        Error::bad_input(format!("{}:{line}: {message}", path.display()))
    })
}

/// # Errors
/// Line and message.
fn parse(text: &str) -> Result<Table, (usize, String)> {
    // Offsets of lines, for a quick way from offset to number.
    let starts: Vec<usize> = std::iter::once(0)
        .chain(text.match_indices('\n').map(|(i, _)| i + 1))
        .collect();
    let line = |at: usize| starts.partition_point(|&s| s <= at);
    let table = DeTable::parse(text).map_err(|e| {
        let at = e.span().map_or(0, |s| s.start);
        let first = e.message().lines().next().unwrap_or("not TOML");
        (
            line(at),
            format!("this is not TOML: {first}: correct the line"),
        )
    })?;
    convert_table(table.get_ref(), &line)
}

fn convert_table(
    table: &DeTable<'_>,
    line: &dyn Fn(usize) -> usize,
) -> Result<Table, (usize, String)> {
    let mut out = Table::new();
    for (key, value) in table {
        let at = line(key.span().start);
        let value = convert(value.get_ref(), at, line)?;
        out.insert(key.get_ref().to_string(), Item { line: at, value });
    }
    Ok(out)
}

fn convert(
    value: &DeValue<'_>,
    at: usize,
    line: &dyn Fn(usize) -> usize,
) -> Result<Value, (usize, String)> {
    Ok(match value {
        DeValue::String(text) => Value::Text(text.to_string()),
        DeValue::Boolean(_) => Value::Switch,
        DeValue::Integer(i) => {
            let digits = i.as_str().replace('_', "");
            let number = i64::from_str_radix(&digits, i.radix());
            let number = number.map_err(|_| (at, format!("{} is too large", i.as_str())))?;
            Value::Number(number as f64)
        }
        DeValue::Float(f) => {
            let number: Result<f64, _> = f.as_str().replace('_', "").parse();
            match number {
                Ok(v) if v.is_finite() => Value::Number(v),
                _ => {
                    return Err((at, format!("{}: give a finite number", f.as_str())));
                }
            }
        }
        DeValue::Datetime(_) => {
            return Err((at, "a date: scenes have no use for one".to_string()));
        }
        DeValue::Array(list) => {
            let items = list.iter().map(|item| {
                let at = line(item.span().start);
                let value = convert(item.get_ref(), at, line)?;
                Ok(Item { line: at, value })
            });
            Value::List(items.collect::<Result<_, _>>()?)
        }
        DeValue::Table(table) => Value::Table(convert_table(table, line)?),
    })
}
