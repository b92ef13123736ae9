//! The keys of one table, asked for one by one; what nobody asked for is a mistake.

use super::scope::Scope;
use super::value::{Item, Table, Value};
use brickmarch::model::Expression;
use brickmarch::{Error, Result};
use std::cell::RefCell;
use std::collections::BTreeSet;

pub(super) struct Keys<'a> {
    pub(super) scope: &'a Scope,
    pub(super) line: usize,
    table: &'a Table,
    asked: RefCell<BTreeSet<&'static str>>,
}

impl<'a> Keys<'a> {
    pub(super) fn new(scope: &'a Scope, line: usize, table: &'a Table) -> Keys<'a> {
        Keys {
            scope,
            line,
            table,
            asked: RefCell::default(),
        }
    }

    pub(super) fn get(&self, key: &'static str) -> Option<&'a Item> {
        self.asked.borrow_mut().insert(key);
        self.table.get(key)
    }

    pub(super) fn need(&self, key: &'static str) -> Result<&'a Item> {
        self.get(key).ok_or_else(|| {
            self.scope.error(
                self.line,
                format!("'{key}' is missing: add it to this table"),
            )
        })
    }

    /// # Errors
    /// When a key was given that nobody asked for.
    pub(super) fn finish(&self) -> Result<()> {
        let asked = self.asked.borrow();
        match self
            .table
            .iter()
            .find(|(key, _)| !asked.contains(key.as_str()))
        {
            None => Ok(()),
            Some((key, item)) => {
                let known: Vec<&str> = asked.iter().copied().collect();
                Err(self.scope.error(
                    item.line,
                    format!("unknown key '{key}': here can be {}", known.join(", ")),
                ))
            }
        }
    }

    fn wrong(&self, key: &str, item: &Item, wanted: &str) -> Error {
        self.scope.error(
            item.line,
            format!("'{key}' is {}: give {wanted}", item.value.noun()),
        )
    }

    pub(super) fn number(&self, key: &'static str) -> Result<Option<f64>> {
        match self.get(key) {
            None => Ok(None),
            Some(item) => self.scope.number(key, item).map(Some),
        }
    }

    pub(super) fn need_number(&self, key: &'static str) -> Result<f64> {
        self.scope.number(key, self.need(key)?)
    }

    pub(super) fn number_or(&self, key: &'static str, default: f64) -> Result<f64> {
        Ok(self.number(key)?.unwrap_or(default))
    }

    /// A whole number from 0 to `most`.
    pub(super) fn whole(&self, key: &'static str, most: u32) -> Result<Option<u32>> {
        let Some(value) = self.number(key)? else {
            return Ok(None);
        };
        if value != value.trunc() || value < 0.0 || value > f64::from(most) {
            return Err(self.scope.error(
                self.table.get(key).map_or(self.line, |i| i.line),
                format!("'{key}' is {value}: give a whole number from 0 to {most}"),
            ));
        }
        Ok(Some(value as u32))
    }

    pub(super) fn text(&self, key: &'static str) -> Result<Option<&'a str>> {
        match self.get(key) {
            None => Ok(None),
            Some(item) => match &item.value {
                Value::Text(text) => Ok(Some(text)),
                _ => Err(self.wrong(key, item, "a text in quotes")),
            },
        }
    }

    pub(super) fn list(&self, key: &'static str) -> Result<Option<&'a [Item]>> {
        match self.get(key) {
            None => Ok(None),
            Some(item) => match &item.value {
                Value::List(list) => Ok(Some(list)),
                _ => Err(self.wrong(key, item, "a list in [ ]")),
            },
        }
    }

    pub(super) fn vector(&self, key: &'static str) -> Result<Option<[f64; 3]>> {
        match self.get(key) {
            None => Ok(None),
            Some(item) => self.scope.vector(key, item).map(Some),
        }
    }

    pub(super) fn need_vector(&self, key: &'static str) -> Result<[f64; 3]> {
        self.scope.vector(key, self.need(key)?)
    }

    pub(super) fn formula(&self, key: &'static str) -> Result<Expression> {
        let item = self.need(key)?;
        match &item.value {
            Value::Text(text) => self.scope.formula(item.line, key, text),
            Value::Number(v) => self.scope.formula(item.line, key, &format!("{v:?}")),
            _ => Err(self.wrong(key, item, "a formula in quotes")),
        }
    }

    /// The one of `names` that a text names.
    pub(super) fn choice(
        &self,
        key: &'static str,
        names: &[&'static str],
    ) -> Result<Option<&'static str>> {
        let Some(text) = self.text(key)? else {
            return Ok(None);
        };
        match names.iter().find(|n| **n == text) {
            Some(name) => Ok(Some(name)),
            None => Err(self.scope.error(
                self.table.get(key).map_or(self.line, |i| i.line),
                format!("'{key}' is \"{text}\": give one of {}", names.join(", ")),
            )),
        }
    }
}
