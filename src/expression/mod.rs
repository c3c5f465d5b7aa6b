//! Landmarks to measures, samples, ranges and unit weights (paper section 2).
