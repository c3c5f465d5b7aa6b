//! The allocator of `mien`, which counts requests, with a count of the bytes in use besides.
#![expect(
    unsafe_code,
    reason = "GlobalAlloc is an unsafe trait, whose calls are passed on unchanged"
)]

use std::alloc::{GlobalAlloc, Layout};
use std::sync::atomic::{AtomicUsize, Ordering};

use mien_appliance::memory;

pub(crate) struct Counting {
    requests: memory::Counting,
    bytes: AtomicUsize,
}

impl Counting {
    pub(crate) const fn new() -> Self {
        Self {
            requests: memory::Counting::new(),
            bytes: AtomicUsize::new(0),
        }
    }

    /// Allocations and reallocations since the program started.
    pub(crate) fn requests(&self) -> u64 {
        self.requests.requests()
    }

    /// Bytes currently allocated.
    pub(crate) fn bytes_in_use(&self) -> usize {
        self.bytes.load(Ordering::Relaxed)
    }
}

// SAFETY: every method passes its arguments on to the allocator of `mien`, which fulfils the contract.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        self.bytes.fetch_add(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller's promise is the one that is wanted.
        unsafe { self.requests.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        self.bytes.fetch_add(layout.size(), Ordering::Relaxed);
        // SAFETY: as above.
        unsafe { self.requests.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        self.bytes.fetch_add(size, Ordering::Relaxed);
        self.bytes.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as above.
        unsafe { self.requests.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        self.bytes.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as above.
        unsafe { self.requests.dealloc(block, layout) }
    }
}
