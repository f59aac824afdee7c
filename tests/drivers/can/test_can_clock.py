"""No CAN interface waits by the wall clock."""

from pathlib import Path

from tests.benches.wall_clock import run_tests


def test_silent_bus_while_the_wall_clock_jumps(tmp_path: Path) -> None:
    run_tests(Path(__file__).with_name("can_clock_jumps.py"), tmp_path)
