"""Typed configuration of one gateway: one TOML file in, one frozen value out, clear messages when it is invalid."""
