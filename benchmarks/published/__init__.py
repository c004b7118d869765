"""The papers' printed numbers, one TOML file a paper."""
