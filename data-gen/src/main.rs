//! Writes scenes to disk at any size, and prints their known answers.
fn main() {}
