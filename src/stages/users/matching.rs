//! Matches the heads of this frame to the users by their predicted positions.
//!
//! Each user's position is predicted at constant velocity, with a gate that grows while they are unseen. Greedy nearest neighbour:
//! the nearest pair of user and head within the gate is matched first. For at most four users and six heads at 30 Hz this differs
//! from the optimal assignment only where positions cannot distinguish two people.
//!
//! Sensor frame, metres, seconds. Memory: none. Cost: users × heads distances, as many rounds as users. Degenerate: without
//! users or heads nothing is matched. Limitation: two people who cross within 10 cm of depth while hidden may be swapped.

use crate::base::capacity::{HEADS, USERS};
use crate::base::geometry::{Point, Vector};
use crate::base::time::Timestamp;

/// Gate in consecutive frames: largest deviation of a head from its prediction, metres.
const REACH_M: f32 = 0.14;
/// Growth of the gate while a user is unseen, metres per second: a quick step aside.
const REACH_GROWTH: f32 = 0.5;
/// Largest gate, metres: less than between two people side by side.
const REACH_MAX_M: f32 = 0.36;
/// Longest extrapolation of a speed, seconds.
const COAST_S: f64 = 1.0;
/// Averaging time of the speed, seconds.
const SPEED_S: f32 = 0.25;
/// Largest speed, metres per second: faster motion is a measurement error.
const SPEED_MAX: f32 = 2.0;

/// Last position and velocity of a user, sensor frame.
#[derive(Clone, Copy, Debug)]
pub struct LastSeen {
    /// Centre of the head's cloud, metres.
    centre: Point,
    /// Origin of the head frame, metres: unlike the cloud's centre, it moves only with the head.
    origin: Vector,
    /// Velocity, metres per second.
    speed: Vector,
    at: Timestamp,
}

impl LastSeen {
    /// First observation: centre of the cloud and origin of the head, sensor frame, metres.
    pub fn new(centre: Point, origin: Vector, at: Timestamp) -> Self {
        Self {
            centre,
            origin,
            speed: Vector::zeros(),
            at,
        }
    }

    /// Adds an observation, as [`Self::new`].
    pub fn update(&mut self, centre: Point, origin: Vector, at: Timestamp) {
        let dt = at.seconds_since(self.at) as f32;
        if dt > 0.0 && dt < 1.0 {
            let speed = ((origin - self.origin) / dt).cap_magnitude(SPEED_MAX);
            self.speed += (speed - self.speed) * (dt / (dt + SPEED_S));
        } else {
            self.speed = Vector::zeros();
        }
        (self.centre, self.origin, self.at) = (centre, origin, at);
    }

    /// Predicted centre of the cloud and radius of the gate, metres.
    pub fn expected(&self, at: Timestamp) -> (Point, f32) {
        let gap = at.seconds_since(self.at).max(0.0);
        let reach = (REACH_M + REACH_GROWTH * gap as f32).min(REACH_MAX_M);
        (self.centre + self.speed * gap.min(COAST_S) as f32, reach)
    }

    /// Last centre of the cloud, sensor frame, metres.
    pub fn centre(&self) -> Point {
        self.centre
    }
}

