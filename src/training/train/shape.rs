//! The 3D shape model: a population of faces, aligned in rigid motion and size, and its principal components.
//!
//! Faces are the 68 landmark vertices of the ICT head under random identity, expression and smooth warps (beyond its
//! 40 identity modes), each with its mirror image. Brows also move as curves (raised, tilted, bent), since the head
//! set has few expressions of them. The residuals of annotated portraits ([`left_over`]) are added, so that people's
//! own brows, lids and lips can be followed, and the annotators' habits too. Alignment: similarity on the
//! [`scheme::STABLE`] points (Umeyama 1991). Metres, head frame. Seeded. Limits: expressions add linearly; no
//! correction for combinations.

use nalgebra::DMatrix;

use mien_baking::heads::ict::{Delta, IctHead};
use mien_simulator::virtual_head::{Points, Site};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::{Point, Vector};
use mien_stages::face_model::{ShapeModel, scheme};
use mien_stages::landmarks::cascade::FaceFit;
use mien_workbench::similarity::Similarity;
use mien_workbench::strongest::strongest;

/// One face in this many has the shape of another age.
const RESHAPED: usize = 5;

/// 68 points of one face.
pub type Face = [Point; LANDMARKS];

/// A number about N(0, 1).
pub fn normal(random: &mut fastrand::Rng) -> f32 {
    let u = random.f32().max(1e-7);
    (-2.0 * u.ln()).sqrt() * (std::f32::consts::TAU * random.f32()).cos()
}

/// The mirror image of a face.
pub fn mirrored(face: &Face) -> Face {
    std::array::from_fn(|i| {
        let p = face[scheme::MIRROR[i]];
        Point::new(-p.x, p.y, p.z)
    })
}

/// Random weights of the head set's expressions: several at once, symmetric but for an eighth, often a strong one.
fn expression_weights(ict: &IctHead, random: &mut fastrand::Rng) -> Vec<f32> {
    let mut weights = vec![0.0; ict.expressions.len()];
    if random.f32() < 0.2 {
        return weights;
    }
    let count = 1 + random.usize(..5);
    for _ in 0..count {
        let k = random.usize(..weights.len());
        let strength = random.f32().sqrt() * 1.1;
        let name = &ict.expressions[k].name;
        let stem = name.trim_end_matches("_L").trim_end_matches("_R");
        let both = random.f32() < 0.75;
        for (other, weight) in ict.expressions.iter().zip(&mut weights) {
            let same = other.name == *name;
            let sibling = both && other.name.trim_end_matches("_L").trim_end_matches("_R") == stem;
            if same || sibling {
                *weight = strength * (1.0 + 0.12 * normal(random));
            }
        }
    }
    if random.f32() < 0.3 {
        // Both lids, or one.
        let blink = random.f32().sqrt() * 1.05;
        let stem = ["eyeBlink", "eyeBlink", "eyeBlink_L", "eyeBlink_R"][random.usize(..4)];
        for (other, weight) in ict.expressions.iter().zip(&mut weights) {
            if other.name.starts_with("eyeBlink") {
                let shuts = other.name.starts_with(stem);
                *weight = if shuts { blink } else { 0.0 };
            }
        }
    }
    if random.f32() < 0.2
        && let Some(k) = ict.expression("jawOpen")
    {
        weights[k] = random.f32() * 1.05;
    }
    // Both open and close the lips over the jaw: mouthClose alone would cross the lips.
    if let (Some(jaw), Some(close)) = (ict.expression("jawOpen"), ict.expression("mouthClose")) {
        weights[close] = weights[close].min(weights[jaw] * 0.95);
    }
    weights
}

/// Raises, tilts and bends a brow given by its landmarks, outer to inner.
fn move_brow(face: &mut Face, brow: [usize; 5], random: &mut fastrand::Rng, both: [f32; 3]) {
    let varied = [0.0012, 0.0010, 0.0008].map(|size| size * normal(random));
    let own = [0, 1, 2].map(|k| both[k] + varied[k]);
    for (k, i) in brow.into_iter().enumerate() {
        let t = k as f32 / 2.0 - 1.0;
        face[i].y -= own[0] + own[1] * t + own[2] * (0.5 - t * t);
    }
}

