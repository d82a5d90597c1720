//! Faults of disk and system, kills, and files that are not what they seem: `make test-faults`.
//!
//! The faults come from `shim.c`, which is loaded before the program. Whatever goes wrong, an error says so; and when it
//! is over, the next run ends with what an undisturbed one has.
#![cfg(target_os = "linux")]

mod disks;
mod inputs;
mod kills;
mod links;
mod place;
mod reruns;

#[path = "../it/prepared.rs"]
#[allow(dead_code)] // used by the other tests
mod prepared;
