"""The sections of a gateway's configuration, apart from its buses."""

from collections.abc import Mapping
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from drivers.section import FilePath, NotNegative, Positive, Section, beside_the_file, wrong
from drivers.text import shown
from gateway.config.fields import LARGEST_BOUND_UM, MOST_POSES, Name, ProfileName
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from talc.chain import chain_of
from talc.kinematics import CHAIN
from talc.settings import TalcSettings

_Angle = Annotated[float, Field(ge=-720, le=720)]
"""Of a rotary axis, degrees: no pose needs more than two turns."""
_Length = Annotated[float, Field(ge=-1e5, le=1e5)]


def _rising(side: tuple[float, float]) -> tuple[float, float]:
    if not side[0] < side[1]:
        raise ValueError(Text(NoticeCode.LIMITS_REVERSED, min=side[0], max=side[1]))
    return side


_Side = Annotated[tuple[_Length, _Length], AfterValidator(_rising)]
_Turn = Annotated[tuple[_Angle, _Angle], AfterValidator(_rising)]


class LinearAxis(Section):
    """A linear axis, for `talc-gateway nc poses`."""

    travel_mm: _Side | None = None
    """Least and largest position of the probe's tip. None: no pose is left out for it."""
    feedback: Literal["screw", "scale"] = "screw"
    """Where its position is measured. `screw`: by the motor, so that a warm ball screw makes a scale error. `scale`: at
    the slide, where there is none to speak of."""
    fixed_mm: _Length = 0.0
    """Position at which a warm screw moves nothing, by the probe's tip: that of its fixed bearing."""


class RotaryAxis(Section):
    """A rotary axis, for `talc-gateway nc poses`."""

    travel_deg: _Turn | None = None
    """Least and largest angle. None: A and B turn from -90 to 90, C from 0 to 360."""
    origin_mm: tuple[_Length, _Length, _Length] = (0.0, 0.0, 0.0)
    """A point of the axis with all rotary axes at 0. Of the table: a position X, Y, Z at which the probe's tip is on
    the axis. Of the head: how far the axis is from the probe's tip."""
    sense: Literal[1, -1] = 1
    """1: a positive angle turns table or head by the right-hand rule about the axis' direction; -1: against it."""


def _chain(text: str) -> str:
    try:
        return str(chain_of(text))
    except ValueError:
        raise ValueError(Text(NoticeCode.CHAIN_FORM, value=shown(text))) from None


class MachineSection(Section):
    """The machine tool that this gateway serves."""

    name: Name
    """Name of the machine; the second part of every published key."""
    kind: Name | None = None
    """Kind of machine, the same text on machines that are built alike: `talc-gateway prior make` passes on what they
    learnt within one kind."""
    chain: Annotated[str, AfterValidator(_chain)] = CHAIN
    """Order of the axes from the workpiece w over the bed b to the tool t (ISO 10791-1), such as `w X' Y' b Z S t`: '
    marks axes that move the workpiece. Only the default is probed and compensated; for any other one `nc poses` says
    what could be known, and the gateway reads sensors."""
    work_mm: tuple[_Side, _Side, _Side] = ((-200.0, 200.0), (-200.0, 200.0), (0.0, 200.0))
    """X, Y, Z of the work space in the positions of the probe's tip, with all rotary axes at 0."""
    linear: Mapping[Literal["X", "Y", "Z"], LinearAxis] = Field(default_factory=dict)
    rotary: Mapping[Literal["A", "B", "C"], RotaryAxis] = Field(default_factory=dict)

    @property
    def corrected(self) -> bool:
        """Whether its thermal errors can be measured and compensated: the default chain, whose axes A and C meet."""
        plain = all(axis.sense == 1 and not any(axis.origin_mm) for axis in self.rotary.values())
        return plain and self.chain == CHAIN

    @model_validator(mode="after")
    def _of_the_chain(self) -> "MachineSection":
        axes = chain_of(self.chain).rotary
        if other := [axis for axis in self.rotary if axis not in axes]:
            raise wrong(Text(NoticeCode.AXIS_NOT_IN_CHAIN, axis=other[0], chain=self.chain), "rotary", other[0])
        return self


class Grid(Section):
    """The common time base of models and control."""

    step_s: Positive = 300.0
    """Grid step in seconds (5 min). Frame k covers the step that ends at UTC = k · step_s."""


DEFAULT_DATABASE = "gateway.sqlite"
KeptDays = Annotated[float, Field(gt=0, le=36_500)]


