"""`python -m benchmarks.error_figures`: draws the nine thermal errors of docs/glossary.md, as the report draws each."""

import re
import sys
from pathlib import Path

from gateway.model.text import Language
from gateway.reporting.sketch import sketch
from talc.names import THERMAL_ERRORS

_COLUMNS = 3
_WIDTH, _HEIGHT, _TITLE = 200, 140, 16
_STYLE = """
text { font: 11px sans-serif; fill: #333; } .small { font-size: 9px; fill: #777; } .name { font: bold 12px sans-serif; }
.plain { stroke: #888; stroke-width: 2; } .disc { fill: none; }
.moved { stroke: #1b6ec2; stroke-width: 2.4; stroke-dasharray: 5 3; }
.arrow { stroke: #333; stroke-width: 1.6; } .head { fill: #333; } .axis { stroke: #777; stroke-width: 1; }
"""


def figure() -> str:
    """SVG of all nine, three in a row; grey where the axis or the table should be, blue where it is."""
    cells = []
    for i, error in enumerate(THERMAL_ERRORS):
        x, y = i % _COLUMNS * _WIDTH, i // _COLUMNS * (_HEIGHT + _TITLE)
        drawn = re.sub(
            r'class="sketch"',
            f'x="{x}" y="{y + _TITLE}" width="{_WIDTH}" height="{_HEIGHT}"',
            sketch(error, Language()),
        )
        cells.append(f'<text class="name" x="{x + 8}" y="{y + _TITLE}">{error}</text>{drawn}')
    width, height = _COLUMNS * _WIDTH, -(-len(THERMAL_ERRORS) // _COLUMNS) * (_HEIGHT + _TITLE)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}">'
        f'<style>{_STYLE}</style><rect width="{width}" height="{height}" fill="#fff"/>\n'
        + "\n".join(cells)
        + "\n</svg>\n"
    )


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docs")
    (folder / "nine-errors.svg").write_text(figure(), encoding="utf-8")
