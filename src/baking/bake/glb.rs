//! The binary container of glTF 2.0: a description in JSON and one block of data, read and written.
//!
//! Limits: one buffer inside the file; accessors of floats and whole numbers, sparse ones filled in.

use std::fmt::Display;

use serde_json::{Value, json};

use mien_workbench::fault::Fault;

/// Targets of buffer views, as numbered by glTF 2.0.
pub(crate) const VERTICES: u32 = 34962;
pub(crate) const INDICES: u32 = 34963;
const MAGIC: u32 = 0x4654_6C67;
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BIN_CHUNK: u32 = 0x004E_4942;
pub(crate) const FLOAT: u32 = 5126;
pub(super) const U16: u32 = 5123;
pub(super) const U32: u32 = 5125;
/// Bytes that rows may take regardless of the size of the file.
const MIN_BUDGET: usize = 1 << 28;
/// Largest count of an accessor that is accepted.
const MAX_ROWS: usize = 50_000_000;

/// The error for content other than expected.
pub fn unexpected(expected: &str, found: impl Display) -> Fault {
    Fault::new(format!(
        "expected {expected} in the GLB file, found {found}"
    ))
}

/// An error: the bytes are no GLB container.
pub(super) fn not_a_glb(found: &str) -> Fault {
    Fault::new(format!(
        "expected a GLB file (binary glTF 2.0), found {found}"
    ))
}

/// The two chunks of a GLB file.
pub struct Glb {
    /// The description.
    pub json: Value,
    /// The data.
    pub bin: Vec<u8>,
}

impl Glb {
    /// Splits the container.
    ///
    /// # Errors
    /// If it is not a whole GLB file of version 2.
    pub fn parse(bytes: &[u8]) -> Result<Self, Fault> {
        let cut_off = || not_a_glb("a file that ends in the middle");
        let word = |at: usize| {
            let word = bytes.get(at..).and_then(<[u8]>::first_chunk);
            word.map(|b| u32::from_le_bytes(*b)).ok_or_else(cut_off)
        };
        if word(0)? != MAGIC {
            return Err(not_a_glb("another kind of file"));
        }
        if word(4)? != 2 {
            return Err(not_a_glb("another version than 2"));
        }
        let chunk = |at: usize, kind: u32| {
            let end = at + 8 + word(at)? as usize;
            if word(at + 4)? != kind {
                return Err(not_a_glb("chunks in another order than JSON, BIN"));
            }
            let data = bytes.get(at + 8..end).ok_or_else(cut_off)?;
            Ok((data, end))
        };
        let (json, end) = chunk(12, JSON_CHUNK)?;
        let json = parse_json(json)?;
        let bin = match end < bytes.len() {
            true => chunk(end, BIN_CHUNK)?.0.to_vec(),
            false => Vec::new(),
        };
        Ok(Self { json, bin })
    }

    /// The file.
    pub fn emit(&self) -> Vec<u8> {
        let mut json = self.json.to_string().into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let padded = self.bin.len().next_multiple_of(4);
        let total = 12 + 8 + json.len() + 8 + padded;
        let mut out = Vec::with_capacity(total);
        for word in [MAGIC, 2, total as u32, json.len() as u32, JSON_CHUNK] {
            out.extend(word.to_le_bytes());
        }
        out.extend(json);
        for word in [padded as u32, BIN_CHUNK] {
            out.extend(word.to_le_bytes());
        }
        out.extend(&self.bin);
        out.resize(total, 0);
        out
    }

