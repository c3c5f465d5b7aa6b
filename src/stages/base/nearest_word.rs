//! Suggests the known word nearest to a misspelt one.

/// Least Damerau–Levenshtein similarity of a suggestion.
const NEAR: f64 = 0.6;

/// ` (did you mean WORD?)` with the nearest known word, or an empty text if none is near.
pub fn hint<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    let alike = |known: &'a str| (strsim::normalized_damerau_levenshtein(word, known), known);
    let nearest = known.into_iter().map(alike);
    match nearest.max_by(|a, b| a.0.total_cmp(&b.0)) {
        Some((alike, known)) if alike >= NEAR => format!(" (did you mean {known}?)"),
        _ => String::new(),
    }
}
