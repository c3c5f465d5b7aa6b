//! Names of the action units: FACS, plain, ARKit, and a description of the movement.
//!
//! One table for the live line, `mien send-test`, the configuration, the pages and `docs/units.md`. Codes omit the side; `L`
//! and `R` are the subject's own left and right.

#[cfg(feature = "std")]
use super::regions::RegionSet;
use crate::base::prelude::*;

/// Names of one unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnitWords {
    /// FACS code without a side.
    pub code: &'static str,
    /// FACS name (Ekman & Friesen 1978).
    pub facs: &'static str,
    /// Plain name, as used by animators.
    pub plain: &'static str,
    /// Corresponding ARKit blend shapes without a side, separated by spaces; may be empty.
    pub arkit: &'static str,
    /// Description of the movement.
    pub does: &'static str,
}

const fn unit(
    code: &'static str,
    facs: &'static str,
    plain: &'static str,
    arkit: &'static str,
    does: &'static str,
) -> UnitWords {
    UnitWords {
        code,
        facs,
        plain,
        arkit,
        does,
    }
}

/// Every unit with a column: code, FACS, plain, ARKit, movement.
#[rustfmt::skip]
pub const ALL: [UnitWords; 25] = [
    unit("AU1", "inner brow raiser", "inner brow up", "browInnerUp", "the inner end of the brow rises"),
    unit("AU2", "outer brow raiser", "outer brow up", "browOuterUp", "the outer half of the brow rises"),
    unit("AU4", "brow lowerer", "brow down", "browDown", "the brow lowers and draws together"),
    unit("AU5", "upper lid raiser", "eye wide", "eyeWide", "the upper lid rises above its rest"),
    unit("AU6", "cheek raiser", "cheek up", "cheekSquint", "the cheek rises and narrows the eye"),
    unit("AU9", "nose wrinkler", "nose wrinkle", "noseSneer", "the nostril is drawn up, the nose wrinkles"),
    unit("AU10", "upper lip raiser", "upper lip up", "mouthUpperUp", "the upper lip rises"),
    unit("AU12", "lip corner puller", "smile", "mouthSmile", "the corner of the mouth moves up and out"),
    unit("AU14", "dimpler", "dimple", "mouthDimple", "the corner of the mouth tightens inwards"),
    unit("AU15", "lip corner depressor", "frown", "mouthFrown", "the corner of the mouth drops"),
    unit("AU17", "chin raiser", "chin up", "mouthShrugLower", "the chin pushes the lower lip up"),
    unit("AU18", "lip pucker", "pucker", "mouthPucker", "the lips draw together, as for a kiss"),
    unit("AU20", "lip stretcher", "stretch", "mouthStretch", "the mouth widens"),
    unit("AU22", "lip funneler", "funnel", "mouthFunnel", "the lips open and push forward"),
    unit("AU25", "lips part", "lips part", "", "the lips separate"),
    unit("AU26", "jaw drop", "jaw drop", "jawOpen", "the jaw drops, the mouth opens"),
    unit("AU28", "lip suck", "lips in", "mouthRollLower mouthRollUpper", "the lips are rolled in over the teeth"),
    unit("AU29", "jaw thrust", "jaw forward", "jawForward", "the jaw moves forward"),
    unit("AU30", "jaw sideways", "jaw", "jaw", "the jaw moves to one side"),
    unit("AU34", "cheek puff", "cheek puff", "cheekPuff", "the cheek puffs out"),
    unit("AU43", "eye closure", "blink", "eyeBlink", "the eye closes"),
    unit("AU61", "eyes turn left", "look left", "eyeLookOut eyeLookIn", "both eyes turn to the subject's left"),
    unit("AU62", "eyes turn right", "look right", "eyeLookOut eyeLookIn", "both eyes turn to the subject's right"),
    unit("AU63", "eyes up", "look up", "eyeLookUp", "both eyes look up"),
    unit("AU64", "eyes down", "look down", "eyeLookDown", "both eyes look down"),
];

/// Regions of the face from top to bottom, each with its units' numbers in display order.
pub const REGIONS: [(&str, &[u32]); 5] = [
    ("Brows", &[1, 2, 4]),
    ("Eyes", &[5, 43, 61, 62, 63, 64]),
    ("Nose and cheeks", &[6, 9, 34]),
    ("Mouth", &[12, 15, 14, 20, 18, 22, 25, 28, 10, 17]),
    ("Jaw", &[26, 29, 30]),
];
/// Title of the last region, for renamed units.
pub const OTHER: &str = "Other";

