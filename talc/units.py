"""Units of recorded errors, and those that the names of columns state."""

import math
import re
from collections.abc import Mapping
from typing import Final

from talc.names import MICROMETRE, MICROMETRE_PER_METRE

COLUMN_UNITS: Final[Mapping[str, tuple[str, float]]] = {
    "nm": (MICROMETRE, 1e-3),
    "um": (MICROMETRE, 1.0),
    "mm": (MICROMETRE, 1e3),
    "m": (MICROMETRE, 1e6),
    "in": (MICROMETRE, 25.4e3),
    "um/m": (MICROMETRE_PER_METRE, 1.0),
    "urad": (MICROMETRE_PER_METRE, 1.0),
    "mrad": (MICROMETRE_PER_METRE, 1e3),
    "rad": (MICROMETRE_PER_METRE, 1e6),
    "deg": (MICROMETRE_PER_METRE, math.pi / 180 * 1e6),
    "arcsec": (MICROMETRE_PER_METRE, math.pi / 180 / 3600 * 1e6),
}
"""Units of a column of errors: the unit used here, and how many of it one of them is."""

_AT_END = tuple(unit for unit in COLUMN_UNITS if unit not in ("m", "in", "um/m"))
"""Units that a name may end with without brackets; `_m` and `_in` mean other things as well."""
_BRACKETED = re.compile(r"[\[(]\s*([a-z/]+)\s*[\])]$")


def plain_unit(unit: str) -> str:
    """A unit as it is spelt here, without a µ of either kind."""
    return unit.replace("µ", "u").replace("μ", "u")


def named_unit(name: str) -> str:
    """The unit that a column's name ends with (`lift [mm]`, `EZ0T_mm`), one of COLUMN_UNITS; empty: none."""
    text = plain_unit(name.strip().lower()).replace('"', "arcsec")
    bracketed = _BRACKETED.search(text)
    if bracketed is not None:
        return bracketed[1] if bracketed[1] in COLUMN_UNITS else ""
    return next((unit for unit in _AT_END if re.search(rf"[\W_]{unit}$", text)), "")
