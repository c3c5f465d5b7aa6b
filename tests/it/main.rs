//! The promises of the programs and of the library, one a module: `cargo test --test it <module>` runs one.
//!
//! One program, because linking each with the crate takes longer than most of them run. What counts the memory of its whole
//! process is in `tests/memory`.

#[path = "../common/mod.rs"]
mod common;

mod bakes_heads_as_they_come;
mod bakes_like_artists;
mod bakes_local_shapes;
mod checks_the_wiring;
mod comes_and_goes;
mod docs_commands;
mod drives_a_kinect;
mod ends_when_nobody_reads;
mod every_unit_moves_the_head;
mod fills_avatar_templates;
mod follows_several_people;
mod follows_the_paper;
mod keeps_functions_short;
mod keeps_its_modules_apart;
mod keeps_the_log_short;
mod learns_a_range;
mod lives_as_a_service;
mod maps_depth_to_colour;
mod opens_joined_lips;
mod outlasts_odd_models;
mod output_bytes;
mod places_points;
mod plays_any_depth_camera;
mod plays_colour_alone;
#[cfg(all(feature = "studio", feature = "wires"))]
mod plays_gestures;
mod plays_what_others_recorded;
mod plays_without_a_sensor;
mod reads_a_weak_side;
mod reads_an_acted_face;
mod reads_still_portraits;
mod records_and_replays;
mod recovers_shape_from_tracks;
mod refuses_bad_input;
mod reloads_cost_no_memory;
mod remembers_people;
mod replays_the_corpus;
mod sees_nobody;
mod shipped_config;
mod shipped_words;
mod shows_a_head;
mod survives_real_life;
mod switches_by_gesture;
mod talks_to_rigs;
mod tells_what_is_covered;
mod tracks_a_head;
mod tracks_when_turned;
