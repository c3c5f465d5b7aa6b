//! The appliance: sensor to weights on a wire.
fn main() {}
