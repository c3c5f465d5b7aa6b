//! Recordings in the layout of fakenect: read and write.
