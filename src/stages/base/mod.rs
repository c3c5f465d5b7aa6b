//! Foundation of all other modules: capacities, geometry, time, and small tools.

#[cfg(feature = "std")]
pub mod atomic_write;
#[cfg(feature = "std")]
pub mod bounded_read;
pub mod capacity;
pub mod checksum;
pub mod frames;
pub mod geometry;
#[cfg(feature = "std")]
pub mod json;
#[cfg(feature = "std")]
pub mod nearest_word;
pub mod one_euro;
#[cfg(feature = "std")]
pub mod peak_memory;
pub mod prelude;
#[cfg(feature = "std")]
pub mod second_core;
pub mod settings;
pub mod sorting;
pub mod time;
pub mod vectors;

/// Declares structs with a default beside each field: `pub field: Type = value,`.
#[macro_export]
macro_rules! defaults {
    ($($(#[$about:meta])* $seen:vis struct $name:ident {
        $($(#[$of:meta])* $by:vis $field:ident: $kind:ty = $value:expr,)*
    })*) => {$(
        $(#[$about])*
        $seen struct $name {
            $($(#[$of])* $by $field: $kind,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $value,)* }
            }
        }
    )*};
}
pub use defaults;
