//! Values and names as USD's text has them.

use std::collections::HashSet;

use super::super::looks::plain;

/// A number as USD reads it: the shortest that gives the same value again.
fn number(value: &f32) -> String {
    match *value == 0.0 {
        true => "0".into(),
        // Debug has exponents, so that what is nearly nothing is not a hundred digits.
        false => format!("{value:?}"),
    }
}

/// An array.
pub(super) fn array<T>(values: impl IntoIterator<Item = T>, one: impl Fn(T) -> String) -> String {
    let values: Vec<String> = values.into_iter().map(one).collect();
    format!("[{}]", values.join(", "))
}

/// An array of tuples.
pub(super) fn tuples<const N: usize>(rows: impl IntoIterator<Item = [f32; N]>) -> String {
    array(rows, |row| {
        format!("({})", row.each_ref().map(number).join(", "))
    })
}

/// An array of whole numbers.
pub(super) fn whole(values: impl IntoIterator<Item = usize>) -> String {
    array(values, |value| value.to_string())
}

/// A string in quotes.
pub(super) fn quoted(text: &str) -> String {
    let text = text.replace('\\', "\\\\").replace('"', "\\\"");
    format!("\"{}\"", text.replace(char::is_control, " "))
}

/// Names of the prims beneath one prim: identifiers, each given once.
#[derive(Default)]
pub(super) struct Siblings(HashSet<String>);

impl Siblings {
    /// The name of the prim for `name`: the same if it is an identifier that nobody has yet.
    pub(super) fn name(&mut self, name: &str) -> String {
        let mut valid: String = name.chars().map(plain).collect();
        if !valid.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') {
            valid.insert(0, '_');
        }
        let mut free = valid.clone();
        for k in 2.. {
            if self.0.insert(free.clone()) {
                break;
            }
            free = format!("{valid}_{k}");
        }
        free
    }
}