/// Index in `heads` (centres, metres) for each user, or `None`. `users`: by slot, predicted position and gate radius; `None` for free
/// slots.
pub fn assign(users: &[Option<(Point, f32)>; USERS], heads: &[Point]) -> [Option<usize>; USERS] {
    let mut found = [None; USERS];
    let mut taken = [false; HEADS];
    for _ in 0..USERS {
        let mut best: Option<(f32, usize, usize)> = None;
        for (slot, user) in users.iter().enumerate() {
            let Some((expected, reach)) = user.filter(|_| found[slot].is_none()) else {
                continue;
            };
            for (head, centre) in heads.iter().enumerate().take(HEADS) {
                let apart = (centre - expected).norm();
                if !taken[head] && apart <= reach && best.is_none_or(|(least, ..)| apart < least) {
                    best = Some((apart, slot, head));
                }
            }
        }
        let Some((_, slot, head)) = best else { break };
        found[slot] = Some(head);
        taken[head] = true;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time_ms(ms: u64) -> Timestamp {
        Timestamp::from_us(ms * 1000)
    }

    #[test]
    fn people_who_cross_keep_their_heads() {
        // Two walk towards each other at 0.4 m/s, 0.3 m apart in depth, seen every 33 ms but not while they overlap.
        let truth = |k: u64| {
            let x = 0.4 * (k as f32 / 30.0 - 1.0);
            [Point::new(x, 0.0, 0.9), Point::new(-x, 0.0, 1.2)]
        };
        let mut places = truth(0).map(|p| LastSeen::new(p, p.coords, time_ms(0)));
        for k in 1..60 {
            let now = time_ms(k * 1000 / 30);
            let people = truth(k);
            let hidden = (people[0].x - people[1].x).abs() < 0.12;
            let mut users = [None; USERS];
            for (user, place) in users.iter_mut().zip(&places) {
                *user = Some(place.expected(now));
            }
            // The second comes first in the image.
            let heads = if hidden {
                vec![people[0]]
            } else {
                vec![people[1], people[0]]
            };
            let found = assign(&users, &heads);
            let expected = if hidden {
                [Some(0), None]
            } else {
                [Some(1), Some(0)]
            };
            assert_eq!(found[..2], expected, "frame {k}");
            for (place, head) in places.iter_mut().zip(found) {
                if let Some(head) = head {
                    place.update(heads[head], heads[head].coords, now);
                }
            }
        }
    }

    #[test]
    fn a_head_outside_the_gate_is_not_matched() {
        let place = LastSeen::new(Point::new(0.0, 0.0, 0.8), Vector::zeros(), time_ms(0));
        let user = Some(place.expected(time_ms(33)));
        let far = [Point::new(0.3, 0.0, 0.8)];
        assert_eq!(assign(&[user, None, None, None], &far)[0], None);
        let near = [Point::new(0.1, 0.0, 0.8)];
        assert_eq!(assign(&[user, None, None, None], &near)[0], Some(0));
        // After half a second the same step is believed.
        let later = Some(place.expected(time_ms(500)));
        assert_eq!(assign(&[later, None, None, None], &far)[0], Some(0));
    }

    #[test]
    fn predicts_at_constant_velocity_within_a_growing_gate() {
        let point = |x: f32| Point::new(x, 0.0, 0.8);
        let mut place = LastSeen::new(point(0.0), Vector::zeros(), time_ms(0));
        // 0.1 m in 0.25 s is 0.4 m/s, of which half is believed at first: 0.25/(0.25 + 0.25).
        place.update(point(0.1), Vector::x() * 0.1, time_ms(250));
        for (ms, x, reach) in [
            (250, 0.1, 0.14),
            (450, 0.14, 0.24),
            (650, 0.18, 0.34),
            (1250, 0.3, 0.36),
            (3250, 0.3, 0.36),
        ] {
            let (centre, within) = place.expected(time_ms(ms));
            assert!(
                (centre.x - x).abs() < 1e-5 && (within - reach).abs() < 1e-5,
                "{ms}"
            );
        }
        // A jump counts as two metres a second, a second away as standing still.
        place.update(point(3.0), Vector::x() * 3.0, time_ms(500));
        assert!((place.expected(time_ms(600)).0.x - 3.11).abs() < 1e-4);
        place.update(point(3.1), Vector::x() * 3.1, time_ms(1500));
        assert!((place.expected(time_ms(1600)).0.x - 3.1).abs() < 1e-6);
        assert_eq!(place.centre(), point(3.1));
    }

    #[test]
    fn the_nearest_pair_comes_first_and_nobody_has_two_heads() {
        let point = |x: f32| Point::new(x, 0.0, 0.8);
        let users = [Some((point(0.0), 0.2)), Some((point(0.1), 0.2)), None, None];
        // The first is 0.04 off the head that is exactly where the second is expected.
        assert_eq!(assign(&users, &[point(0.1)]), [None, Some(0), None, None]);
        let both = [point(0.1), point(0.14)];
        assert_eq!(assign(&users, &both), [Some(1), Some(0), None, None]);
        // At the end of the reach is within it.
        let users = [Some((Point::origin(), 0.25)), None, None, None];
        assert_eq!(assign(&users, &[Point::new(0.25, 0.0, 0.0)])[0], Some(0));
        assert_eq!(assign(&users, &[])[0], None);
    }

    #[test]
    fn two_observations_at_one_time_give_no_speed() {
        let mut place = LastSeen::new(Point::new(0.0, 0.0, 0.8), Vector::zeros(), time_ms(0));
        place.update(
            Point::new(0.02, 0.0, 0.8),
            Vector::new(0.02, 0.0, 0.0),
            time_ms(0),
        );
        let (expected, reach) = place.expected(time_ms(33));
        assert_eq!(expected, Point::new(0.02, 0.0, 0.8));
        assert!(reach.is_finite());
    }
}
