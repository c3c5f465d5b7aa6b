//! The foundation of all other modules: capacities, geometry, time, and small tools the standard library lacks.

#[cfg(feature = "std")]
pub(crate) mod atomic_write;
#[cfg(feature = "std")]
pub(crate) mod bounded_read;
pub mod capacity;
pub mod checksum;
pub mod frames;
pub mod geometry;
#[cfg(feature = "std")]
pub(crate) mod json;
#[cfg(feature = "std")]
pub(crate) mod nearest_word;
pub mod one_euro;
pub(crate) mod prelude;
#[cfg(feature = "std")]
pub(crate) mod second_core;
pub mod settings;
pub mod time;
pub mod vectors;

/// Structs whose fields stand beside their defaults: `pub field: Type = value,`.
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
pub(crate) use defaults;
