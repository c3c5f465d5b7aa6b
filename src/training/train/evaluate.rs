//! Errors of fitted landmarks against annotated ones: percent of the outer eye distance, by region.

use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::scheme;

/// Differences of all points ([`differences`]).
pub type Differences = [[f32; 2]; LANDMARKS];

/// Mean length of some differences, percent.
pub fn mean_percent(some: &[[f32; 2]]) -> f32 {
    100.0 * some.iter().map(|d| d[0].hypot(d[1])).sum::<f32>() / some.len() as f32
}

/// Errors over many faces.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    /// Mean distance per face over all 68, per cent.
    pub faces: Vec<f32>,
    /// Mean distance per face over the inner 51, per cent.
    pub inner: Vec<f32>,
    /// Sum of distances per landmark, per cent.
    sums: Vec<f64>,
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

impl Errors {
    /// Adds one face's differences ([`differences`]).
    pub fn add(&mut self, differences: &Differences) {
        self.sums.resize(LANDMARKS, 0.0);
        for (sum, d) in self.sums.iter_mut().zip(differences) {
            *sum += f64::from(mean_percent(&[*d]));
        }
        self.faces.push(mean_percent(differences));
        self.inner.push(mean_percent(&differences[scheme::INNER]));
    }

    /// Mean over the inner 51.
    pub fn mean_inner(&self) -> f32 {
        self.inner.iter().sum::<f32>() / self.inner.len().max(1) as f32
    }

    /// One line: mean, median, 95th percentile, inner 51, regions, share over 10 %.
    pub fn line(&self) -> String {
        use std::fmt::Write;
        if self.faces.is_empty() {
            return "no annotated faces".into();
        }
        let count = self.faces.len() as f32;
        let mut sorted = self.faces.clone();
        sorted.sort_by(f32::total_cmp);
        let at = |share: f32| sorted[((sorted.len() - 1) as f32 * share).round() as usize];
        let mut line = format!(
            "{} faces: mean {:.2} %, median {:.2}, p95 {:.2}, inner 51 {:.2}; over 10 %: {:.1} %;",
            self.faces.len(),
            self.faces.iter().sum::<f32>() / count,
            at(0.5),
            at(0.95),
            self.mean_inner(),
            100.0 * self.faces.iter().filter(|e| **e > 10.0).count() as f32 / count,
        );
        for (name, range) in scheme::REGIONS {
            let size = range.len() as f64 * f64::from(count);
            let mean = self.sums[range].iter().sum::<f64>() / size;
            let _ = write!(line, " {name} {mean:.2}");
        }
        line
    }
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
        let mut errors = Errors::default();
        errors.add(&without(&d, &d));
        assert!(errors.faces[0] < 1e-6);
    }
}
