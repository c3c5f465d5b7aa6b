//! Geometry of both cameras: raw depth to metres, points to colour pixels.
