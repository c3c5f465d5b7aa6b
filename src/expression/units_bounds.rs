//! Known answers at the bounds of a table of units.

use super::units::Units;

const SHIPPED: &str = include_str!("../../config/units.toml");

#[test]
fn a_wrong_name_is_quoted_by_its_first_letters() {
    let long = "AU25_abcdefghijklmnopqrstuvwxyz";
    let text = SHIPPED.replacen(
        "[[reading]]\nunit = \"AU",
        &format!("[[reading]]\nunit = \"{long}"),
        1,
    );
    let message = Units::read(&text).unwrap_err().to_string();
    assert!(
        message.contains(&long[..16]) && !message.contains(&long[..17]),
        "{message}"
    );
}

#[test]
fn a_measure_is_explained_by_up_to_four_others() {
    let with = |count: usize| {
        let rows = ["jaw_drop", "corner_L", "corner_R", "brow_L", "brow_R"];
        let rows: String = rows[..count]
            .iter()
            .map(|by| format!("{{ by = \"{by}\", share = 0.1 }},"))
            .collect();
        let text = SHIPPED.replacen(
            "measure = \"lip_gap\"\n",
            &format!("measure = \"lip_gap\"\nexplained = [{rows}]\n"),
            1,
        );
        Units::read(&text).map(|units| units.rows[0].explained.len())
    };
    assert_eq!(with(4).ok(), Some(4));
    let refused = with(5).unwrap_err().to_string();
    assert!(refused.contains("lip_gap"), "{refused}");
}
