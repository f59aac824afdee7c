"""The codes of what the gateway says; those of the controller's events are in talc.kinds, the sentences in `texts/`."""

from enum import StrEnum
from typing import Final


class NoticeCode(StrEnum):
    """What is said. Published and stored: a code is never given another meaning."""

    # subjects
    BUS = "bus"
    DEVICE = "device"
    CHANNEL = "channel"
    BUS_PERIOD = "bus_period"
    BUS_LINE = "bus_line"

    # problems of any subject
    INTERMITTENT = "intermittent"
    NO_MORE_KINDS = "no_more_kinds"
    FAILED = "failed"
    NOT_FINISHED = "not_finished"
    UNEXPECTED = "unexpected"

    # buses, devices, channels
    OPENED_AGAIN = "opened_again"
    ANSWERS_AGAIN = "answers_again"
    CHANNEL_BAD = "channel_bad"
    CHANNEL_BAD_BECAUSE = "channel_bad_because"
    CHANNEL_GOOD_AGAIN = "channel_good_again"
    BELOW_MINIMUM = "below_minimum"
    ABOVE_MAXIMUM = "above_maximum"
    JUMPED = "jumped"
    CHANGED_FAST = "changed_fast"
    FROZEN = "frozen"
    NO_NEW_VALUE = "no_new_value"
    NOT_ASKED_YET = "not_asked_yet"
    BUS_SLOW = "bus_slow"
    BUS_IN_TIME = "bus_in_time"
    OTHER_MASTER = "other_master"
    NO_OTHER_MASTER = "no_other_master"

    # the control
    NC_NOT_CONNECTED = "nc_not_connected"
    NC_CONNECTED_AGAIN = "nc_connected_again"
    NC_AXES_FROZEN = "nc_axes_frozen"
    NC_AXES_MOVE = "nc_axes_move"
    NC_VALUES_UNKNOWN = "nc_values_unknown"
    NC_VALUES_KNOWN = "nc_values_known"
    NC_WATCHDOG_UNHEARD = "nc_watchdog_unheard"
    NC_WATCHDOG_SILENT = "nc_watchdog_silent"
    NC_WATCHDOG_HEARD = "nc_watchdog_heard"
    NC_ONE_SHIFT = "nc_one_shift"
    NC_FOLLOWS_AGAIN = "nc_follows_again"
    NC_PROBES_ON = "nc_probes_on"
    NC_PROBES_NO_MORE = "nc_probes_no_more"
    NC_SLOW = "nc_slow"
    NC_IN_TIME = "nc_in_time"
    NC_NOT_SENDABLE = "nc_not_sendable"
    NC_OTHER_OFFSETS = "nc_other_offsets"
    NC_LATE_WRITE = "nc_late_write"

    # probing: why nothing is requested, or nothing came of it
    WAITS_IDLE = "waits_idle"
    WAITS_TOOL_CHANGE = "waits_tool_change"
    REQUESTED_AGAIN = "requested_again"
    NC_UNREACHABLE = "nc_unreachable"
    NC_ALARM = "nc_alarm"
    NC_CANNOT_PROBE = "nc_cannot_probe"
    NC_OTHER_MODE = "nc_other_mode"
    PAUSE_AFTER_REJECTS = "pause_after_rejects"
    NO_MEASUREMENT_FOR = "no_measurement_for"
    MEASUREMENT_WAITED = "measurement_waited"
    CLEAN_SPHERE = "clean_sphere"
    COMMAND_NOT_POSSIBLE = "command_not_possible"
    PROBING_BLOCKED = "probing_blocked"
    PROBING_FREE = "probing_free"
    PROBING_MOOT = "probing_moot"
    NC_NOT_ASKED = "nc_not_asked"
    NC_REQUEST_NOT_TAKEN = "nc_request_not_taken"
    NC_CYCLE_REFUSED = "nc_cycle_refused"
    NC_CYCLE_FAILED = "nc_cycle_failed"
    NO_REASON_GIVEN = "no_reason_given"
    NC_REQUEST_UNKNOWN = "nc_request_unknown"
    CYCLE_NOT_ENDED = "cycle_not_ended"
    CYCLE_NOT_BEGUN = "cycle_not_begun"
    OFFSETS_STILL_RAMPING = "offsets_still_ramping"
    GATEWAY_IS = "gateway_is"
    NUMBER_NOT_STORED = "number_not_stored"
    OFFSETS_MOVED = "offsets_moved"
    CYCLE_VOID = "cycle_void"
    RESULT_NO_POINTS = "result_no_points"
    RESULT_COUNT = "result_count"
    RESULT_NOT_FINITE = "result_not_finite"
    CENTRE_TOO_FAR = "centre_too_far"
    REFERENCE_APART = "reference_apart"
    TOUCHES_APART = "touches_apart"
    POSE_STANDS_OUT = "pose_stands_out"
    FIT_POOR = "fit_poor"
    CENTRE_OUTLIER = "centre_outlier"
    RESULT_ABSURD = "result_absurd"
    RESULT_SURPRISING = "result_surprising"

    # dry runs
    DRY_RUN_DONE = "dry_run_done"
    DRY_RUN_NOT_SHOWN = "dry_run_not_shown"
    DRY_RUN_OFFERED = "dry_run_offered"
    DRY_RUN_UNKNOWN = "dry_run_unknown"
    DRY_RUN_WANTED = "dry_run_wanted"
    DRY_RUN_CHANGED = "dry_run_changed"
    DRY_RUN_TOO_NEAR = "dry_run_too_near"
    DRY_RUN_NOT_ENDED = "dry_run_not_ended"
    DRY_RUN_POSITIONS = "dry_run_positions"
    OFF_DRY_RUN = "off_dry_run"

    # what the gateway waits for
    WAITS_ARM = "waits_arm"
    WAITS_RESUME = "waits_resume"
    WAITS_FIRST_STEP = "waits_first_step"
    NO_READING_YET = "no_reading_yet"
    MORE_CHANNELS = "more_channels"
    WAITS_NC_AWAY = "waits_nc_away"
    WAITS_NC_STILL = "waits_nc_still"
    WAITS_NC_NOT_READY = "waits_nc_not_ready"
    WAITS_ASKED = "waits_asked"
    WAITS_MEASUREMENT = "waits_measurement"
    WAITS_MEASUREMENT_BECAUSE = "waits_measurement_because"
    WAITS_OPERATOR = "waits_operator"
    WAITS_STORAGE = "waits_storage"
    WAITS_TIME_SERVER = "waits_time_server"

    # what the configuration leaves off
    OFF_NO_NC = "off_no_nc"
    OFF_ONLY_READ = "off_only_read"
    OFF_PROBING = "off_probing"
    OFF_MODE = "off_mode"
    OFF_TELEMETRY = "off_telemetry"
    OFF_LISTEN = "off_listen"

    # store, disk, clock
    STORE_FAILS = "store_fails"
    STORE_WORKS = "store_works"
    DISK_HANGS = "disk_hangs"
    ROWS_REFUSED = "rows_refused"
    STORE_MENDED = "store_mended"
    STORE_MENDED_LOST = "store_mended_lost"
    STORE_BEGUN = "store_begun"
    STORE_BEGUN_LOST = "store_begun_lost"
    STORE_DELETED = "store_deleted"
    STORE_MIGRATED = "store_migrated"
    DISK_LOW = "disk_low"
    DISK_FREE = "disk_free"
    CLOCK_UNKNOWN = "clock_unknown"
    CLOCK_AND_PAUSE_UNKNOWN = "clock_and_pause_unknown"
    CLOCK_RIGHT = "clock_right"
    CLOCK_RIGHT_AFTER = "clock_right_after"

    # sensors and planned loads
    SENSOR_OFF = "sensor_off"
    SENSORS_EXCHANGED = "sensors_exchanged"
    SENSORS_AGREE = "sensors_agree"
    SENSORS_NOT_JUDGED = "sensors_not_judged"
    SENSORS_JUDGED = "sensors_judged"
    SENSORS_NOT_LEARNT = "sensors_not_learnt"
    SENSORS_LEARNT = "sensors_learnt"
    UNEXPECTED_ERROR = "unexpected_error"
    LOADS_NOT_LEARNT = "loads_not_learnt"
    LOADS_LEARNT = "loads_learnt"

    # commands and orders
    PAUSED_BY = "paused_by"
    DISARMED_BY = "disarmed_by"
    COMMAND_ACCEPTED = "command_accepted"
    COMMAND_REFUSED = "command_refused"
    MORE_REFUSED = "more_refused"
    UNPROVED = "unproved"
    MAY_NOT = "may_not"
    NOT_LET_IN = "not_let_in"
    TOO_MANY_COMMANDS = "too_many_commands"
    NOT_STORABLE = "not_storable"
    NOT_STORED_YET = "not_stored_yet"
    NO_CONTROL = "no_control"
    NO_FILE = "no_file"
    NOT_RELOADED = "not_reloaded"
    RELOAD_SAME = "reload_same"
    RELOAD_APPLIED = "reload_applied"
    RELOAD_UNDER_WAY = "reload_under_way"
    RELOAD_CAME_BETWEEN = "reload_came_between"
    RELOAD_UNEXPECTED = "reload_unexpected"
    RELOAD_NEEDS_RESTART = "reload_needs_restart"
    RELOAD_OTHER_INPUTS = "reload_other_inputs"
    RELOAD_NOT_RUNNING = "reload_not_running"
    GONE_AND_NEW = "gone_and_new"
    GONE = "gone"
    NEW = "new"
    THEIR_ORDER = "their_order"
    PROBING_NOT_ARMED = "probing_not_armed"
    ARM_ENDS_THAT = "arm_ends_that"
    MEASUREMENT_UNDER_WAY = "measurement_under_way"
    MEASUREMENT_WHEN_FREE = "measurement_when_free"
    MEASUREMENT_IN_STEP = "measurement_in_step"
    PAUSED_ALREADY = "paused_already"
    PAUSED_NOW = "paused_now"
    NOT_PAUSED = "not_paused"
    RESUMED = "resumed"
    DISARMED_ALREADY = "disarmed_already"
    DISARMED_NOW = "disarmed_now"
    NOT_DISARMED = "not_disarmed"
    ARMED_AGAIN = "armed_again"
    AND_NOTHING_WRITTEN = "and_nothing_written"
    AND_DISARMED = "and_disarmed"
    AND_PAUSED = "and_paused"
    AND_NOT_MEASURED = "and_not_measured"

    # what differs from the latest run
    METHOD_CONTINUES = "method_continues"
    PRIOR_IS = "prior_is"
    PRIOR_GONE = "prior_gone"
    PRIOR_DIFFERS = "prior_differs"
    SETTINGS_LEARNT_AGAIN = "settings_learnt_again"
    SETTINGS_MODELS_KEPT = "settings_models_kept"

    # recordings of users
    READ_AS_WINDOWS_1252 = "read_as_windows_1252"
    TIMES_IN_UNIT = "times_in_unit"
    ROWS_REPEATED = "rows_repeated"
    ROWS_OF_ONE_TIME = "rows_of_one_time"
    RUNS_ONE_AFTER_ANOTHER = "runs_one_after_another"

    # trainings
    TRAINING_FAILED = "training_failed"

    # telemetry and the programs that listen
    NOT_PUBLISHED = "not_published"
    PUBLISHED_AGAIN = "published_again"
    NO_SUCH_TABLE = "no_such_table"
    PARAMETER_UNKNOWN = "parameter_unknown"
    QUERY_REFUSED = "query_refused"
    NOT_COLLECTED = "not_collected"
    COLLECTED_AGAIN = "collected_again"
    COLLECTING_AGAIN = "collecting_again"
    NO_GATEWAY_HEARD = "no_gateway_heard"
    GATEWAYS_HEARD = "gateways_heard"
    UNREADABLE = "unreadable"
    MANY_UNREADABLE = "many_unreadable"
    READABLE_AGAIN = "readable_again"
    OUTLET_AWAY = "outlet_away"
    OUTLET_FAILED = "outlet_failed"
    OUTLET_BACK = "outlet_back"
    OUTLET_NOT_ACCEPTED = "outlet_not_accepted"
    OUTLET_ACCEPTS = "outlet_accepts"
    VALUES_NOT_SHOWN = "values_not_shown"
    VALUES_SHOWN = "values_shown"

    # what is wrong around a gateway
    CLOCK_NOT_SET = "clock_not_set"
    FOLDER_ABSENT = "folder_absent"
    DISK_NEARLY_FULL = "disk_nearly_full"
    SUPPLY_LOW = "supply_low"
    PROCESSOR_SLOW = "processor_slow"
    CAN_ABSENT = "can_absent"
    CAN_LEFT_BUS = "can_left_bus"
    CAN_DOWN = "can_down"
    LINE_SHARED = "line_shared"
    FILE_ABSENT = "file_absent"
    SECRET_ABSENT = "secret_absent"
    FILE_UNREADABLE = "file_unreadable"
    FILE_OF_OTHERS = "file_of_others"
    CONFIG_CAUTION = "config_caution"
    KEY_SPOILT = "key_spoilt"
    USERS_SPOILT = "users_spoilt"
    PASSWORD_SPOILT = "password_spoilt"
    PAIR_SPOILT = "pair_spoilt"
    CERTIFICATE_SPOILT = "certificate_spoilt"
    NOBODY_HEARS = "nobody_hears"
    COMMANDS_REFUSED = "commands_refused"
    NC_NOT_TO_CONNECT = "nc_not_to_connect"
    BUS_NOT_TO_READ = "bus_not_to_read"
    TOUCHES_SCATTER = "touches_scatter"
    SAME_ALL_DAY = "same_all_day"

    # what is armed
    MODE_AND_PROBING = "mode_and_probing"
    MODE_WITHOUT_PROBING = "mode_without_probing"