class Storage(Section):
    """What is stored on the computer."""

    path: FilePath = Path(DEFAULT_DATABASE)
    """SQLite database; a relative path starts at the configuration's folder."""
    keep_samples_days: KeptDays = 7.0
    """After this many days of running, raw readings are thinned to minute statistics, and compensation steps and
    reasons are deleted; 30 channels at 1 Hz take about 95 MB a day. Frames and decisions (0.2 MB a day), measurements,
    models and events are kept."""
    keep_minutes_days: KeptDays = 400.0
    """After this many days of running, the minute statistics are deleted; 30 channels take about 2 MB a day."""
    most_mb: Positive = 4000.0
    """When the database is larger than this, the oldest readings are thinned early, and then the oldest minute
    statistics are deleted."""
    commit_s: Annotated[float, Field(gt=0, le=3600)] = 20.0
    """Readings are committed at least this often (real time): a power cut loses no more."""
    compensate_unstored: bool = False
    """What the compensation does while nothing can be stored, such as on a full disk. False: it goes to its declared
    state, [compensation] when_stale, until rows are stored again. True: it continues, and its steps wait in memory."""
    unstored_after_s: Positive = 60.0
    """When nothing could be stored for this time (real time), `compensate_unstored` applies; until then rows wait in
    memory."""
    warn_free_mb: NotNegative = 500.0
    """Less free space on the database's disk is reported as a problem."""


class Device(Section):
    """One device on a bus."""

    name: Name
    """Name of the device in messages."""
    bus: str
    """Name of its bus."""
    profile: ProfileName
    """Profile with the addresses of its values: one of drivers/profiles, or the path of a .toml file."""
    unit: int = Field(default=1, ge=0, le=0xFFFF)
    """Address on its bus: Modbus unit 1 to 247 (Modbus TCP: 0 to 255), CANopen node 1 to 127, sensor on `me_rs485` 2 to
    126. Devices on other kinds of bus have no address: leave it out; it means nothing there."""
    options: Mapping[str, str | int | float | bool] = Field(default_factory=dict)
    """Options that its profile leaves open, such as the vendor or the range."""
    channels: Mapping[Name, int] = Field(min_length=1)
    """Model input = the device's channel, counted from 0. The order in the file is the order of the inputs."""


class State(Section):
    """One machine state, read from the NC: an input of the models, or the stated tolerance."""

    name: Name
    """Name under which the NC driver reports it."""
    use: Literal["input", "tolerance"] = "input"
    """`input`: models may use it. `tolerance`: it is the tolerance that the part program states for what it machines
    next, µm, which `[talc.learner] limit_um` follows; 0: none. It is no input."""


class PlannedLoad(Section):
    """One load that a person may plan, such as a warm-up or a job.

    The forecast then also says how the errors change if this load runs from now on, and the page shows it.
    """

    name: Annotated[str, Field(min_length=1, max_length=40)]
    """What the page calls it, such as `warm-up` or `roughing, 8 h`."""
    loads: Mapping[Name, float]
    """Loads to their mean while it runs, in the input's unit: machine states (`spindle_speed`, in 1/min) or channels
    (a drive's power). Loads that are not named stay as they are."""

    @field_validator("loads")
    @classmethod
    def _some(cls, loads: Mapping[str, float]) -> Mapping[str, float]:
        if not loads:
            raise ValueError(Text(NoticeCode.NO_LOAD))
        return loads


class Instrument(Section):
    """What the measurements depend on, for the report: the machine, the touch probe, the sphere, sensors."""

    what: Annotated[str, Field(min_length=1, max_length=60)]
    """Such as `touch probe`, or names of channels."""
    serial: Annotated[str, Field(min_length=1, max_length=60)]
    """Its serial number, as it is written on it."""
    calibrated: date | None = None
    """When it was calibrated last."""
    due: date | None = None
    """When it is to be calibrated again."""


class Limits(Section):
    """Plausible values of one channel. An implausible value keeps its number and loses its quality."""

    min: float | None = None
    """Smallest plausible value, in the channel's unit; below it the quality is `out_of_range`."""
    max: float | None = None
    """Largest plausible value, in the channel's unit; above it the quality is `out_of_range`."""
    max_jump: Positive | None = None
    """Largest plausible difference between one measurement and the next, in the channel's unit. Beyond it the quality
    of that one is `out_of_range`; if the next one agrees with it, it was a step and not a spike, and is used."""
    max_rate_per_min: Positive | None = None
    """Largest plausible change within a minute, in the channel's unit. After a larger one (a spike, a step) the quality
    is `out_of_range` until enough time has passed since the last plausible value for the change to be plausible."""
    stuck_after_s: Positive | None = None
    """A value that has not changed at all for this long is `stale`. Consider the sensor's resolution."""

    @model_validator(mode="after")
    def _in_order(self) -> "Limits":
        if self.min is not None and self.max is not None and self.min >= self.max:
            raise wrong(Text(NoticeCode.LIMITS_REVERSED, min=self.min, max=self.max), "min")
        return self


