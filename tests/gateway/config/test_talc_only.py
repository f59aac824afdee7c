"""`replay --config` and `run` take the same `[grid]` and `[talc]`: one definition, one message.

Rules between these and a section that a recording lacks, such as `[probing]`, apply only to `run`.
"""

from pathlib import Path

import pytest

from gateway.config.file import load
from gateway.config.problems import ConfigError
from gateway.config.talc_only import load_talc_only
from tests.benches.service_file import TEXT


def problems(file: Path, reader: object) -> list[str]:
    assert callable(reader)
    try:
        reader(file)
    except ConfigError as error:
        return [str(problem) for problem in error.problems]
    return []


@pytest.mark.parametrize(
    ("section", "good"),
    [
        ("[grid]\nstep_s = 300.0", True),
        ("[grid]\nstep_s = 600", True),
        ('[grid]\nstep_s = "60"', False),
        ("[grid]\nstep_s = 0", False),
        ("[grid]\nstep_s = nan", False),
        ("[grid]\nstep = 60", False),
        ('[talc]\nmethod = "models"', True),
        ('[talc]\nmethod = "model"', False),
        ('[talc]\npreset = "nowhere"', False),
        ("[talc.control]\ncalibration_steps = 300", True),
        ('[talc.control]\ncalibration_steps = "300"', False),
        ("[talc.control]\ncalibration_steps = true", False),
        ("[talc.control]\ncalibration_steps = -1", False),
        ('[talc.control]\npolicy = "never"', False),
        ("[talc.learner]\nlimit_um = 3", True),
        ('[talc.learner]\nlimit_um = "3"', False),
        ("[talc.learner]\nlimits_um = 3", False),
    ],
)
def test_what_one_refuses_the_other_refuses_in_the_same_words(tmp_path: Path, section: str, good: bool) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(f"{TEXT}\n{section}\n", encoding="utf-8")
    of_run = problems(file, load)
    assert of_run == problems(file, load_talc_only)
    assert (of_run == []) is good
