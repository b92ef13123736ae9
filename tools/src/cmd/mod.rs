//! The commands, one file each.

pub(crate) mod batch;
pub(crate) mod check;
pub(crate) mod compact;
pub(crate) mod demo;
pub(crate) mod export;
pub(crate) mod import;
pub(crate) mod info;
pub(crate) mod join;
mod labels;
pub(crate) mod manual;
pub(crate) mod mesh;
pub(crate) mod model;
pub(crate) mod ray;
pub(crate) mod render;
pub(crate) mod sample;
pub(crate) mod slice;
pub(crate) mod verify;

mod ask;
mod pick;
mod region;

pub(crate) use pick::named as open_named;

use brickmarch::Error;
use std::path::Path;

/// Puts the file that an error is about in front of it, unless the message names one of `paths`.
fn named(paths: &[&Path]) -> impl Fn(Error) -> Error + use<> {
    let names: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
    move |error| {
        let message = error.to_string();
        match names.first() {
            Some(first) if !names.iter().any(|n| message.contains(n)) => error.context(first),
            _ => error,
        }
    }
}

/// `1234567` as "1,234,567".
pub(crate) fn thousands(number: u64) -> String {
    let digits = number.to_string();
    let mut out = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

/// A number of seconds as people say it.
fn seconds(seconds: f64) -> String {
    format!("{seconds:.2} s")
}

/// At most six digits after the point, without trailing zeros.
fn short(value: f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}
