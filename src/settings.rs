//! The configuration file: TOML to the settings of each stage, every key checked.
