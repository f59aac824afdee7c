"""Studies that repeat the papers on simulated machines, compared with simple methods. See docs/studies.md."""

from studies.adaptive_inputs import STUDY as _ADAPTIVE_INPUTS
from studies.arx_vs_static import STUDY as _ARX_VS_STATIC
from studies.frame import Run, Study, carry_out, key
from studies.loop import Days, control, days, filled, held
from studies.page import renew
from studies.parameters import STUDY as _PARAMETERS
from studies.test_piece import STUDY as _TEST_PIECE

STUDIES: dict[str, Study] = {
    study.name: study for study in (_ARX_VS_STATIC, _ADAPTIVE_INPUTS, _PARAMETERS, _TEST_PIECE)
}

__all__ = ["STUDIES", "Days", "Run", "Study", "carry_out", "control", "days", "filled", "held", "key", "renew"]
