"""The two sections that a recording needs: of a gateway's configuration, or of a file that holds nothing else."""

import tomllib
from pathlib import Path

from pydantic import ValidationError

from gateway.config.fields import Section
from gateway.config.problems import ConfigError, Problem, problems_of
from gateway.config.sections import Grid
from talc.settings import TalcSettings


class TalcOnly(Section):
    """`[grid]` and `[talc]`."""

    grid: Grid = Grid()
    talc: TalcSettings = TalcSettings()


def load_talc_only(path: Path) -> TalcOnly:
    """The sections `[grid]` and `[talc]` of a file; its other sections are passed over. Raises ConfigError."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(path, [Problem("", f"is not valid TOML: {error}")]) from None
    own: dict[str, object] = {name: data[name] for name in ("grid", "talc") if name in data}
    try:
        return TalcOnly.model_validate(own)
    except ValidationError as error:
        raise ConfigError(path, problems_of(error, own, TalcOnly)) from None
