"""The configurations of the benchmark of the whole service are valid, and have the channels that its table names."""

from pathlib import Path

import pytest

from benchmarks.acquisition import bench_config, buses_config
from benchmarks.emulators import HOSTS, LINES
from gateway.config.file import load

BENCH = {"rtu_port": "/dev/pts/1", "tcp_port": 5020, "can_port": "/dev/pts/2", "growth_port": "/dev/pts/3"}


@pytest.mark.parametrize("nc", [False, True])
def test_a_machines_usual_size(nc: bool, tmp_path: Path) -> None:
    config = load(bench_config(tmp_path, {**BENCH, "nc_port": 4840}, nc=nc))
    assert len(config.channels) == 30
    assert {channel.name: channel.period_s for channel in config.channels} == {
        channel.name: 0.1 if channel.name == "spindle_growth" else 1.0 for channel in config.channels
    }
    assert (config.nc is not None) is nc


def test_500_channels_on_20_buses(tmp_path: Path) -> None:
    places = {"lines": [f"/dev/pts/{n}" for n in range(LINES)], "hosts": [5020 + n for n in range(HOSTS)]}
    config = load(buses_config(tmp_path, places))
    assert (len(config.channels), len(config.buses)) == (500, 20)
