//! Keys of the configuration: what a value is called, what it means, which values are allowed, and where it is stored.
//!
//! A struct made by [`keyed!`](keyed) says each of its keys once: the field with its default, its documentation, which is also
//! the comment in `config/mien.toml`, and what is allowed. The appliance reads, checks and prints files by these keys.

use core::net::SocketAddr;

use crate::base::prelude::*;

/// Most targets of an output; one given by name has a thread of its own.
const TARGETS_MOST: usize = 16;

/// One key, and its present value.
pub struct Key<'a> {
    /// Its name.
    pub name: &'static str,
    /// What it means, in a sentence.
    pub about: &'static str,
    /// Its type and range, and where its value is stored.
    pub kind: Kind<'a>,
}

/// Type and range of a key's value, and where it is stored.
pub enum Kind<'a> {
    /// Where it is stored, its least and greatest value, and its unit.
    Number(&'a mut dyn Number, [f32; 2], &'static str),
    /// True or false.
    Bool(&'a mut bool),
    /// Where it is stored, its form in words, and the check of it.
    Text(&'a mut String, &'static str, fn(&str) -> bool),
    /// One text, or several in an array; the last field is the least and greatest count.
    Texts(
        &'a mut Vec<String>,
        &'static str,
        fn(&str) -> bool,
        [usize; 2],
    ),
    /// Index of the present name, all names, and a function that stores the value of an index.
    Choice(usize, Vec<&'static str>, Box<dyn FnOnce(usize) + 'a>),
}

/// A number as the stages store it: whole for counts, single precision for images, double for what accumulates over months.
/// `{:?}` writes it as TOML: a float always with a decimal point, so that it stays one.
pub trait Number: core::fmt::Debug {
    /// Stores a number, which is in the key's range.
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

/// Settings that have keys.
pub trait Keys {
    /// Its keys, in the order in which they are printed.
    fn keys(&mut self) -> Vec<Key<'_>>;
}

/// A list that is filled from elsewhere has no keys.
impl<T> Keys for Vec<T> {
    fn keys(&mut self) -> Vec<Key<'_>> {
        Vec::new()
    }
}

/// Structs whose fields are keys: `field: Type = default => form(…),` below the sentence about them. A form is a [`Kind`] or a
/// function that makes one. A name in quotes behind the field is the key's, where that is another one. `..field: Type,` at the
/// end has keys of its own.
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
    /// A number between limits, in a unit; of a `u32` a whole one.
    pub fn number(value: &'a mut dyn Number, least: f32, most: f32, unit: &'static str) -> Self {
        Self::Number(value, [least, most], unit)
    }

    /// A time of up to a minute.
    pub fn seconds(value: &'a mut f32) -> Self {
        Self::number(value, 0.0, 60.0, "s")
    }

    /// One of several values, each with its name.
    pub fn choice<T: Copy + PartialEq>(
        value: &'a mut T,
        all: &'static [(&'static str, T)],
    ) -> Self {
        let present = all.iter().position(|one| one.1 == *value);
        let names = all.iter().map(|one| one.0).collect();
        let set = Box::new(|index: usize| *value = all[index].1);
        Self::Choice(present.unwrap_or_default(), names, set)
    }

    /// Where an output sends to.
    pub fn targets(value: &'a mut Vec<String>) -> Self {
        let form = "host:port, or up to 16 as [\"host:port\", \"host:port\"]";
        Self::Texts(value, form, is_host_port, [1, TARGETS_MOST])
    }

    /// `address:port` of this machine.
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
