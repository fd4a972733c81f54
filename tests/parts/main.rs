//! The small parts that other crates build on, by their public functions alone.

mod base;
mod environments;
mod number;
mod recordings;
mod seal;
mod table;
mod values;
