"""What the store writes to the disk in a day: no more than docs/results.md says."""

import tempfile
from pathlib import Path

import pytest

from benchmarks.storage import played

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.parametrize(("samples_days", "gb_a_day"), [(1e3, 0.26), (1.0 / 24.0, 0.34)], ids=["kept", "thinned"])
def test_a_day_of_28_channels_wears_the_disk_as_is_said(samples_days: float, gb_a_day: float) -> None:
    with tempfile.TemporaryDirectory(dir=ROOT) as folder:  # not in /tmp, which may be memory
        found = played(Path(folder) / "store", 15, samples_days)
    # Slowly played, the kernel writes the log's index more often.
    assert found == pytest.approx(gb_a_day, rel=0.1)
