//! Baking: a neutral head and 68 vertex numbers become blendshapes, paper section 4.
//!
//! ```text
//! OBJ ─► mesh ─► head: axes, lids, lips, parts ─┐
//!           └──► laplacian (10)(11) ────────────┼─► rig: influence (12)(13), solve (Procedure 1), contacts ─► GLB, OBJ, report
//! recipe or table of controls ──────────────────┘
//! ```
//!
//! ```text
//! command               what is asked for, and the order of it; files
//! obj, glb, patch, weld heads as they come: OBJ, glTF (also VRM: vrm), sewn together from what glTF splits
//! winding               faces that look inwards, turned outwards
//! order                 the one form that all of them are solved in
//! mesh, laplacian       positions and faces; the operator on them
//! names, locate         the 68 points; found where nobody gives them, brows and jaw by_shape
//! prior, canonical      how skin moves beyond the solve; laid onto a head
//! learn                 learned from sculpted shapes
//! head                  axes, ten points more on cheeks and forehead, lids and lips (seam), eyeball, mouth, parts
//! lips, crease          joined ones cut open
//! recipe, table         targets: which point goes where
//! jaw                   its axis, and how the skin takes part in its motion
//! influence             how far a point acts
//! solve, sparse         the deformation, and its linear systems
//! skin                  one shape's points, its skin, and contacts: lids on eyeballs, lips on lips
//! surroundings          inverted triangles and torn edges
//! rig, shape            all shapes, each as it is asked for and as it is left; printed: by the methods of comparison
//! targets, morphs       added to the glTF that a head came in; a new one with them; looks: the colours of an OBJ
//! verdict               what is wrong with a shape, by measures that artists' shapes pass
//! render, report        figures and pictures of what was baked
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
