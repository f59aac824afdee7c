"""Each row of docs/safety.md names tests that exist, and one of them fails when the code behind the row is broken.

The tests run within this process, so the chosen ones are quick.
"""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from tests.benches.broken import VARIABLE, Break, always, broken, gives, instead, never, only_first, uncaught, without

TESTS = Path(__file__).parent
FROM_ZERO = ("gateway.nc.slew:Slew.__init__", instead("_matrix", "np.zeros((3, 1))"))

BROKEN: dict[str, tuple[str, Break]] = {
    # Modes
    "unarmed_probing_asks_for_nothing": ("gateway.nc.link:NcLink.may_probe", gives("True")),
    "unarmed_nothing_is_ever_written[advise]": (
        "gateway.nc.lease:Lease.__init__",
        always("mode"),
    ),
    "offsets_are_published_in_every_mode_but_monitor": (
        "gateway.telemetry.publisher:TelemetryPublisher.publish",
        never("mode"),
    ),
    "the_mode_does_not_change_while_the_gateway_runs[monitor-compensate]": (
        "gateway.acquisition.reload:bus_changes",
        never("changed"),
    ),
    "no_other_machine_is_probed_or_compensated": ("gateway.config.rules:_chain", always("corrected")),
    # Offsets
    "every_axis_has_its_own_bound_and_nothing_ever_steps": (
        "gateway.nc.slew:Slew.follow",
        only_first("_within"),
    ),
    "a_hung_gateway_does_not_catch_up_in_one_step": (
        "gateway.nc.slew:Slew.follow",
        only_first("min"),
    ),
    "a_shift_that_follows_the_position_keeps_to_bound_and_rate_at_every_position": (
        "gateway.nc.slew:_within",
        gives("rows"),
    ),
    "no_point_of_the_travel_moves_faster_than_the_slew_and_the_nine_keep_their_proportion": (
        "gateway.nc.slew:Slew.follow",
        never("largest"),
    ),
    "no_axis_goes_beyond_its_bound": (
        "drivers.sinumerik.programs:_output",
        instead("bound_um", "(1e6, 1e6, 1e6)"),
    ),
    "a_model_update_that_moves_the_prediction_is_ramped": (
        "gateway.nc.slew:Slew.follow",
        only_first("_within"),
    ),
    "no_renewal_ends_a_pause_or_arms_the_gateway[pause]": (
        "gateway.nc.target:Target.errors",
        never("paused"),
    ),
    "a_sensor_whose_last_readings_are_wrong_moves_it_as_little_as_the_frame_would": (
        "gateway.control.grid:GridSampler.present",
        instead("_FEWEST", "0.0"),
    ),
    "offsets_stand_still_while_the_nc_probes_and_are_taken_out_of_the_result": (
        "gateway.nc.hold:Hold.on",
        gives("False"),
    ),
    "offsets_stand_still_while_another_client_has_the_control_probe[compensate]": (
        "gateway.nc.link:NcLink._finding",
        instead("probing", "False"),
    ),
    "stopping_withdraws_the_request_that_nobody_waits_for": (
        "gateway.nc.probing.prober:Prober.withdraw",
        gives("None"),
    ),
    "before_a_dry_run_no_cycle_is_requested_whoever_wants_one": ("gateway.nc.link:NcLink.barrier", gives("''")),
    "a_control_that_goes_down_to_the_sphere_is_told_to_stop_at_once": (
        "gateway.nc.probing.dry_run:run_dry",
        never("distance"),
    ),
    "a_dry_run_is_asked_for_once_a_call_has_shown_the_version_and_only_then": (
        "drivers.sinumerik.control:Sinumerik._prove",
        never("version"),
    ),
    "a_height_that_another_program_changes_makes_no_measurement_and_no_dry_run": (
        "drivers.sinumerik.control:Sinumerik._check_height",
        gives("None"),
    ),
    "what_is_noticed_ends_the_cycle_at_once": ("gateway.nc.probing.foreign:CycleWatch.look", gives("False")),
    "a_reference_of_another_origin_is_none_and_a_new_one_is_measured": (
        "gateway.control.restart.proven:is_elsewhere",
        gives("False"),
    ),
    "offsets_that_moved_while_the_control_probed_make_no_measurement": (
        "gateway.nc.hold:HeldOffsets.still",
        never("differ"),
    ),
    "disarmed_nothing_is_measured_while_the_watchdog_takes_the_offsets_to_zero[zero]": (
        "gateway.nc.lease:Lease.taken_back",
        gives("False"),
    ),
    # Without a basis for offsets
    "a_decision_counts_until_it_is_stale": (
        "gateway.nc.target:Target.errors",
        never("stale_after_s"),
    ),
    "a_missing_input_counts_from_when_it_went_missing": (
        "gateway.nc.target:Target.errors",
        never("inputs_stale_after_s"),
    ),
    "an_error_without_a_model_is_corrected_by_its_last_measurement_for_a_limited_time[zero-None]": (
        "gateway.nc.unmodelled:LastMeasured.outdated",
        never("_longest"),
    ),
    "nothing_is_built_on_what_cannot_be_stored": (
        "gateway.nc.target:Target.errors",
        always("_stored"),
    ),
    "before_the_first_decision_it_goes_where_declared[zero-0.0]": (
        "gateway.nc.slew:Slew.follow",
        never("_when_stale"),
    ),
    "without_any_known_error_there_is_no_target[hold]": (
        "gateway.nc.target:Target.errors",
        always("isfinite"),
    ),
    "stopping_gives_the_control_back": ("gateway.nc.lease:Lease.release", gives("None")),
    "stopped_in_the_middle_of_a_write_it_takes_the_offsets_back_and_reports_no_other_writer": (
        "gateway.nc.link:NcLink.run",
        only_first("to_its_end"),
    ),
    "a_request_that_cannot_be_withdrawn_does_not_keep_the_offsets_from_being_taken_back": (
        "gateway.nc.link:NcLink._try",
        uncaught("DriverError"),
    ),
    "after_silence_the_offsets_go_to_zero_at_the_declared_rate": (
        "drivers.sinumerik.control:Sinumerik._watchdog_values",
        instead("silence_s", "1e3"),
    ),
    "an_answer_that_the_interface_excludes_is_the_control_s_fault[two offsets]": (
        "gateway.nc.link:NcLink.__init__",
        only_first("contained_control"),
    ),
    "an_axis_that_reports_a_speed_and_does_not_move_is_reported_after_its_time": (
        "gateway.nc.motion:Motion.frozen",
        never("_longest"),
    ),
    # also: after a write it is read back
    "offsets_that_somebody_else_set_are_not_written_over": (
        "gateway.nc.lease:Lease.disarm",
        without("_right"),
    ),
    # Never a step
    "armed_it_ramps_from_what_is_in_force_and_never_steps": FROM_ZERO,
    "killed_it_leaves_the_control_to_its_watchdog_and_started_again_it_goes_on_from_there": FROM_ZERO,
    "restarted_in_another_mode_the_offsets_end_at_zero_without_a_step[monitor]": (
        "gateway.nc.lease:Lease.__init__",
        never("when_stale"),
    ),
    "after_a_lost_connection_it_begins_from_what_is_in_force": (
        "gateway.nc.writer:OffsetWriter._continue_from",
        instead("in_force", "np.full((3, 1), 4.0)"),
    ),
    "after_the_watchdog_had_the_offsets_it_begins_from_where_they_are": (
        "gateway.nc.link:NcLink._beat",
        without("begin"),
    ),
    "the_offsets_stand_where_a_late_write_would_find_them_and_it_is_no_step": (
        "gateway.nc.writer:OffsetWriter._may_arrive",
        gives("False"),
    ),
    "a_write_that_the_network_holds_for_longer_than_the_session_lasts_is_refused": (
        "drivers.opcua.session:OpcUaSession._connect",
        instead("_asked_s", "60.0"),
    ),
    "later_than_that_it_is_still_known_as_its_own_and_the_ramp_goes_on_from_there": (
        "gateway.nc.writer:OffsetWriter._is_late",
        gives("False"),
    ),
    "a_connection_lost_in_the_middle_of_a_write_leaves_no_step_behind": FROM_ZERO,
    "a_process_that_stood_still_since_its_beat_does_not_write": (
        "gateway.nc.lease:Lease.check_fresh",
        gives("None"),
    ),
    "it_begins_from_what_moved_while_the_control_was_not_ready_and_reports_no_other_writer": (
        "gateway.nc.link:NcLink._compensate",
        never("NOT_READY"),
    ),
    "a_process_that_stands_still_within_any_request_leaves_no_step_behind[k0_slope-for less than a period]": (
        "gateway.nc.writer:OffsetWriter._too_soon",
        gives("False"),
    ),
    # The control's own events
    "while_the_control_is_not_ready_the_offsets_stand": (
        "gateway.nc.link:NcLink._finding",
        never("ready"),
    ),
    "a_zero_for_not_ready_writes_nothing_and_does_not_end_the_link": (
        "gateway.nc.boundary:_check_snapshot",
        always("isinstance"),
    ),
    "drives_that_are_off_are_not_ready_where_the_control_has_a_bit_for_it": (
        "drivers.sinumerik.control:Sinumerik.snapshot",
        always("_drives"),
    ),
    "not_ready_while_it_stops_it_writes_nothing_more": (
        "gateway.nc.link:NcLink._take_back",
        never("ready"),
    ),
    "power_off_and_on_leaves_no_offset_and_no_owner": (
        "simulators.nc.nck:Nck.power_on",
        instead("R_SLOPE_RAMP", "R_OFFSETS"),
    ),
    "an_axis_is_referenced_only_when_the_control_says_so": (
        "drivers.sinumerik.control:Sinumerik.snapshot",
        always("_is_odd"),
    ),
    # Commands
    "a_command_counts_once": (
        "gateway.telemetry.command_door:Challenges.use",
        never("_used"),
    ),
    "a_pause_ramps_the_offsets_to_their_declared_state_until_it_is_resumed_and_nothing_steps": (
        "gateway.nc.target:Target.errors",
        never("paused"),
    ),
    "a_pause_survives_restarts_and_the_loss_of_the_database_until_it_is_resumed": (
        "gateway.control.restart.earlier:past_of",
        instead("paused", "None"),
    ),
    "without_a_disk_a_pause_counts_at_once_and_nothing_else_does": (
        "gateway.service.command_taker:CommandTaker.take",
        never("BY_CAUTION"),
    ),
    "a_command_never_arms_what_is_not_armed_or_has_disarmed_itself": (
        "gateway.service.command_taker:CommandTaker._not_probed",
        always("may_probe"),
    ),
    "disarmed_the_offsets_ramp_to_zero_whatever_is_declared_until_it_is_armed": (
        "gateway.nc.target:Target.errors",
        never("disarmed"),
    ),
    "disarmed_no_cycle_is_requested_and_one_that_waits_is_withdrawn": (
        "gateway.nc.link:NcLink._cycle",
        without("settle"),
    ),
    "a_disarming_survives_restarts_and_the_loss_of_the_database": (
        "gateway.control.restart.earlier:past_of",
        instead("disarmed", "None"),
    ),
    "a_good_file_is_applied_and_one_that_needs_a_restart_or_is_wrong_is_refused_with_the_reason": (
        "gateway.acquisition.reload:bus_changes",
        never("changed"),
    ),
    # Trust
    "what_somebody_else_writes_disarms_instead_of_being_overwritten_by_a_step": (
        "gateway.nc.writer:OffsetWriter._is_mine",
        gives("True"),
    ),
    "a_cycle_in_which_the_control_did_not_hear_the_gateway_makes_no_measurement[False-rejected]": (
        "gateway.nc.hold:HeldOffsets.still",
        always("watched"),
    ),
    "a_ramp_that_waited_for_a_cycle_begins_from_what_is_in_force_then": (
        "gateway.nc.writer:OffsetWriter._is_begun",
        only_first("min"),
    ),
    "stopped_while_it_is_disarmed_it_takes_them_to_zero_also_with_hold": (
        "gateway.nc.link:NcLink._take_back",
        always("disarmed"),
    ),
    "disarming_waits_for_no_other_command_and_counts_after_those_that_came_before_it": (
        "gateway.service.command_taker:CommandTaker.take",
        never("UNPROVED"),
    ),
    "a_step_says_when_the_control_cannot_be_reached_any_more": (
        "gateway.nc.link:NcLink._cycle",
        never("latest"),
    ),
    "within_a_cycle_the_tip_is_the_probe_s_and_not_the_part_program_s": (
        "drivers.sinumerik.control:Sinumerik.snapshot",
        never("under_way"),
    ),
    "no_ramp_begins_from_a_spoilt_answer": (
        "gateway.nc.writer:OffsetWriter._is_begun",
        gives("True"),
    ),
    "a_write_that_does_not_take_effect_disarms_and_says_so_once": (
        "gateway.nc.writer:OffsetWriter._read_back",
        without("_agrees"),
    ),
    "what_is_not_a_number_when_it_connects_is_reported_and_does_not_end_the_link": (
        "gateway.nc.writer:OffsetWriter._continue_from",
        always("isfinite"),
    ),
    "a_step_like_the_one_before_is_stored_only_when_it_was_not_confirmed": (
        "gateway.nc.writer:OffsetWriter._record",
        always("read_back"),
    ),
    "a_second_gateway_is_refused_until_the_first_is_silent_or_gone": (
        "drivers.sinumerik.lease:SinumerikLease.claim",
        never("holder"),
    ),
    "an_agent_that_touches_other_poses_is_refused_and_a_whole_turn_is_none": (
        "drivers.agent.greeting:Greeting.check_poses",
        gives("None"),
    ),
    "a_machine_is_ready_only_when_the_agent_says_so": (
        "drivers.agent.control:AgentControl.snapshot",
        never("stopped"),
    ),
    "clients_that_only_read_are_served_beside_the_gateway_and_can_do_nothing_else": (
        "deploy/nc/linuxcnc/talc_server.py:TalcServer._obey",
        never("reads"),
    ),
    "nothing_that_moves_is_asked_unless_it_is_allowed": (
        "gateway.commissioning.agent_test.clauses:run_clauses",
        always("moves"),
    ),
    "a_copy_of_what_runs_takes_nothing_over_on_another_computer": (
        "gateway.storage.store:Store._open",
        always("here"),
    ),
    "a_request_that_waits_or_runs_is_not_displaced_and_the_snapshot_shows_that_it_runs[sinumerik]": (
        "drivers.sinumerik.control:Sinumerik._check_free",
        never("taken_back"),
    ),
    "a_component_that_has_stopped_hears_no_beat_and_nothing_is_written": (
        "deploy/nc/linuxcnc/talc_offsets.py:Offsets._watched",
        gives("True"),
    ),
    "what_the_control_keeps_without_power_is_no_sign_of_a_watchdog": (
        "drivers.sinumerik.lease:SinumerikLease._passes",
        gives("True"),
    ),
    "a_reset_at_any_moment_makes_no_step_and_the_program_goes_on": (
        "drivers.sinumerik.programs:_held",
        gives("'$AC_PARAM[40]'"),
    ),
    "the_length_of_the_tool_counts_and_its_change_is_a_ramp": (
        "drivers.sinumerik.programs:_output",
        instead("same_tool", "'1'"),
    ),
    "both_axes_of_a_gantry_get_the_same_offset_in_the_same_cycle": (
        "drivers.sinumerik.settings:OffsetRoute.moved_together",
        gives("(self.axis_names['XYZ'[axis]],)"),
    ),
    "without_a_watchdog_on_the_control_nothing_is_written": (
        "gateway.nc.link:NcLink._beat",
        instead("heard", "True"),
    ),
    "a_chip_on_the_sphere_is_no_measurement": (
        "gateway.nc.probing.checks:MeasurementChecks.fits",
        gives("None"),
    ),
}
"""By the test that must fail, without `test_`: what is broken, and how."""
KILLED = "a_gateway_killed_at_any_moment_makes_no_step"
"""Its gateways are other processes."""


