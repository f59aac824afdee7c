"""Studies that repeat the papers on simulated machines, ours and naive peers beside theirs. See docs/studies.md."""

from simulators.studies.arx_vs_static import STUDY as _ARX_VS_STATIC
from simulators.studies.frame import Run, Study, carry_out, key
from simulators.studies.page import renew

STUDIES: dict[str, Study] = {study.name: study for study in (_ARX_VS_STATIC,)}

__all__ = ["STUDIES", "Run", "Study", "carry_out", "key", "renew"]