    /// Appends data as a buffer view and returns its index; `target` 0 means none.
    pub fn push_view(&mut self, data: &[u8], target: u32) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let mut view = json!({"buffer": 0, "byteOffset": self.bin.len(), "byteLength": data.len()});
        if target != 0 {
            view["target"] = target.into();
        }
        self.bin.extend(data);
        self.json["buffers"] = json!([{"byteLength": self.bin.len()}]);
        push(&mut self.json["bufferViews"], view)
    }

    /// Appends an accessor and returns its index.
    pub fn push_accessor(&mut self, accessor: Value) -> usize {
        push(&mut self.json["accessors"], accessor)
    }

    /// Appends rows of floats as an accessor; `target` as of [`Self::push_view`].
    pub fn push_rows<const N: usize>(&mut self, rows: &[[f32; N]], target: u32) -> usize {
        let view = self.push_view(&bytes(rows), target);
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"].get(N - 1);
        let kind = kind.unwrap_or(&"MAT4");
        self.push_accessor(
            json!({"bufferView": view, "componentType": FLOAT, "count": rows.len(), "type": kind}),
        )
    }

    /// As [`Self::push_rows`], with the minimum and maximum that positions and times need.
    pub fn push_rows_with_bounds<const N: usize>(
        &mut self,
        rows: &[[f32; N]],
        target: u32,
    ) -> usize {
        let at = self.push_rows(rows, target);
        bound(&mut self.json["accessors"][at], rows);
        at
    }

    /// Appends vertex indices of triangles as an accessor.
    pub(crate) fn push_corners(&mut self, corners: &[u32]) -> usize {
        let data: Vec<u8> = corners.iter().flat_map(|v| v.to_le_bytes()).collect();
        let view = self.push_view(&data, INDICES);
        self.push_accessor(
            json!({"bufferView": view, "componentType": U32, "count": corners.len(), "type": "SCALAR"}),
        )
    }

    /// Bytes that the rows of all accessors may take together, as several may refer to the same data.
    pub fn budget(&self) -> usize {
        MIN_BUDGET.saturating_add(self.bin.len().saturating_mul(16))
    }

    /// Count of an accessor, checked against the size of the file.
    ///
    /// # Errors
    /// If it does not exist or claims more.
    pub fn count(&self, accessor: usize) -> Result<usize, Fault> {
        let count = &self.json["accessors"][accessor]["count"];
        let most = self.bin.len() / 12;
        let known = count.as_u64().filter(|&count| count <= most as u64);
        known.map(|count| count as usize).ok_or_else(|| {
            let found = format!("accessor {accessor}: {count} of at most {most}");
            unexpected("a count of rows that the data could hold", found)
        })
    }

    /// Data of a buffer view from an offset on.
    pub(super) fn data(&self, view: &Value, offset: &Value, bytes: usize) -> Option<&[u8]> {
        let view = self.list_entry("bufferViews", view);
        let from = number(&view["byteOffset"]).saturating_add(number(offset));
        self.bin.get(from..from.saturating_add(bytes))
    }

    /// An entry of a top-level list of the description; null if there is none.
    pub(super) fn list_entry(&self, list: &str, at: &Value) -> &Value {
        &self.json[list][at.as_u64().unwrap_or(u64::MAX) as usize]
    }

    /// Values of a float accessor as rows of `width`, sparse parts filled in.
    ///
    /// # Errors
    /// If the accessor does not exist, is not of floats or reaches over the data.
    pub fn floats(&self, accessor: usize, width: usize) -> Result<Vec<f32>, Fault> {
        let content = content(accessor, "an accessor of floats within the data");
        let a = &self.json["accessors"][accessor];
        if a["componentType"] != FLOAT {
            return Err(content("another component type"));
        }
        let count = a["count"].as_u64().unwrap_or(u64::MAX) as usize;
        if count > MAX_ROWS {
            return Err(content("no count, or one beyond any head"));
        }
        let mut out = if a["bufferView"].is_null() {
            // Without data of its own an accessor is all zeros: at most as many rows as the file could hold.
            if count * width * 4 > self.bin.len() {
                return Err(content("more rows than the file has data for"));
            }
            vec![0.0; count * width]
        } else {
            // 0 if rows follow each other.
            let stride = number(&self.list_entry("bufferViews", &a["bufferView"])["byteStride"]);
            let stride = stride.min(255).max(width * 4);
            let length = count.saturating_sub(1) * stride + width * 4;
            let length = length.min(count * stride);
            let data = self.data(&a["bufferView"], &a["byteOffset"], length);
            let data = data.ok_or_else(|| content(CUT_OFF))?;
            let rows = (0..count).flat_map(|row| singles(&data[row * stride..]).take(width));
            rows.collect()
        };
        if let Some(n) = a["sparse"]["count"].as_u64() {
            let n = (n as usize).min(MAX_ROWS);
            let set = self.sparse(&a["sparse"], n, width);
            let (rows, values) = set.ok_or_else(|| content(CUT_OFF))?;
            for (at, value) in rows.into_iter().zip(values.chunks(width)) {
                let row = out.get_mut(at * width..(at + 1) * width);
                row.ok_or_else(|| content("a sparse index beyond the count"))?
                    .copy_from_slice(value);
            }
        }
        Ok(out)
    }

    /// Rows that a sparse accessor sets, and their values.
    fn sparse(&self, sparse: &Value, n: usize, width: usize) -> Option<(Vec<usize>, Vec<f32>)> {
        let [rows, values] = ["indices", "values"].map(|name| &sparse[name]);
        let size = if rows["componentType"] == U16 { 2 } else { 4 };
        let rows = self.data(&rows["bufferView"], &rows["byteOffset"], n * size)?;
        let data = self.data(&values["bufferView"], &values["byteOffset"], n * width * 4)?;
        let rows = whole(rows, size).map(|k| k as usize);
        Some((rows.collect(), singles(data).collect()))
    }

    /// Values of an accessor of whole numbers.
    ///
    /// # Errors
    /// If the accessor does not exist, is of another type or reaches over the data.
    pub fn indices(&self, accessor: usize) -> Result<Vec<u32>, Fault> {
        let content = content(accessor, "an accessor of whole numbers within the data");
        let a = &self.json["accessors"][accessor];
        let size = match a["componentType"].as_u64() {
            Some(5121) => 1,
            Some(5123) => 2,
            Some(5125) => 4,
            _ => return Err(content("another component type")),
        };
        let length = (a["count"].as_u64().unwrap_or(u64::MAX) as usize).saturating_mul(size);
        let data = self.data(&a["bufferView"], &a["byteOffset"], length);
        Ok(whole(data.ok_or_else(|| content(CUT_OFF))?, size).collect())
    }
}