def rows() -> list[tuple[str, frozenset[str]]]:
    """Promise, and the functions of its tests without `test_`, of each row with a column `test`."""
    lines = (TESTS.parent / "docs" / "safety.md").read_text("utf-8").splitlines()
    found, promising = [], False
    for before, line in zip(["", *lines], lines, strict=False):
        if not before.startswith("|"):
            promising = line.endswith("| test |")
        elif promising and not set(line) <= set("|- "):
            text, tests = line.strip("| ").rsplit(" | ", 1)
            found.append((text, frozenset(re.findall(r"\w+", tests))))
    return found


@cache
def files() -> dict[str, list[Path]]:
    """By name of a test's function, the files that it is in."""
    found = dict[str, list[Path]]()
    for file in TESTS.rglob("test_*.py"):
        for node in ast.parse(file.read_text("utf-8")).body:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                found.setdefault(node.name, []).append(file)
    return found


def test_every_row_names_tests_that_exist_and_has_something_broken() -> None:
    assert len(rows()) > 60
    assert {name for _, tests in rows() for name in tests if f"test_{name}" not in files()} == set()
    proved = {test.partition("[")[0] for test in (*BROKEN, KILLED)}
    assert [text for text, tests in rows() if not tests & proved] == []


class Outcome:
    """A plugin that keeps whether a test failed."""

    def __init__(self) -> None:
        self.passed = self.failed = 0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.passed += report.when == "call" and report.passed
        self.failed += report.failed


def failed(test: str) -> bool:
    """Whether a test fails in this process, for one of its parameters."""
    outcome, name = Outcome(), f"test_{test}"
    places = [f"{file}::{name}" for file in files()[name.partition("[")[0]]]
    pytest.main(["-q", "-x", "--tb=no", "-p", "no:cacheprovider", "-p", "no:xdist", *places], plugins=[outcome])
    assert outcome.failed + outcome.passed > 0, "it ran"
    return outcome.failed > 0


@pytest.mark.slow
@pytest.mark.parametrize("test", BROKEN)
def test_without_the_code_behind_a_promise_its_test_fails(test: str) -> None:
    with broken(*BROKEN[test]):
        assert failed(test)


@pytest.mark.slow
def test_without_a_slew_a_killed_gateway_makes_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "gateway.nc.slew:Slew.follow only_first _within")
    assert failed(KILLED)
