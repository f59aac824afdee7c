"""A small drawing of what a thermal error is: a table turns about C, on a cradle that turns about A (ISO 230-1)."""

from itertools import pairwise
from math import cos, pi, sin

from gateway.model.text import Language
from talc.names import ERROR_MEANINGS

_SpacePoint = tuple[float, float, float]
_DIRECTIONS: dict[str, _SpacePoint] = {"X": (1, 0, 0), "Y": (0, 1, 0), "Z": (0, 0, 1)}
_MOVED = 0.5
"""Length of a drawn shift; everything is drawn far too large."""
_TURNED = 0.32
_DISC = 0.8
"""The table's radius."""
_TOP = 0.3
"""The table's height."""


def letters(error: str, said: Language) -> str:
    """What the name says, letter by letter; empty for a name that is not one of the nine."""
    if error not in ERROR_MEANINGS:
        return ""
    kind, whose = error[1], error[3]
    words = said(f"report_letter.{kind}"), said(f"report_letter.of_{whose}")
    return said("report_letter.all", kind=kind, kind_words=words[0], whose=whose, whose_words=words[1])


def sketch(error: str, said: Language) -> str:
    """SVG; empty for a name that is not one of the nine."""
    if error not in ERROR_MEANINGS:
        return ""
    direction, whose = error[1], error[3]
    moved = _moved_axis(direction, whose) if whose in "AC" else _moved_table(direction)
    parts = [
        _line("plain", (-1.35, 0, 0), (1.35, 0, 0)),
        _drawn_text((1.5, 0, -0.05), "A"),
        _disc("plain", _DISC, _TOP),
        _line("plain", (0, 0, _TOP), (0, 0, 1.3)),
        _drawn_text((0, 0, 1.4), "C"),
        *moved,
        *_triad(),
    ]
    name = f"{error}: {said(f'error.{error}')}"
    return (
        f'<svg class="sketch" viewBox="-100 -82 200 140" role="img" aria-label="{name}"><title>{name}</title>'
        + "".join(parts)
        + "</svg>"
    )


def _moved_axis(direction: str, whose: str) -> list[str]:
    begin, end = ((-1.35, 0.0, 0.0), (1.35, 0.0, 0.0)) if whose == "A" else ((0.0, 0.0, _TOP), (0.0, 0.0, 1.3))
    if direction in _DIRECTIONS:
        shift = _scaled(_DIRECTIONS[direction], _MOVED)
        middle = (0.75, 0.0, 0.0) if whose == "A" else (0.0, 0.0, 1.0)
        return [_line("moved", _sum(begin, shift), _sum(end, shift)), _arrow(middle, _sum(middle, shift))]
    if direction == "C":  # about itself: the table's zero position
        zero = [_at(_DISC, angle, _TOP) for angle in (0.0, _TURNED * 1.6)]
        arc = [_at(_DISC * 1.12, _TURNED * 1.6 * i / 8, _TOP) for i in range(9)]
        return [
            _line("plain", (0, 0, _TOP), zero[0]),
            _line("moved", (0, 0, _TOP), zero[1]),
            *(_line("arrow", a, b) for a, b in pairwise(arc)),
            _arrow(arc[-2], arc[-1]),
        ]
    length = 1.3 - _TOP
    tilt = (0.0, -sin(_TURNED), cos(_TURNED)) if direction == "A" else (sin(_TURNED), 0.0, cos(_TURNED))
    top = _sum((0, 0, _TOP), _scaled(tilt, length))
    return [_line("moved", (0, 0, _TOP), top), _arrow((0, 0, 1.3), top)]


def _moved_table(direction: str) -> list[str]:
    if direction == "Z":
        up = _TOP + _MOVED
        return [_disc("moved", _DISC, up), _arrow((_DISC, 0, _TOP), (_DISC, 0, up))]
    grown = _DISC + _MOVED * 0.8
    return [
        _disc("moved", grown, _TOP),
        *(_arrow(_at(_DISC, angle, _TOP), _at(grown, angle, _TOP)) for angle in (0.0, pi / 2, pi, 3 * pi / 2)),
    ]


def _triad() -> list[str]:
    origin = (-1.3, -1.3, -0.3)
    return [
        part
        for name, direction in _DIRECTIONS.items()
        for part in (
            _line("axis", origin, _sum(origin, _scaled(direction, 0.45))),
            _drawn_text(_sum(origin, _scaled(direction, 0.68)), name, "small"),
        )
    ]


def _flat(p: _SpacePoint) -> tuple[float, float]:
    """On paper: X to the right, Y into the depth, Z up."""
    return 46.0 * (p[0] + 0.3 * p[1]), -46.0 * (p[2] + 0.42 * p[1])


def _at(radius: float, angle: float, z: float) -> _SpacePoint:
    return radius * cos(angle), radius * sin(angle), z


def _sum(a: _SpacePoint, b: _SpacePoint) -> _SpacePoint:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _scaled(p: _SpacePoint, factor: float) -> _SpacePoint:
    return p[0] * factor, p[1] * factor, p[2] * factor


def _line(kind: str, a: _SpacePoint, b: _SpacePoint) -> str:
    (x1, y1), (x2, y2) = _flat(a), _flat(b)
    return f'<line class="{kind}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>'


def _arrow(a: _SpacePoint, b: _SpacePoint) -> str:
    """A line with a head at `b`."""
    (x1, y1), (x2, y2) = _flat(a), _flat(b)
    length = max(((x2 - x1) ** 2 + (y2 - y1) ** 2) ** 0.5, 1e-6)
    u, v = (x2 - x1) / length, (y2 - y1) / length
    head = " ".join(
        f"{x2 - 6 * along * u - 3 * side * v:.1f},{y2 - 6 * along * v + 3 * side * u:.1f}"
        for along, side in ((0, 0), (1, 1), (1, -1))
    )
    return _line("arrow", a, b) + f'<polygon class="head" points="{head}"/>'


def _disc(kind: str, radius: float, z: float) -> str:
    rim = (_flat(_at(radius, pi * i / 24, z)) for i in range(48))
    return f'<polygon class="{kind} disc" points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in rim)}"/>'


def _drawn_text(p: _SpacePoint, text: str, kind: str = "") -> str:
    x, y = _flat(p)
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="middle" dominant-baseline="middle">{text}</text>'