const CUT_OFF: &str = "data that end too early";

fn content(accessor: usize, expected: &str) -> impl Fn(&str) -> Fault {
    move |found| unexpected(expected, format!("accessor {accessor}: {found}"))
}

/// Sets the minimum and maximum of each column of an accessor.
pub(super) fn bound<const N: usize>(accessor: &mut Value, rows: &[[f32; N]]) {
    let end = |of: fn(f32, f32) -> f32, from: f32| -> [f32; N] {
        std::array::from_fn(|k| rows.iter().map(|row| row[k]).fold(from, of))
    };
    accessor["min"] = json!(&end(f32::min, f32::INFINITY)[..]);
    accessor["max"] = json!(&end(f32::max, f32::NEG_INFINITY)[..]);
}

/// Parses the JSON description.
pub(super) fn parse_json(text: &[u8]) -> Result<Value, Fault> {
    let json: Value = serde_json::from_slice(text)
        .map_err(Fault::within("the JSON chunk of the GLB file is damaged"))?;
    match json.is_object() {
        true => Ok(json),
        false => Err(not_a_glb("JSON that is no object")),
    }
}

/// A whole number, or 0.
fn number(value: &Value) -> usize {
    value.as_u64().unwrap_or(0) as usize
}

/// Entries of a JSON list; empty if it is none.
pub fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

fn singles(data: &[u8]) -> impl Iterator<Item = f32> {
    data.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b))
}

/// Unsigned integers of `size` bytes each.
fn whole(data: &[u8], size: usize) -> impl Iterator<Item = u32> {
    let number = |b: &[u8]| b.iter().rev().fold(0, |n, &b| n << 8 | u32::from(b));
    data.chunks_exact(size).map(number)
}

pub(crate) fn bytes<const N: usize>(rows: &[[f32; N]]) -> Vec<u8> {
    let values = rows.as_flattened().iter();
    values.flat_map(|v| v.to_le_bytes()).collect()
}

/// Appends an item to a list, which is made if there is none; returns its index.
pub fn push(list: &mut Value, item: Value) -> usize {
    if !list.is_array() {
        *list = json!([]);
    }
    let list = list.as_array_mut().expect("made an array above");
    list.push(item);
    list.len() - 1
}
