//! Weights on a wire: CSV, OSC, serial.
