//! Damaged files for every reader: where they come from, how they are damaged, and what has to come of them.
//!
//! `tests/it/damaged.rs` reads some thousands of them, `make fuzz` a million.

pub mod corpus;
pub mod documents;
pub mod in_use;
pub mod mutation;
pub mod readers;
pub mod solving;
pub mod verdict;
