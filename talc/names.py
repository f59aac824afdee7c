"""The nine thermal errors, their order and their units (ISO 230-1, ISO 230-7)."""

import re
from typing import Final

THERMAL_ERRORS: Final = ("EY0A", "EZ0A", "EX0C", "EY0C", "EZ0T", "ER0T", "EA0C", "EB0C", "EC0C")
"""Order of every nine-vector in the project."""

MICROMETRE: Final = "µm"
MICROMETRE_PER_METRE: Final = "µm/m"

ERROR_UNITS: Final = dict.fromkeys(THERMAL_ERRORS[:6], MICROMETRE) | dict.fromkeys(
    THERMAL_ERRORS[6:], MICROMETRE_PER_METRE
)

TINY_UM: Final = 0.25
"""Errors that are never larger are most likely not in µm: the learner trusts no measurement to be better."""

LEAST_NAMED: Final = 0.05
"""In an error's unit: an input that moves it by less would be shown as zero, and is not named."""
LEAST_SHARE_NAMED: Final = 0.05
"""Smallest share of an expert that is named."""
MOST_NAMED: Final = 4
"""Inputs that are named as moving an error, the largest first."""

ERROR_MEANINGS: Final = {
    "EY0A": "position of the A axis in Y",
    "EZ0A": "position of the A axis in Z",
    "EX0C": "position of the C axis in X",
    "EY0C": "position of the C axis in Y",
    "EZ0T": "axial growth of the table",
    "ER0T": "radial growth of the table",
    "EA0C": "orientation of the C axis about X",
    "EB0C": "orientation of the C axis about Y",
    "EC0C": "zero position of the C axis",
}

_WORD = re.compile(r"[^0-9A-Za-z]+|_")
_GEOMETRIC = re.compile(r"E[XYZABCR]0[A-Z]")
_ERROR_WORDS = {"error", "errors", "deviation", "deviations", "drift", "displacement", "fehler"}
_ERROR_ENDINGS = ("abweichung", "abweichungen", "verlagerung", "verlagerungen", "verschiebung", "verschiebungen")
"""Endings of German words, which are put together."""
_AXIS = re.compile(r"[xyzabc]?")


def like_an_error(name: str) -> str | None:
    """The position or orientation error, as ISO 230 names them, that a column's name holds (`ex0c_mm`); None: none."""
    words = [word.upper().replace("O", "0") for word in _WORD.split(name)]
    return next((word for word in words if _GEOMETRIC.fullmatch(word)), None)


def resembles_error(name: str, error: str, letters: bool = False) -> bool:
    """Whether a column resembles a column of errors: both are called errors, or differ only in a number or an axis.

    letters: also names that are nothing else, such as x1 and z.
    """
    own, other = _stem(name), _stem(error)
    return (own == other and (letters or bool(own))) or (called_an_error(name) and called_an_error(error))


def called_an_error(name: str) -> bool:
    """Whether a column's name says that it holds errors, of whatever kind (`Drift X`)."""
    return any(word in _ERROR_WORDS or word.endswith(_ERROR_ENDINGS) for word in _stem(name))


def _stem(name: str) -> tuple[str, ...]:
    words = (re.sub("[0-9]+$", "", word) for word in re.split(r"[\W_]+", name.lower()))
    return tuple(word for word in words if not _AXIS.fullmatch(word))
