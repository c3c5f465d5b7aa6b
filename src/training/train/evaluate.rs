//! Errors of fitted landmarks against annotated ones: percent of the outer eye distance, by region.

use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::scheme;

/// Differences of all points ([`differences`]).
pub type Differences = [[f32; 2]; LANDMARKS];

/// Mean length of some differences, percent.
pub fn mean_percent(some: &[[f32; 2]]) -> f32 {
    100.0 * some.iter().map(|d| d[0].hypot(d[1])).sum::<f32>() / some.len() as f32
}

/// Fitted minus annotated points in face axes (x along the outer eye corners), in outer eye distances.
pub fn differences(fitted: &[[f32; 2]; LANDMARKS], placed: &[[f32; 2]; LANDMARKS]) -> Differences {
    let [r, l] = scheme::OUTER_EYE_CORNERS;
    let eye = scheme::outer_eye_distance(placed).max(1e-6);
    let along = [0, 1].map(|k| (placed[l][k] - placed[r][k]) / eye);
    std::array::from_fn(|i| {
        let d = [fitted[i][0] - placed[i][0], fitted[i][1] - placed[i][1]];
        [
            (d[0] * along[0] + d[1] * along[1]) / eye,
            (d[1] * along[0] - d[0] * along[1]) / eye,
        ]
    })
}

/// Mean error of some faces over the inner 51 points, percent.
pub fn mean_inner(faces: &[Differences]) -> f32 {
    let inner = faces.iter().map(|d| mean_percent(&d[scheme::INNER]));
    inner.sum::<f32>() / faces.len().max(1) as f32
}

/// Errors of some faces in one line: mean, median, 95th percentile, inner 51, share over 10 %, regions.
pub fn summary(faces: &[Differences]) -> String {
    use std::fmt::Write;
    if faces.is_empty() {
        return "no annotated faces".into();
    }
    let count = faces.len() as f32;
    let errors: Vec<f32> = faces.iter().map(|d| mean_percent(d)).collect();
    let mut sorted = errors.clone();
    sorted.sort_by(f32::total_cmp);
    let at = |share: f32| sorted[((sorted.len() - 1) as f32 * share).round() as usize];
    let mut line = format!(
        "{} faces: mean {:.2} %, median {:.2}, p95 {:.2}, inner 51 {:.2}; over 10 %: {:.1} %;",
        faces.len(),
        errors.iter().sum::<f32>() / count,
        at(0.5),
        at(0.95),
        mean_inner(faces),
        100.0 * errors.iter().filter(|e| **e > 10.0).count() as f32 / count,
    );
    let of_point = |i: usize| {
        faces
            .iter()
            .map(|d| f64::from(mean_percent(&[d[i]])))
            .sum::<f64>()
    };
    for (name, range) in scheme::REGIONS {
        let size = range.len() as f64 * f64::from(count);
        let mean = range.map(of_point).sum::<f64>() / size;
        let _ = write!(line, " {name} {mean:.2}");
    }
    line
}

/// Mean difference per landmark, face axes, in outer eye distances.
pub fn mean_offsets(differences: &[Differences]) -> Differences {
    let count = differences.len().max(1) as f32;
    let mean = |i: usize, k: usize| differences.iter().fold(0.0, |s, d| s + d[i][k]) / count;
    std::array::from_fn(|i| [0, 1].map(|k| mean(i, k)))
}

/// Differences less offsets.
pub fn without(differences: &Differences, offsets: &Differences) -> Differences {
    std::array::from_fn(|i| [0, 1].map(|k| differences[i][k] - offsets[i][k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_in_face_axes() {
        let mut placed = [[100.0, 100.0]; LANDMARKS];
        placed[36] = [100.0, 100.0];
        placed[45] = [100.0, 150.0];
        let mut fitted = placed;
        // The face lies on its side: down in the image is lateral in the face.
        fitted[30][1] += 5.0;
        let d = differences(&fitted, &placed);
        assert!((d[30][0] - 0.1).abs() < 1e-6 && d[30][1].abs() < 1e-6);
        assert!(mean_percent(&without(&d, &d)) < 1e-6);
    }
}
