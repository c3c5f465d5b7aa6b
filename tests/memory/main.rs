//! Promises about memory, one a module: `cargo test --test memory <module>` runs one. In a program of their own, one test at
//! a time: the allocator counts what any thread asks for.

#[path = "../common/mod.rs"]
mod common;

mod in_use;
mod lives_for_a_week;
mod stays_in_its_memory;
mod survives_packet_loss;
mod wires_cost_little;

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

#[global_allocator]
static MEMORY: in_use::Counting = in_use::Counting::new();

/// One test at a time, so that what is counted is its own.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    let guard = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    // The harness asks for memory of its own while it tells of the test before.
    std::thread::sleep(Duration::from_millis(50));
    guard
}
