//! Bayer mosaic to RGB and to luma.
