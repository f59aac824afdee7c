"""Reads the sections `[grid]` and `[talc]` for a recording, from a gateway's configuration or a separate file."""

from pathlib import Path

from drivers.section import Section
from gateway.config.problems import read_sections
from gateway.config.reading import read_data
from gateway.config.sections import Grid, Talc
from talc.settings import TalcSettings


class TalcOnly(Section):
    """`[grid]` and `[talc]`."""

    grid: Grid = Grid()
    talc: Talc = TalcSettings()


def load_talc_only(path: Path) -> TalcOnly:
    """The sections `[grid]` and `[talc]` of a file, as strict as `load`; others are ignored. Raises ConfigError."""
    data = read_data(path)
    return read_sections(TalcOnly, {name: data[name] for name in ("grid", "talc") if name in data}, path)
