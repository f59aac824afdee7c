"""Load cases for studies: what the machine does, row by row, and in which hall."""

from simulators.cases.series import LONG_TERM_H, SEASONS, Axis, long_term, random_axes, warm_up_and_cool_down
from simulators.cases.table_fluid import Letter, table_and_fluid, table_speeds

__all__ = [
    "LONG_TERM_H",
    "SEASONS",
    "Axis",
    "Letter",
    "long_term",
    "random_axes",
    "table_and_fluid",
    "table_speeds",
    "warm_up_and_cool_down",
]
