//! A room behind the person: a wall with pictures, a shelf, a cupboard, a window.

use super::material::{Material, share};
use super::outfit::{Outfit, Surface};
use mien_stages::base::geometry::Point;

impl Outfit {
    /// Adds a board facing the sensor: left, top, right, bottom, distance, metres.
    fn board(&mut self, [left, top, right, bottom, z]: [f32; 5], surface: &Surface) {
        self.grid([9, 9], false, surface.material, |row, column| {
            let (u, v) = (column as f32 / 8.0, row as f32 / 8.0);
            let p = Point::new(left + u * (right - left), top + v * (bottom - top), z);
            surface.vertex(p, [u * (right - left), v * (bottom - top)], 1.0)
        });
    }

    fn pictures(&mut self, chance: impl Fn(u64) -> f32, wall_m: f32) {
        for k in 0..3u64 {
            let at = |channel| chance(10 + 5 * k + channel);
            let (x, y) = (-1.0 + 0.8 * k as f32 + 0.4 * at(0), -0.7 + 0.6 * at(1));
            let (w, h) = (0.2 + 0.3 * at(2), 0.2 + 0.3 * at(3));
            let mut paper = Surface::new(Material::Matt, [215.0, 213.0, 205.0], 0.0);
            self.board([x, y, x + w, y + h, wall_m - 0.015], &paper);
            let hue = [(95.0, 4), (90.0, 0), (85.0, 1)];
            paper.colour = hue.map(|(least, k)| least + 60.0 * at(k) + 40.0 * at(2));
            paper.cells = [14.0, 14.0];
            let (right, bottom) = (x + w - 0.03, y + h - 0.03);
            self.board([x + 0.03, y + 0.03, right, bottom, wall_m - 0.02], &paper);
        }
    }

    /// Adds a shelf with books.
    fn shelf(&mut self, chance: impl Fn(u64) -> f32, level: u64, [left, right]: [f32; 2], z: f32) {
        let foot = -0.75 + 0.42 * level as f32 + 0.32;
        let wood = Surface::new(Material::Matt, [92.0, 70.0, 50.0], 0.0);
        let below = -0.75 + 0.42 * level as f32 + 0.35;
        self.board([left, foot, right, below, z], &wood);
        let mut x = left;
        let mut k = 0;
        while x < right - 0.08 {
            let at = |channel| chance(1000 + 200 * level + 4 * k + channel);
            let wide = 0.02 + 0.05 * at(0);
            if at(1) > 0.25 {
                let back = [(45.0, 70.0, 2), (42.0, 55.0, 3), (38.0, 55.0, 1)];
                let colour = back.map(|(least, range, k)| least + range * at(k) + 60.0 * at(0));
                let material = match at(2) < 0.3 {
                    true => Material::Dark,
                    false => Material::Matt,
                };
                let top = foot - (0.17 + 0.11 * at(3));
                let book = Surface::new(material, colour, 0.0);
                self.board([x, top, x + wide, foot, z + 0.04], &book);
            }
            x += wide;
            k += 1;
        }
    }
}

/// The room, in the frame of a level sensor.
pub(crate) fn room(seed: u64) -> Outfit {
    let mut room = Outfit::default();
    let chance = |k| share(seed ^ 0x400a, k);
    let wall_m = 1.9 + 0.9 * chance(0);
    let paint = [
        [168.0, 164.0, 154.0],
        [142.0, 152.0, 160.0],
        [176.0, 170.0, 140.0],
        [128.0, 130.0, 134.0],
    ][(chance(1) * 4.0) as usize % 4];
    let mut wall = Surface::new(Material::Matt, paint, 0.0);
    wall.cells = [9.0, 9.0];
    room.board([-3.2, -2.6, 3.2, 0.75, wall_m], &wall);
    // Floorboards or a skirting: darker below.
    wall.colour = paint.map(|c| 0.45 * c);
    room.board([-3.2, 0.75, 3.2, 2.6, wall_m], &wall);
    room.pictures(chance, wall_m);
    // Shelves at one side.
    let is_right = chance(2) < 0.5;
    let sides = if is_right {
        [-1.35, -0.42]
    } else {
        [0.42, 1.35]
    };
    for level in 0..3 {
        room.shelf(chance, level, sides, wall_m - 0.3);
    }
    room
}
