//! The face model: standard head, shape modes, appearance; one file, read at start-up.