/// The second-order terms of a point.
pub(super) fn quadratic(p: &Vector) -> [f32; 6] {
    let (squares, turned) = (p.component_mul(p), p.component_mul(&p.yzx()));
    [
        squares.x, squares.y, squares.z, turned.x, turned.y, turned.z,
    ]
}

/// Stretches a face and bends it smoothly.
fn warp(face: &mut Face, random: &mut fastrand::Rng) {
    let stretch = Vector::from_fn(|_, _| 1.0 + 0.035 * normal(random));
    // Smooth quadratic warp: coefficients for displacements of about half a millimetre at 5 cm.
    let bend: Vec<f32> = (0..18).map(|_| 0.0006 * normal(random)).collect();
    for p in face {
        let u = Vector::new(p.x, p.y - 0.03, p.z) / 0.05;
        let terms = quadratic(&u);
        for axis in 0..3 {
            p[axis] *= stretch[axis];
            for (k, term) in terms.iter().enumerate() {
                p[axis] += bend[axis * 6 + k] * term * 0.5;
            }
        }
    }
}

/// A random population with its mirror images: `2 * count` faces; landmarks are at `sites` of the mesh, and one face in
/// [`RESHAPED`] has one of the `shapes`.
pub fn population(
    ict: &IctHead,
    sites: &[Site],
    shapes: &[Delta],
    count: usize,
    seed: u64,
) -> Vec<Face> {
    let mut random = fastrand::Rng::with_seed(seed);
    let mut faces = Vec::with_capacity(2 * count);
    for number in 0..count {
        let shape = shapes.get((number / RESHAPED) % shapes.len().max(1));
        let shape = shape.filter(|_| number % RESHAPED == 0);
        let identity = (0..ict.identities.len()).map(|_| normal(&mut random).clamp(-2.5, 2.5));
        let identity: Vec<f32> = identity.collect();
        let weights = expression_weights(ict, &mut random);
        let vertex = |v: u32| {
            let v = v as usize;
            let mut p = ict.neutral[v].coords;
            for (delta, c) in ict.identities.iter().zip(&identity) {
                p += delta.offsets[v] * *c;
            }
            for (delta, w) in ict.expressions.iter().zip(&weights) {
                p += delta.offsets[v] * *w;
            }
            if let Some(shape) = shape {
                p += shape.offsets[v];
            }
            p
        };
        let mut face: Face = std::array::from_fn(|i| Point::from(sites[i].mix(vertex)));
        warp(&mut face, &mut random);
        let lively = random.f32() < 0.5;
        let mut both = [0.0; 3];
        if lively {
            both = [0.0045, 0.0020, 0.0012].map(|size| size * normal(&mut random));
        }
        move_brow(&mut face, [17, 18, 19, 20, 21], &mut random, both);
        move_brow(&mut face, [26, 25, 24, 23, 22], &mut random, both);
        faces.push(face);
        faces.push(mirrored(&face));
    }
    faces
}

/// Residual of the model on annotated points, in the head frame: picture axes rotated by the view, without depth.
pub fn left_over(shape: &ShapeModel, fit: &FaceFit, points: &Points) -> [Vector; LANDMARKS] {
    let mut head = [Point::origin(); LANDMARKS];
    shape.shape(&fit.shape, &mut head);
    let scale = fit.view.log_scale.exp();
    std::array::from_fn(|i| {
        let [x, y] = fit.view.project(&head[i]);
        let off = Vector::new(points[i][0] - x, points[i][1] - y, 0.0) / scale;
        // Jaw annotation hardly repeats, and part of the others' residual is jitter. Portraits of other people are
        // fitted worse with 0.6, rendered faces with 0.9.
        let share = if scheme::JAW.contains(&i) { 0.3 } else { 0.75 };
        fit.view.rotation.inverse() * off * share
    })
}