class Probing(Section):
    """The probing cycle: poses of the rotary axes, one sphere."""

    armed: bool = False
    """Whether the gateway may request cycles from the NC. False: no cycle is requested, and nothing is learnt."""
    dry_run: Literal["required", "not offered"] = "required"
    """`required`: no cycle is requested before `talc-gateway nc dry-run` has gone well with this control, these poses
    and this sphere, or such a cycle has measured before. `not offered`: for a control without dry runs, whose cycle was
    driven by hand."""
    poses_deg: tuple[tuple[_Angle, _Angle], ...] = Field(
        default=((0, 0), (0, 90), (0, 180), (0, 270), (90, 0), (-90, 0)), min_length=3, max_length=MOST_POSES
    )
    """A and C of each pose, degrees. Together they must determine all nine errors."""
    sphere_radius_mm: Annotated[Positive, Field(ge=1)] = 120.0
    """Distance of the sphere's centre from the C axis."""
    sphere_height_mm: float = 80.0
    """Height of the sphere's centre above the A axis at A = 0."""
    sigma_um: Positive = 1.0
    """Standard uncertainty of one coordinate of a measured centre."""
    max_repeat_um: Positive = 10.0
    """A cycle in which repeated touches of one point differ by more than this is rejected; so is a reference whose
    cycles differ by more."""
    max_residual_um: Positive = 5.0
    """A cycle whose centres differ from the best fit by more than this (RMS) is rejected."""
    outlier_sigmas: Positive = 6.0
    """A cycle is rejected if a coordinate differs from the others' prediction by more than this many standard
    deviations."""
    surprise_sigmas: Positive = 6.0
    """A result that differs from the prediction by more than this many standard uncertainties of both, and by more than
    the action control limit, is used only when the next cycle gives the same result."""
    max_surprise_um: Positive = 50.0
    """A result that differs by more than this, at the sphere, is never used, except where the prediction is itself so
    uncertain that this is plausible."""
    reference_cycles: Annotated[int, Field(ge=1, le=20)] = 5
    """Number of cycles whose mean is the reference of every later deviation; they run one after the other at the first
    measurement. One cycle's noise would stay in every error as a constant; the mean of n cycles leaves 1/√n of it."""
    lead_s: NotNegative = 180.0
    """How long before the end of the grid step the cycle is requested, so that the step contains its result. At
    most the grid step, once `armed`."""
    timeout_s: Positive = 900.0
    """A cycle that has not begun within this time, or not ended within as long after it began, is withdrawn."""
    poll_s: Positive = 2.0
    """How often the NC's state is read while a cycle runs, or while a measurement waits for a better moment."""
    prefer_idle_s: NotNegative = 600.0
    """A routine measurement waits this long for an idle machine or the end of a program; after that a tool change is
    enough. Measurements in calibration, in `no_good` and repeats do not wait."""
    insist_after_s: NotNegative = 1800.0
    """After this time the cycle is requested whatever the machine is doing, and the operator is informed. The control
    still probes at a safe point only. A new reference still waits until no program runs."""
    urgent_excess: Annotated[float, Field(ge=1)] = 2.0
    """A measurement does not wait for a better moment while the uncertainty of an estimate (95 %) is more than this
    many times as large as its action control limit, as on a machine that is new to the gateway and warms up. The
    operator is not informed."""
    retries: Annotated[int, Field(ge=0, le=20)] = 3
    """A rejected measurement is requested again at most this many times in a row; then the operator is informed."""
    pause_s: NotNegative = 3600.0
    """Pause after that, in which nothing is requested."""


Bound = Annotated[float, Field(gt=0, le=LARGEST_BOUND_UM)]


class Compensation(Section):
    """What is sent to the NC."""

    mode: Literal["monitor", "advise", "compensate"] = "monitor"
    """`monitor` computes and stores, `advise` also publishes, `compensate` also writes to the NC."""
    bound_um: tuple[Bound, Bound, Bound] = (50.0, 50.0, 50.0)
    """Largest offset in X, Y, Z; an axis that needs more is corrected by this much (docs/arming.md)."""
    slew_um_per_s: Positive = 1.0
    """Fastest change of an offset."""
    stale_after_s: Positive = 900.0
    """A prediction older than this is no longer used. With an `[nc]`, more than the grid step."""
    inputs_stale_after_s: Positive = 1800.0
    """How long an input of a live model may be without a good value; meanwhile the learner estimates it from the
    others, and trained models use its last good value."""
    measurement_stale_after_s: Positive = 57600.0
    """How long an error without a model is corrected by its last measurement; after that the error is unknown, and
    `when_stale` decides. The default is four times the learner's longest interval."""
    when_stale: Literal["zero", "hold"] = "zero"
    """Without a usable prediction: ramp the offsets to zero, or hold the last ones."""
    frozen_after_s: Positive = 120.0
    """An axis that reports a speed but has not moved for this long shows that the control's values are frozen: they are
    then treated as stale. Needs the speeds as `[[state]]` and a [nc] period_s of at most a quarter of this."""
    watchdog_s: Positive = 10.0
    """When the control has received no heartbeat for this long, it does by itself what `when_stale` says. At least four
    times [nc] period_s."""


def _with_path(talc: TalcSettings, info: ValidationInfo) -> TalcSettings:
    return talc if talc.prior is None else replace(talc, prior=str(beside_the_file(Path(talc.prior), info)))


Talc = Annotated[TalcSettings, AfterValidator(_with_path)]
"""`[talc]`; a relative path in it starts at the file's folder."""
