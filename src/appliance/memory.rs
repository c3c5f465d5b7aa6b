//! The process's memory: the system's allocator with a counter, so that `mien bench` and the tests can report allocations; and
//! locking memory in RAM where the system permits it.
//!
//! Cost: a relaxed addition per request. Unsafe code: a global allocator and `mlockall` require it.
#![expect(
    unsafe_code,
    reason = "GlobalAlloc is an unsafe trait; mlockall, mallopt and malloc_trim are foreign functions"
)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};

/// An allocator with a counter, to be a program's global allocator.
#[derive(Default)]
pub struct Counting(AtomicU64);

impl Counting {
    /// A counter at zero.
    pub const fn new() -> Self {
        Self(AtomicU64::new(0))
    }

    /// Allocations and reallocations since the program started.
    pub fn requests(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    fn count(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

// SAFETY: every method passes its arguments on to `System`, which fulfils the contract.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        self.count();
        // SAFETY: the caller's contract is that of `System`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        self.count();
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        self.count();
        // SAFETY: as above.
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(block, layout) }
    }
}

/// Locks current mappings in RAM, page by page on first touch, so that a page is never paged in twice. Later mappings are not
/// locked, so that a small limit can never make a later allocation fail.
///
/// # Errors
/// If more is mapped than `LimitMEMLOCK=` (`ulimit -l`) allows.
pub fn lock() -> io::Result<()> {
    // SAFETY: the call takes no pointers and changes nothing that the program can see.
    match unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_ONFAULT) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

/// Makes the allocator map every block of 64 KiB or more separately, so that freeing one returns it to the system. By default
/// glibc raises that bound with each large block it frees, and reloads fragment the heap.
pub fn map_large_blocks() {
    #[cfg(target_env = "gnu")]
    // SAFETY: the call takes no pointers, and changes only where later blocks lie.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, 64 << 10);
    }
}

/// Returns freed memory to the system, after a reload.
pub fn trim() {
    #[cfg(target_env = "gnu")]
    // SAFETY: the call takes no pointers, and only memory that is free changes hands.
    unsafe {
        libc::malloc_trim(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn allocations_are_counted() {
        let counting = Counting::new();
        let layout = |size| Layout::from_size_align(size, 16).unwrap();
        // SAFETY: sizes are not zero, and every block is given back with the layout it has then.
        unsafe {
            let one = counting.alloc(layout(100));
            let other = counting.alloc_zeroed(layout(40));
            assert_eq!(core::slice::from_raw_parts(other, 40), [0; 40]);
            one.write_bytes(7, 100);
            let one = counting.realloc(one, layout(100), 300);
            assert_eq!(core::slice::from_raw_parts(one, 100), [7; 100]);
            assert_eq!(counting.requests(), 3);
            counting.dealloc(one, layout(300));
            counting.dealloc(other, layout(40));
        }
        assert_eq!(counting.requests(), 3);
    }
}
