//! A face with round numbers.

use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::Point;

/// A flat toy face with round numbers: eye corners 30 mm apart.
pub(crate) fn toy_face() -> [Point; LANDMARKS] {
    let mut p = [Point::origin(); LANDMARKS];
    let mm = |x: f32, y: f32, z: f32| Point::new(x * 1e-3, y * 1e-3, z * 1e-3);
    for (i, x) in [(7, -10.0), (8, 0.0), (9, 10.0)] {
        p[i] = mm(x, 90.0, 0.0);
    }
    for k in 0..5 {
        p[17 + k] = mm(-55.0 + 10.0 * k as f32, -20.0, 0.0);
        p[22 + k] = mm(15.0 + 10.0 * k as f32, -20.0, 0.0);
    }
    (p[36], p[39], p[42], p[45]) = (
        mm(-45.0, 0.0, 6.0),
        mm(-15.0, 0.0, 0.0),
        mm(15.0, 0.0, 0.0),
        mm(45.0, 0.0, 6.0),
    );
    for (upper, lower, x) in [
        (37, 41, -35.0),
        (38, 40, -25.0),
        (43, 47, 25.0),
        (44, 46, 35.0),
    ] {
        (p[upper], p[lower]) = (mm(x, -5.0, 0.0), mm(x, 5.0, 0.0));
    }
    for (i, x) in [(31, -12.0), (32, -6.0), (33, 0.0), (34, 6.0), (35, 12.0)] {
        p[i] = mm(x, 40.0, -10.0);
    }
    (p[48], p[54]) = (mm(-25.0, 60.0, -5.0), mm(25.0, 60.0, -5.0));
    (p[49], p[53]) = (mm(-16.0, 55.0, -9.0), mm(16.0, 55.0, -9.0));
    for k in 0..3 {
        let x = 8.0 * (k as f32 - 1.0);
        p[50 + k] = mm(x, 55.0, -12.0);
        p[58 - k] = mm(x, 68.0, -10.0);
        p[61 + k] = mm(x, 60.0, -9.0);
        p[67 - k] = mm(x, 60.0, -9.0);
    }
    p
}
