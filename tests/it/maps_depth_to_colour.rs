//! Promise: a depth pixel is found in the colour picture where the Kinect's own drivers find it, and at their distance.

use mien_sensors::kinect::registration::Registration;
use mien_stages::base::capacity::{HEIGHT, WIDTH};

use crate::common::drivers_table::{DriversTable, depth_mm};

#[test]
fn every_entry_of_the_table_is_the_drivers() {
    let table = DriversTable::new(&Registration::default());
    for (col, row, x, y) in [
        (0, 0, 6422, 26),
        (639, 0, 160_281, 25),
        (0, 479, 6788, 475),
        (639, 479, 159_662, 476),
        (320, 240, 83_099, 253),
        (100, 50, 30_987, 76),
        (500, 400, 125_591, 400),
    ] {
        let pixel = row * WIDTH + col;
        assert_eq!(
            (table.x[pixel], table.y[pixel]),
            (x, y),
            "pixel ({col}, {row})"
        );
    }
    let hash = table
        .x
        .iter()
        .zip(table.y.iter())
        .flat_map(|(&x, &y)| [u64::from(x), u64::from(y as u32)])
        .fold(1_469_598_103_934_665_603u64, |h, word| {
            (h ^ word).wrapping_mul(1_099_511_628_211)
        });
    assert_eq!(hash, 0x27b9_268f_4482_7983);
    for (z_mm, shift) in [
        (500, -4031),
        (600, -2852),
        (800, -1378),
        (1000, -493),
        (1200, 96),
        (2000, 1275),
        (4000, 2159),
    ] {
        assert_eq!(table.shift[z_mm], shift, "shift at {z_mm} mm");
    }
}

#[test]
fn the_smooth_form_is_the_table_within_truncation() {
    let registration = Registration::default();
    let (camera, table) = (registration.camera(), DriversTable::new(&registration));
    let mut worst = [0.0f64; 2];
    for row in (0..HEIGHT).step_by(3) {
        for col in (0..WIDTH).step_by(3) {
            let pixel = row * WIDTH + col;
            for z_mm in [500u16, 800, 1700, 4000] {
                if table.x[pixel] == 1280 * 256 {
                    continue;
                }
                let p = camera.point(col as f32, row as f32, f32::from(z_mm) * 1e-3);
                let [x, y] = camera.colour_pixel(&p).map(f64::from);
                let table_x =
                    f64::from(table.x[pixel] as i32 + table.shift[usize::from(z_mm)]) / 256.0;
                worst[0] = worst[0].max((x - table_x).abs());
                // The table's rows are truncated: half a pixel lower on average, never more than one.
                worst[1] = worst[1].max((y - 0.5 - f64::from(table.y[pixel])).abs());
            }
        }
    }
    println!("worst column and row difference, px: {worst:?}");
    assert!(worst[0] < 0.02, "columns differ by {} px", worst[0]);
    assert!(worst[1] < 0.52, "rows differ by {} px", worst[1]);
}

#[test]
fn the_smooth_distance_is_the_drivers_within_truncation() {
    let registration = Registration::default();
    let camera = registration.camera();
    for raw in 0..u16::MAX {
        let (mm, exact) = (depth_mm(&registration, raw), 1e3 * camera.depth_m(raw));
        // They cap what lies too far; to us it is no measurement.
        let expected = if mm == 10_000 { 0.0 } else { f32::from(mm) };
        let within = expected - 0.002..expected + 1.002;
        assert!(within.contains(&exact), "raw {raw}: {exact} mm for {mm}");
    }
    assert_eq!(depth_mm(&registration, 1080), 10_000);
}
