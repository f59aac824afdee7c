"""Formats values for people."""

from math import isnan

from drivers.base import Reading


def number_text(value: float) -> str:
    """The value with two decimals, but 0.00 only for 0: 2e-41 degC is a wrong byte order, not a cold day."""
    plain = value == 0 or 0.01 <= abs(value) < 1e7
    return f"{value:z.2f}" if plain else f"{value:.3g}"


def reading_text(reading: Reading | None) -> str:
    """The number, without its unit, when it can be used; otherwise with its quality. None: not read yet."""
    if reading is None:
        return "-"
    if reading.quality.usable:
        return number_text(reading.value)
    quality = reading.quality.value
    return quality if isnan(reading.value) else f"{number_text(reading.value)}({quality})"
