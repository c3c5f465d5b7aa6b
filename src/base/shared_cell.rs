//! A large value that several stages use in turn.
//!
//! With the standard library, a lock that is never contended; without it, a check that there is only one user at a time.

#[cfg(feature = "std")]
mod inner {
    use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

    pub(super) type Inner<T> = Arc<Mutex<T>>;

    pub(super) fn borrow<T>(inner: &Inner<T>) -> MutexGuard<'_, T> {
        inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(not(feature = "std"))]
mod inner {
    use alloc::rc::Rc;
    use core::cell::{RefCell, RefMut};

    pub(super) type Inner<T> = Rc<RefCell<T>>;

    pub(super) fn borrow<T>(inner: &Inner<T>) -> RefMut<'_, T> {
        inner.borrow_mut()
    }
}

/// One of its owners.
#[derive(Default)]
pub struct Shared<T>(inner::Inner<T>);

impl<T> Shared<T> {
    /// For as long as one works with it.
    pub(crate) fn borrow(&self) -> impl core::ops::DerefMut<Target = T> + '_ {
        inner::borrow(&self.0)
    }
}

impl<T> Clone for Shared<T> {
    /// Another owner.
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}
