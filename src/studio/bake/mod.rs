//! Baking: a neutral head and 68 vertex numbers become blendshapes, paper section 4.
//!
//! ```text
//! OBJ ─► mesh ─► laplacian ─► influence (12) ─► solve: Procedure 1 ─► blendshapes ─► GLB, OBJ folder, report
//! ```

pub mod benchmark;
pub mod command;
pub mod eyeball;
pub mod glb;
pub mod head;
pub mod influence;
pub mod laplacian;
pub mod measure;
pub mod mesh;
pub mod names;
pub mod obj;
pub mod prior;
pub mod recipe;
pub mod render;
pub mod report;
pub mod rig;
pub mod solve;
pub mod sparse;
