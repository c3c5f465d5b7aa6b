//! The stages in order: the drawing of the library as code.