class Severity(StrEnum):
    """How bad it is that something is said."""

    INFORMATION = "information"
    """It goes on as it should, or does so again."""
    NOTICE = "notice"
    """Something waits or differs; nothing is broken."""
    PROBLEM = "problem"
    """Something fails, or its result cannot be used."""


MUST_ACT: Final = frozenset(
    {
        NoticeCode.ARM_ENDS_THAT,
        NoticeCode.BUS_SLOW,
        NoticeCode.CAN_ABSENT,
        NoticeCode.CAN_DOWN,
        NoticeCode.CAN_LEFT_BUS,
        NoticeCode.CERTIFICATE_SPOILT,
        NoticeCode.CLEAN_SPHERE,
        NoticeCode.CLOCK_AND_PAUSE_UNKNOWN,
        NoticeCode.CLOCK_NOT_SET,
        NoticeCode.CLOCK_UNKNOWN,
        NoticeCode.DISK_LOW,
        NoticeCode.DISK_NEARLY_FULL,
        NoticeCode.DRY_RUN_CHANGED,
        NoticeCode.DRY_RUN_NOT_SHOWN,
        NoticeCode.DRY_RUN_OFFERED,
        NoticeCode.DRY_RUN_UNKNOWN,
        NoticeCode.DRY_RUN_WANTED,
        NoticeCode.FILE_ABSENT,
        NoticeCode.FILE_OF_OTHERS,
        NoticeCode.FILE_UNREADABLE,
        NoticeCode.FOLDER_ABSENT,
        NoticeCode.KEY_SPOILT,
        NoticeCode.LINE_SHARED,
        NoticeCode.NC_ALARM,
        NoticeCode.NC_AXES_FROZEN,
        NoticeCode.NC_NOT_SENDABLE,
        NoticeCode.NC_OTHER_MODE,
        NoticeCode.NC_OTHER_OFFSETS,
        NoticeCode.NC_PROBES_ON,
        NoticeCode.NC_VALUES_UNKNOWN,
        NoticeCode.NC_WATCHDOG_SILENT,
        NoticeCode.NC_WATCHDOG_UNHEARD,
        NoticeCode.NOT_RELOADED,
        NoticeCode.OTHER_MASTER,
        NoticeCode.PAIR_SPOILT,
        NoticeCode.PASSWORD_SPOILT,
        NoticeCode.PROCESSOR_SLOW,
        NoticeCode.RELOAD_NEEDS_RESTART,
        NoticeCode.RELOAD_OTHER_INPUTS,
        NoticeCode.SAME_ALL_DAY,
        NoticeCode.SECRET_ABSENT,
        NoticeCode.SENSORS_EXCHANGED,
        NoticeCode.STORE_BEGUN,
        NoticeCode.STORE_BEGUN_LOST,
        NoticeCode.STORE_DELETED,
        NoticeCode.SUPPLY_LOW,
        NoticeCode.TOUCHES_SCATTER,
        NoticeCode.USERS_SPOILT,
        NoticeCode.WAITS_ARM,
        NoticeCode.WAITS_RESUME,
        NoticeCode.WAITS_TIME_SERVER,
    }
)
"""Nothing but a person ends these."""

