"""Studies that repeat the papers on simulated machines, compared with simple methods. See docs/plant.md."""

from pathlib import Path

from studies.adaptive_inputs import STUDY as _ADAPTIVE_INPUTS
from studies.adaptive_inputs_pictures import bars, chosen, course, residuals
from studies.arx_vs_static import STUDY as _ARX_VS_STATIC
from studies.arx_vs_static_report import boxes
from studies.frame import Run, Study, carry_out, key
from studies.loop import Days, control, days, filled, held
from studies.page import page_html
from studies.parameters import STUDY as _PARAMETERS
from studies.parameters_pictures import bands, dots
from studies.published import published, renew
from studies.published_grid import STUDY as _PUBLISHED_GRID
from studies.published_grid_pictures import by_day, cloud, panels
from studies.test_piece import STUDY as _TEST_PIECE
from studies.test_piece_report import features

STUDIES: dict[str, Study] = {
    study.name: study for study in (_ARX_VS_STATIC, _ADAPTIVE_INPUTS, _PARAMETERS, _PUBLISHED_GRID, _TEST_PIECE)
}
_DRAWINGS = (bands, bars, boxes, by_day, chosen, cloud, course, dots, features, panels, residuals)


def published_page(folder: Path) -> str:
    """The HTML page of the study that `make study` put into `folder`, which has the study's name.

    KeyError: no study has this name. ValueError: a picture's drawing is unknown.
    """
    report, origin = published(folder, _DRAWINGS)
    return page_html(STUDIES[folder.name].summary, report, origin)


__all__ = [
    "STUDIES",
    "Days",
    "Run",
    "Study",
    "carry_out",
    "control",
    "days",
    "filled",
    "held",
    "key",
    "published_page",
    "renew",
]