/// The face transformed by a similarity so that its stable points best match those of `target`.
pub fn aligned(face: &Face, target: &Face) -> Face {
    let similarity = Similarity::between(face, target);
    face.map(|p| similarity.applied(&p))
}

/// Weight of a point's motion in the choice of modes: lids and lips move by a millimetre and matter more than the
/// jaw's centimetre. Without it 40 modes leave 0.69 of a single upper lid's motion.
fn emphasis(landmark: usize) -> f64 {
    match landmark {
        37 | 38 | 40 | 41 | 43 | 44 | 46 | 47 => 3.0,
        48..68 => 2.0,
        17..27 => 1.5,
        0..17 => 0.6,
        _ => 1.0,
    }
}

/// Mean and principal components of an aligned population; origin between the mean's inner eye corners.
pub fn principal_components(faces: &[Face], reference: &Face, modes: usize) -> ShapeModel {
    let mut mean = *reference;
    let mut fitted: Vec<Face> = Vec::new();
    for _ in 0..3 {
        fitted = faces.iter().map(|face| aligned(face, &mean)).collect();
        let sum = |i: usize| fitted.iter().map(|face| face[i].coords).sum::<Vector>();
        let next = std::array::from_fn(|i| Point::from(sum(i) / fitted.len() as f32));
        mean = aligned(&next, reference);
    }
    let dimensions = 3 * LANDMARKS;
    let rows = DMatrix::<f64>::from_fn(fitted.len(), dimensions, |row, k| {
        f64::from(fitted[row][k / 3][k % 3] - mean[k / 3][k % 3])
    });
    let covariance = rows.transpose() * &rows / fitted.len() as f64;
    // The modes span the largest weighted variance; within that space they are the principal axes of the unweighted
    // motion.
    let weight = |k: usize| emphasis(k / 3);
    let weighed = DMatrix::from_fn(dimensions, dimensions, |a, b| {
        covariance[(a, b)] * weight(a) * weight(b)
    });
    let axes = strongest(weighed, modes).1;
    let space = DMatrix::from_fn(dimensions, modes, |k, mode| axes[(k, mode)] / weight(k));
    let space = space.qr().q();
    let within = space.transpose() * covariance * &space;
    let (variances, turned) = strongest(within, modes);
    let axes = space * turned;
    let origin = nalgebra::center(&mean[39], &mean[42]).coords;
    let deviations = variances.iter().map(|v| v.max(1e-12).sqrt() as f32);
    let modes = axes.column_iter();
    let modes = modes.map(|column| std::array::from_fn(|k| column[k] as f32));
    ShapeModel {
        mean: mean.iter().map(|p| p - origin).collect(),
        deviations: deviations.collect(),
        modes: modes.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::base::geometry::rotation_from_yaw_pitch_roll;

    fn face(seed: u64) -> Face {
        let mut random = fastrand::Rng::with_seed(seed);
        std::array::from_fn(|_| {
            Point::new(
                0.05 * normal(&mut random),
                0.05 * normal(&mut random),
                0.03 * normal(&mut random),
            )
        })
    }

    #[test]
    fn alignment_undoes_a_planted_motion() {
        let a = face(1);
        let rotation = rotation_from_yaw_pitch_roll(0.4, 0.3, -0.2);
        let b = a.map(|p| rotation * p * 1.3 + Vector::new(0.1, 0.2, 0.3));
        for (p, q) in aligned(&b, &a).iter().zip(&a) {
            assert!((p - q).norm() < 1e-5);
        }
    }

    #[test]
    fn components_find_the_planted_mode() {
        let base = face(2);
        let mut random = fastrand::Rng::with_seed(5);
        let faces: Vec<Face> = (0..200)
            .map(|_| {
                let mut f = base;
                let b = 0.004 * normal(&mut random);
                f[48].x += b;
                f[54].x -= b;
                f
            })
            .collect();
        let model = principal_components(&faces, &base, 2);
        assert!((model.modes[0][3 * 48].abs() - std::f32::consts::FRAC_1_SQRT_2).abs() < 1e-2);
        assert!(model.deviations[1] < 0.01 * model.deviations[0]);
    }
}
