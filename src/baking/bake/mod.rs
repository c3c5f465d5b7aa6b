//! Baking: a neutral head and 68 vertex numbers become blendshapes, paper section 4.
//!
//! ```text
//! OBJ ─► mesh ─► head: axes, lids, lips, parts ─┐
//!           └──► laplacian (10)(11) ────────────┼─► rig: influence (12)(13), solve (Procedure 1), contacts ─► GLB, OBJ, report
//! recipe or table of controls ──────────────────┘
//! ```
//!
//! ```text
//! command               the command and its files
//! obj, glb, patch, weld heads as read: OBJ, glTF (also VRM: vrm), vertices that glTF splits welded
//! winding               inward faces turned outwards
//! order                 the canonical form in which heads are solved
//! mesh, laplacian       positions and faces; the operator on them
//! names, locate         the 68 points; found in renderings if not given, brows and jaw by_shape
//! prior, canonical      how skin moves in addition to the solve; mapped onto a head
//! learn                 learning that prior from sculpted shapes
//! head                  axes, ten derived points on cheeks and forehead, lids and lips (seam), eyeball, mouth, parts
//! lips, crease          joined lips cut open
//! recipe, table         targets: displacements of points
//! jaw                   its axis, and its share of the skin's motion
//! influence             area of influence of a point
//! solve, sparse         the deformation, and its linear systems
//! skin                  points and skin of one shape, and contacts: lids on eyeballs, lips on lips
//! surroundings          inverted triangles and torn edges
//! rig, shape            all shapes, as requested and as solved; printed: by the reference methods
//! targets, morphs       shapes added to the head's own glTF, or to a new one; looks: the colours of an OBJ
//! verdict               checks of shapes, calibrated on artists' shapes
//! render, report        figures and renderings of shapes
//! ```
//!
//! Distances in recipes and settings are in units of the face (inner-eye-corner distance), so that one recipe fits any
//! head; everything inside is in the mesh's own unit and axes, and becomes metres in the GLB.

mod by_shape;
mod canonical;
pub mod command;
mod crease;
pub mod eyeball;
pub mod files;
pub mod glb;
pub mod head;
pub mod influence;
mod jaw;
pub mod laplacian;
pub mod learn;
mod lips;
pub mod locate;
pub mod looks;
pub mod mesh;
pub mod morphs;
mod mouth;
pub mod names;
pub mod neck;
pub mod obj;
pub mod order;
mod parts;
pub mod patch;
mod printed;
pub mod prior;
pub mod recipe;
pub mod render;
pub mod report;
pub mod rig;
pub mod scene;
pub mod seam;
pub mod shape;
mod skin;
pub mod solve;
pub mod source;
pub mod sparse;
mod surroundings;
pub mod table;
mod targets;
pub mod verdict;
mod visemes;
mod vrm;
mod weld;
mod winding;
