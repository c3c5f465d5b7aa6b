//! Expressions that the mesh's own set lacks, derived from those it has: jaw to a side and forward, pucker, grin, wide eyes,
//! raised outer brows. They are approximations whose purpose is that every measure has something to move it.

use nalgebra::Vector3;

use crate::studio::heads::ict::{Delta, IctHead, part};

/// How far a full `jawLeft`, `jawRight` goes, metres.
const JAW_ASIDE_M: f32 = 0.010;
/// How far a full `jawForward` goes, metres.
const JAW_FORWARD_M: f32 = 0.007;
/// Share of the lid's way down that `eyeWide` goes up.
const WIDE_SHARE: f32 = 0.16;

/// A name and how far each vertex moves, metres.
type Derived = (&'static str, Vec<Vector3<f32>>);

/// Adds the derived expressions, keeping the order by name.
pub fn complete(ict: &mut IctHead) {
    let mut derived = Vec::new();
    jaw(ict, &mut derived);
    lips(ict, &mut derived);
    wide_eyes(ict, &mut derived);
    outer_brows(ict, &mut derived);
    for (name, offsets) in derived {
        if ict.expression(name).is_none() {
            ict.expressions.push(Delta {
                name: name.into(),
                offsets,
            });
        }
    }
    ict.expressions
        .retain(|delta| !delta.name.starts_with("PupilDilate"));
    ict.expressions.sort_by(|a, b| a.name.cmp(&b.name));
}

fn find(ict: &IctHead, name: &str) -> Option<Vec<Vector3<f32>>> {
    ict.expression(name)
        .map(|k| ict.expressions[k].offsets.clone())
}

fn jaw(ict: &IctHead, derived: &mut Vec<Derived>) {
    if let Some(open) = find(ict, "jawOpen") {
        // What goes down with the jaw goes with it in other directions; the lower lip as a whole.
        let chin = open[ict.landmarks[8]].norm().max(1e-6);
        let share: Vec<f32> = open.iter().map(|o| (o.norm() / chin).min(1.0)).collect();
        let along = |direction: Vector3<f32>| share.iter().map(|s| direction * *s).collect();
        derived.push(("jawLeft", along(Vector3::new(JAW_ASIDE_M, 0.0, 0.0))));
        derived.push(("jawRight", along(Vector3::new(-JAW_ASIDE_M, 0.0, 0.0))));
        derived.push(("jawForward", along(Vector3::new(0.0, 0.0, -JAW_FORWARD_M))));
    }
}

fn lips(ict: &IctHead, derived: &mut Vec<Derived>) {
    let n = ict.neutral.len();
    let lip = |k: usize| ict.neutral[ict.landmarks[k]];
    let (right, left) = (lip(48), lip(54));
    let middle = nalgebra::center(&right, &left);
    let half_width = (left - right).norm() * 0.5;
    // 1 on the lips, falling smoothly to 0 two half widths away; the face's skin and the mouth's inside only.
    let lips: Vec<f32> = (0..n)
        .map(|v| {
            let d =
                (ict.neutral[v] - middle).component_div(&Vector3::new(1.0, 0.75, 1.6)) / half_width;
            let skin = part::FACE.contains(&v) || part::MOUTH_SOCKET.contains(&v);
            if skin {
                (1.0 - (d.norm() - 0.9).max(0.0) / 1.1)
                    .clamp(0.0, 1.0)
                    .powi(2)
            } else {
                0.0
            }
        })
        .collect();
    let pucker = (0..n)
        .map(|v| {
            let d = ict.neutral[v] - middle;
            lips[v] * Vector3::new(-0.38 * d.x, -0.06 * d.y, -0.006)
        })
        .collect();
    derived.push(("mouthPucker", pucker));
    for (name, side) in [("mouthStretch_L", 1.0f32), ("mouthStretch_R", -1.0)] {
        let stretch = (0..n)
            .map(|v| {
                let d = ict.neutral[v] - middle;
                let aside = (side * d.x / half_width).clamp(0.0, 1.4);
                lips[v] * aside.min(1.0) * Vector3::new(side * 0.009, 0.002, 0.003)
            })
            .collect();
        derived.push((name, stretch));
    }
}

fn wide_eyes(ict: &IctHead, derived: &mut Vec<Derived>) {
    let n = ict.neutral.len();
    for (name, source, lids) in [
        ("eyeWide_L", "eyeBlink_L", [43usize, 44]),
        ("eyeWide_R", "eyeBlink_R", [37, 38]),
    ] {
        if let Some(blink) = find(ict, source) {
            let upper = lids.map(|k| ict.neutral[ict.landmarks[k]].y);
            let edge = (upper[0] + upper[1]) * 0.5;
            let wide = (0..n)
                .map(|v| {
                    // Only what comes down: the lower lid's way up is no part of opening wide.
                    let o = blink[v];
                    let above = ((edge + 0.004 - ict.neutral[v].y) / 0.004).clamp(0.0, 1.0);
                    if part::FACE.contains(&v) && o.y > 0.0 {
                        -o * WIDE_SHARE * above
                    } else {
                        Vector3::zeros()
                    }
                })
                .collect();
            derived.push((name, wide));
        }
    }
}

fn outer_brows(ict: &IctHead, derived: &mut Vec<Derived>) {
    let n = ict.neutral.len();
    for (name, brow, side) in [
        ("browOuterUp_L", 24usize, 1.0f32),
        ("browOuterUp_R", 19, -1.0),
    ] {
        let at = ict.neutral[ict.landmarks[brow]];
        let up = (0..n)
            .map(|v| {
                if !part::FACE.contains(&v) {
                    return Vector3::zeros();
                }
                let d = ict.neutral[v] - at;
                // The brow moves up by 8 mm; the lid below it must stay, the forehead folds.
                let below = (1.0 - d.y.max(0.0) / 0.012).clamp(0.0, 1.0);
                let above = (1.0 + d.y.min(0.0) / 0.045).clamp(0.0, 1.0);
                let across = (-(d.x * side / 0.022).powi(2)).exp();
                Vector3::new(0.0, -0.008, 0.001) * below * above * across
            })
            .collect();
        derived.push((name, up));
    }
}