_PROBLEMS: Final = MUST_ACT - {NoticeCode.WAITS_ARM, NoticeCode.WAITS_RESUME} | {
    NoticeCode.CENTRE_OUTLIER,
    NoticeCode.CENTRE_TOO_FAR,
    NoticeCode.CHANNEL_BAD,
    NoticeCode.CHANNEL_BAD_BECAUSE,
    NoticeCode.DISK_HANGS,
    NoticeCode.FAILED,
    NoticeCode.FIT_POOR,
    NoticeCode.INTERMITTENT,
    NoticeCode.LOADS_NOT_LEARNT,
    NoticeCode.NC_CYCLE_FAILED,
    NoticeCode.NC_NOT_CONNECTED,
    NoticeCode.NC_ONE_SHIFT,
    NoticeCode.NC_SLOW,
    NoticeCode.NO_MORE_KINDS,
    NoticeCode.NOT_COLLECTED,
    NoticeCode.NOT_FINISHED,
    NoticeCode.NOT_PUBLISHED,
    NoticeCode.OFFSETS_MOVED,
    NoticeCode.CYCLE_VOID,
    NoticeCode.PROBING_BLOCKED,
    NoticeCode.REFERENCE_APART,
    NoticeCode.RESULT_ABSURD,
    NoticeCode.RESULT_COUNT,
    NoticeCode.RESULT_NO_POINTS,
    NoticeCode.RESULT_NOT_FINITE,
    NoticeCode.RESULT_SURPRISING,
    NoticeCode.ROWS_REFUSED,
    NoticeCode.SENSOR_OFF,
    NoticeCode.SENSORS_NOT_JUDGED,
    NoticeCode.SENSORS_NOT_LEARNT,
    NoticeCode.STORE_FAILS,
    NoticeCode.STORE_MENDED,
    NoticeCode.STORE_MENDED_LOST,
    NoticeCode.TOUCHES_APART,
    NoticeCode.TRAINING_FAILED,
    NoticeCode.UNEXPECTED,
    NoticeCode.UNEXPECTED_ERROR,
}
_INFORMATION: Final = frozenset(
    {
        NoticeCode.ANSWERS_AGAIN,
        NoticeCode.ARMED_AGAIN,
        NoticeCode.BUS_IN_TIME,
        NoticeCode.CHANNEL_GOOD_AGAIN,
        NoticeCode.CLOCK_RIGHT,
        NoticeCode.CLOCK_RIGHT_AFTER,
        NoticeCode.COLLECTED_AGAIN,
        NoticeCode.DISK_FREE,
        NoticeCode.LOADS_LEARNT,
        NoticeCode.NC_AXES_MOVE,
        NoticeCode.NC_CONNECTED_AGAIN,
        NoticeCode.NC_FOLLOWS_AGAIN,
        NoticeCode.NC_IN_TIME,
        NoticeCode.NC_PROBES_NO_MORE,
        NoticeCode.NC_VALUES_KNOWN,
        NoticeCode.NC_WATCHDOG_HEARD,
        NoticeCode.NO_OTHER_MASTER,
        NoticeCode.OPENED_AGAIN,
        NoticeCode.PROBING_FREE,
        NoticeCode.PUBLISHED_AGAIN,
        NoticeCode.SENSORS_AGREE,
        NoticeCode.SENSORS_JUDGED,
        NoticeCode.SENSORS_LEARNT,
        NoticeCode.STORE_WORKS,
    }
)


def severity_of(code: NoticeCode) -> Severity:
    """How bad it is."""
    if code in _PROBLEMS:
        return Severity.PROBLEM
    return Severity.INFORMATION if code in _INFORMATION else Severity.NOTICE
