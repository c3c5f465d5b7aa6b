//! Keys of the configuration: name, meaning, allowed values and storage of each value.
//!
//! A struct made by [`keyed!`](keyed) declares each key once: the field, its default, its documentation (also the comment in
//! `config/mien.toml`) and the allowed values. The appliance reads, checks and prints configurations by these keys.

use core::net::SocketAddr;

use crate::base::prelude::*;

/// Most targets of an output, because a target given by name has its own thread.
const TARGETS_MOST: usize = 16;

/// One key and its current value.
pub struct Key<'a> {
    /// Its name.
    pub name: &'static str,
    /// Its meaning, in a sentence.
    pub about: &'static str,
    /// Type, range and storage of its value.
    pub kind: Kind<'a>,
}

/// Type, range and storage of a key's value.
pub enum Kind<'a> {
    /// Storage, least and greatest value, and unit.
    Number(&'a mut dyn Number, [f32; 2], &'static str),
    /// True or false.
    Bool(&'a mut bool),
    /// Storage, format in words, and validation.
    Text(&'a mut String, &'static str, fn(&str) -> bool),
    /// As `Text`, for one text or an array; the last field is the least and greatest count.
    Texts(
        &'a mut Vec<String>,
        &'static str,
        fn(&str) -> bool,
        [usize; 2],
    ),
    /// Index of the current name, all names, and a function that stores the value at an index.
    Choice(usize, Vec<&'static str>, Box<dyn FnOnce(usize) + 'a>),
}

/// A number of a setting: `u32` for counts, `f32` for images, `f64` for long sums. `{:?}` writes it as TOML, a float always with
/// a decimal point.
pub trait Number: core::fmt::Debug {
    /// Stores a number within the key's range.
    fn set(&mut self, number: f64);

    /// Whether only whole numbers can be stored.
    fn is_whole(&self) -> bool {
        false
    }
}

impl Number for u32 {
    fn set(&mut self, number: f64) {
        *self = number as Self;
    }

    fn is_whole(&self) -> bool {
        true
    }
}

impl Number for f32 {
    fn set(&mut self, number: f64) {
        *self = number as Self;
    }
}

impl Number for f64 {
    fn set(&mut self, number: f64) {
        *self = number;
    }
}

/// Settings with keys.
pub trait Keys {
    /// The keys, in the order of printing.
    fn keys(&mut self) -> Vec<Key<'_>>;
}

/// Lists are not configured by keys.
impl<T> Keys for Vec<T> {
    fn keys(&mut self) -> Vec<Key<'_>> {
        Vec::new()
    }
}

/// Declares structs whose fields are keys: a doc sentence, then `field: Type = default => form(…),`. A form is a [`Kind`] variant
/// or constructor. A quoted name after the field is the key's name if it differs. `..field: Type,` at the end includes that type's
/// keys.
#[macro_export]
macro_rules! keyed {
    (@name $field:ident $key:literal) => { $key };
    (@name $field:ident) => { stringify!($field) };
    ($($(#[doc = $what:literal])+ $(#[derive($more:ident)])? pub struct $name:ident {
        $($(#[doc = $about:literal])+ $field:ident $($key:literal)?: $kind:ty = $value:expr => $form:ident($($limit:expr),*),)*
        $(..$part:ident: $part_kind:ty,)*
    })*) => {$(
        $(#[doc = $what])+
        #[derive(Clone, Debug, PartialEq $(, $more)?)]
        pub struct $name {
            $($(#[doc = $about])+ pub $field: $kind,)*
            $(
                #[doc = concat!("The ", stringify!($part), ".")]
                pub $part: $part_kind,
            )*
        }
        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $value,)* $($part: <$part_kind>::default(),)* }
            }
        }
        impl $crate::base::settings::Keys for $name {
            fn keys(&mut self) -> $crate::base::prelude::Vec<$crate::base::settings::Key<'_>> {
                #[allow(unused_mut, reason = "a struct without parts is complete")]
                let mut keys = $crate::base::prelude::vec![$($crate::base::settings::Key {
                    name: $crate::base::settings::keyed!(@name $field $($key)?),
                    about: concat!($($about),+).trim_ascii_start(),
                    kind: $crate::base::settings::Kind::$form(&mut self.$field, $($limit),*),
                }),*];
                $(keys.extend($crate::base::settings::Keys::keys(&mut self.$part));)*
                keys
            }
        }
    )*};
}
pub use keyed;

impl<'a> Kind<'a> {
    /// A number between `least` and `most`, in `unit`; a whole number if stored as `u32`.
    pub fn number(value: &'a mut dyn Number, least: f32, most: f32, unit: &'static str) -> Self {
        Self::Number(value, [least, most], unit)
    }

    /// A time of up to 60 s.
    pub fn seconds(value: &'a mut f32) -> Self {
        Self::number(value, 0.0, 60.0, "s")
    }

    /// One of several named values.
    pub fn choice<T: Copy + PartialEq>(
        value: &'a mut T,
        all: &'static [(&'static str, T)],
    ) -> Self {
        let present = all.iter().position(|one| one.1 == *value);
        let names = all.iter().map(|one| one.0).collect();
        let set = Box::new(|index: usize| *value = all[index].1);
        Self::Choice(present.unwrap_or_default(), names, set)
    }

    /// Targets of an output.
    pub fn targets(value: &'a mut Vec<String>) -> Self {
        let form = "host:port, or up to 16 as [\"host:port\", \"host:port\"]";
        Self::Texts(value, form, is_host_port, [1, TARGETS_MOST])
    }

    /// A local `address:port`.
    pub fn listen(value: &'a mut String) -> Self {
        let is_address = |text: &str| text.parse::<SocketAddr>().is_ok();
        Self::Text(value, "address:port", is_address)
    }
}

/// Whether a text is `host:port`.
pub fn is_host_port(text: &str) -> bool {
    text.rsplit_once(':')
        .is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok())
}