/// Indices into `units`, grouped by region in display order.
pub fn by_region(units: &[&str]) -> Vec<(&'static str, Vec<usize>)> {
    let number =
        |unit: &&str| find(unit).and_then(|(words, _)| words.code[2..].parse::<u32>().ok());
    let numbers: Vec<Option<u32>> = units.iter().map(number).collect();
    let known = REGIONS.map(|(title, all)| {
        let rows = all.iter().flat_map(|&wanted| {
            let places = numbers.iter().enumerate();
            places.filter_map(move |(k, number)| (*number == Some(wanted)).then_some(k))
        });
        (title, rows.collect::<Vec<usize>>())
    });
    let is_shown = |k: &usize| known.iter().any(|(_, rows)| rows.contains(k));
    let others = (0..units.len()).filter(|k| !is_shown(k)).collect();
    let mut regions = known.to_vec();
    regions.push((OTHER, others));
    regions.retain(|(_, rows)| !rows.is_empty());
    regions
}

/// Units for the pages: `[[region, [[index, unit, name, description, [name of a region that it needs to be seen]]]]]`. A renamed unit
/// needs none.
#[cfg(feature = "std")]
pub fn regions_json(units: &[&str]) -> serde_json::Value {
    let row = |k: usize| {
        let unit = units[k];
        let mut name = plain(unit).unwrap_or_else(|| unit.to_owned());
        let first = name.chars().next().map_or(0, char::len_utf8);
        name[..first].make_ascii_uppercase();
        let about = find(unit).map_or_else(String::new, |(words, side)| {
            let whose = match side {
                "L" => " (the subject's left)",
                "R" => " (the subject's right)",
                _ => "",
            };
            format!("{unit}, {}: {}{whose}", words.facs, words.does)
        });
        let needs = find(unit).map(|_| RegionSet::of_unit(unit).names());
        let needs: Vec<&str> = needs.into_iter().flatten().collect();
        serde_json::json!([k, unit, name, about, needs])
    };
    let regions = by_region(units).into_iter();
    let rows = |rows: Vec<usize>| rows.into_iter().map(row).collect::<Vec<_>>();
    regions
        .map(|(title, all)| serde_json::json!([title, rows(all)]))
        .collect()
}

/// A unit's plain name with its side in words, such as `smile left`; `None` for an unknown unit.
pub fn plain(unit: &str) -> Option<String> {
    let (UnitWords { plain, .. }, side) = find(unit)?;
    Some(match side {
        "L" => format!("{plain} left"),
        "R" => format!("{plain} right"),
        _ => (*plain).to_owned(),
    })
}

/// A unit's names and its side (`"L"`, `"R"` or empty); `None` for an unknown unit.
pub fn find(unit: &str) -> Option<(&'static UnitWords, &str)> {
    let code = unit.trim_end_matches(['L', 'R']);
    let words = ALL.iter().find(|words| words.code == code)?;
    Some((words, &unit[code.len()..]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expression::Units;

    #[test]
    fn every_column_has_words_and_every_word_a_column() {
        let units = Units::shipped();
        for paper in [false, true] {
            for column in units.columns(paper) {
                assert!(find(&column).is_some(), "{column} has no words");
            }
        }
        let columns = units.columns(false);
        for words in &ALL {
            let has = |name: &str| columns.iter().any(|column| column == name);
            let side = |side: &str| has(&format!("{}{side}", words.code));
            assert!(has(words.code) || side("L") && side("R"), "{}", words.code);
        }
        let names: Vec<&str> = columns.iter().map(|name| &**name).collect();
        let regions = by_region(&names);
        assert!(regions.iter().all(|(title, _)| *title != OTHER));
        let mut shown: Vec<usize> = regions.into_iter().flat_map(|(_, rows)| rows).collect();
        shown.sort_unstable();
        assert!(shown.into_iter().eq(0..names.len()), "each unit once");
        assert_eq!(
            by_region(&["AU26", "AU12R", "mine", "AU12L"]),
            [("Mouth", vec![1, 3]), ("Jaw", vec![0]), (OTHER, vec![2])]
        );
        assert_eq!(
            find("AU12L").map(|(words, side)| (words.plain, side)),
            Some(("smile", "L"))
        );
        assert!(find("AU").is_none() && find("gaze").is_none());
    }

    #[test]
    fn arkit_names_equal_the_rigs() {
        let rigs = include_str!("../../../config/rigs.toml");
        let arkit = rigs
            .split("[arkit]")
            .nth(1)
            .and_then(|text| text.split("\n[").next());
        let arkit = arkit.expect("a section of ARKit's names");
        for words in &ALL {
            for name in words.arkit.split_whitespace() {
                let rows = arkit.lines().filter(|line| line.starts_with(name));
                assert!(
                    rows.clone().any(|line| line.contains(words.code)),
                    "{name} of {}: {:?}",
                    words.code,
                    rows.collect::<Vec<_>>()
                );
            }
        }
    }
}
