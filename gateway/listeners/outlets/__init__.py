"""Outlets: what gateways publish over Zenoh is forwarded to other systems of the plant, by a separate process.

A new kind is one file: in another package, with its settings and its outlet (docs/own-profile.md).
"""
