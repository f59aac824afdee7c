"""Types of the published messages: one class per kind of key, and its JSON in UTF-8.

A missing number is null. Changes are compatible: fields are added, and new texts in fields that list examples. Readers
ignore unknown fields. `python -m gateway.telemetry docs/telemetry` generates the JSON Schemas in docs/telemetry from
these classes.
"""

from typing import Annotated, Any

from msgspec import Meta, Struct

from drivers.base import Quality
from gateway.model.compensation import Source
from gateway.model.control_state import NcState
from gateway.model.standing import Standing
from gateway.telemetry import keys
from gateway.telemetry.fields import ByError, Coded, GridIndex, Number, OffsetsUm, Reason, Utc, one_of
from talc.kinds import EventKind, Phase


class Message(Struct, frozen=True):
    """The fields with which every payload begins."""

    boot: Annotated[str, Meta(description="Identifies a run of the gateway")]
    seq: Annotated[int, Meta(description="Ascends within a run, over all keys")]
    time: Annotated[Utc, Meta(description="When this was published, UTC")]
    clock: Annotated[str, one_of(("system", "unsynchronised", "simulated"))]


class ReadingMessage(Message, frozen=True):
    """`reading/<channel>`: a channel was read, or went stale because no new value came for three periods."""

    channel: str
    value: Number
    unit: str
    quality: Annotated[str, one_of(Quality)]
    source_time: Utc
    age_s: Annotated[float, Meta(description="How long ago the value was taken when this was published", ge=0.0)]
    sequence: Annotated[int, Meta(description="The same for all channels of one read; none occurs twice in a boot")]
    detail: Annotated[str, Meta(description="Why the quality is not good")]
    detail_coded: Coded | None = None


class FrameMessage(Message, frozen=True):
    """`frame`: the inputs of one grid step."""

    k: GridIndex
    inputs: Annotated[dict[str, Number], Meta(description="By name; null without a good value")]
    measured: ByError | None


class DecisionMessage(Message, frozen=True):
    """`decision`: what the controller decided on one frame."""

    k: GridIndex
    phase: Annotated[str, one_of(Phase)]
    predicted: ByError
    corrected: ByError
    sigma: ByError
    limits: ByError
    measure: Annotated[Reason | None, Meta(description="Why a measurement is wanted; null: none is")]
    training: Annotated[Reason | None, Meta(description="Why a training is wanted; null: none is")]
    substituted: Annotated[
        tuple[str, ...], Meta(description="Inputs of models without a good value, replaced by their last good value")
    ]
    trusted: Annotated[
        dict[str, bool],
        Meta(description="By thermal error; false: not corrected, as its estimate is no better than no correction"),
    ] = {}


class MeasurementMessage(Message, frozen=True):
    """`measurement`: how a requested measurement ended; without errors if it was refused, failed or rejected."""

    number: int
    why: Reason
    asked: Utc
    ended: Utc
    errors: ByError | None
    sigma: ByError | None
    residual_um: Annotated[Number, Meta(description="RMS of what the nine errors do not explain")]
    in_force_um: Annotated[
        list[float | list[float]], Meta(description="Compensation in force during the cycle: X, Y, Z, or these by pose")
    ]
    reason: Annotated[str, Meta(description="Why there are no errors")]
    reason_coded: Coded | None = None


class ModelMessage(Message, frozen=True):
    """`model/<error>`: the model that predicts this error from the step after `after_k` on."""

    error: str
    after_k: GridIndex
    inputs: tuple[str, ...]
    poles: Annotated[list[Number], Meta(description="Magnitudes")]
    static_gain: Annotated[list[Number], Meta(description="By input")]
    limit: Annotated[Number, Meta(description="Action control limit, µm or µm/m")]
    residual_std: Number
    criterion: Number


class EventMessage(Message, frozen=True):
    """`event`: the controller or the service reports something in words."""

    k: GridIndex | None
    kind: Annotated[str, one_of(EventKind)]
    text: str
    error: Annotated[str | None, Meta(description="Thermal error that it concerns")]
    value: Number
    limit: Number
    code: Annotated[str, Meta(description="What the text says; empty: only words")] = ""
    values: Annotated[
        dict[str, Any], Meta(description="What belongs to the code; of a problem also its `subject`")
    ] = {}


class CompensationMessage(Message, frozen=True):
    """`compensation`: one step of the compensation; not published in mode monitor."""

    k: Annotated[GridIndex | None, Meta(description="Grid index of the decision that was used")]
    mode: Annotated[str, one_of(("advise", "compensate"))]
    source: Annotated[str, one_of(Source)]
    target_um: OffsetsUm
    offsets_um: OffsetsUm
    coefficients_um: Annotated[tuple[tuple[float, ...], ...], Meta(description="Rows X, Y, Z")]
    bounded: Annotated[tuple[bool, bool, bool], Meta(description="Axes that were limited by the bound")]
    positions: Annotated[dict[str, Number], Meta(description="X, Y, Z in mm; A, C in degrees")]
    written: bool
    read_back_um: OffsetsUm | None


class ProbingStanding(Struct, frozen=True):
    """State of a wanted measurement."""

    standing: Annotated[str, one_of(Standing)]
    why: Reason | None
    reason: Annotated[str, Meta(description="Why no measurement is requested yet")]
    rejected: Annotated[int, Meta(description="Results rejected in a row")]
    operator: Annotated[str, Meta(description="What an operator should know or do")]
    reason_coded: Coded | None = None
    operator_coded: Coded | None = None


class ProbingMessage(Message, frozen=True):
    """`probing`: the state of a wanted measurement, when it changes. Fields as in ProbingStanding."""

    standing: Annotated[str, one_of(Standing)]
    why: Reason | None
    reason: str
    rejected: int
    operator: str
    reason_coded: Coded | None = None
    operator_coded: Coded | None = None


class SensorFinding(Struct, frozen=True):
    """An input with an offset, or two exchanged inputs."""

    kind: Annotated[str, one_of(("offset", "swap"))]
    inputs: tuple[str, ...]
    alternatives: Annotated[tuple[str, ...], Meta(description="Other inputs that would explain it equally well")]
    offset_K: Number  # noqa: N815
    score: Annotated[Number, Meta(description="1 is just enough evidence")]
    text: str
    since_k: Annotated[
        GridIndex | None, Meta(description="Of the first comparison of this run since which it has been found")
    ] = None


class SensorsMessage(Message, frozen=True):
    """`sensors`: how well the sensors agree with each other, every hour."""

    k: GridIndex
    findings: tuple[SensorFinding, ...]
    smallest_offset_K: Annotated[  # noqa: N815
        dict[str, Number], Meta(description="By input: the offset that this window would have shown")
    ]
    alike: Annotated[
        tuple[tuple[str, str], ...],
        Meta(description="Inputs that could be exchanged unnoticed in this window"),
    ]
    loads: Annotated[
        tuple[str, ...],
        Meta(description="Loads from which the inputs were predicted, beside each other"),
    ] = ()


class StorageStanding(Struct, frozen=True):
    """The state of storing."""

    problem: Annotated[str, Meta(description="Why rows wait in memory; empty: everything is stored")]
    waiting: Annotated[int, Meta(description="Rows that wait in memory")]
    dropped: Annotated[
        int, Meta(description="Rows dropped because too many waited: raw readings, steps, events; never decisions")
    ]
    free_mb: Annotated[Number, Meta(description="Free space on the disk, MB")]
    oldest_s: Annotated[Number, Meta(description="How long the oldest row has waited, s; null: none waits")] = None
    problem_coded: Coded | None = None


class PublishedReason(Struct, frozen=True):
    """Why one thermal error is corrected as it is; µm or µm/m."""

    estimate: Annotated[Number, Meta(description="The sum of inputs, other_inputs and level")]
    trusted: bool
    believed: Annotated[Number, Meta(description="Probability that the error is not just zero")]
    inputs: Annotated[dict[str, Number], Meta(description="Which inputs move it now, the largest first")]
    other_inputs: Annotated[Number, Meta(description="What all other inputs together do")]
    level: Annotated[Number, Meta(description="What no input explains")]
    experts: Annotated[dict[str, Number], Meta(description="Weight, by kind of expert")]
    expected: Annotated[Number, Meta(description="At the next measurement, if the inputs stay as they are")]
    expected_sigma: Annotated[Number, Meta(description="Its standard uncertainty, without the measurement's noise")]


class ReasonsMessage(Message, frozen=True):
    """`reasons`: why the learner corrects as it does, after each measurement and each hour."""

    k: GridIndex
    next_k: Annotated[GridIndex, Meta(description="When the next measurement is expected, if inputs stay as they are")]
    next_why: Reason
    errors: Annotated[dict[str, PublishedReason], Meta(description="By thermal error")]


class PublishedCourse(Struct, frozen=True):
    """One thermal error at the times ahead; µm or µm/m."""

    value: list[Number]
    sigma: list[Number]


class ForecastMessage(Message, frozen=True):
    """`forecast`: what becomes of the learner's estimates, after each step. Each list has one number for each of
    `ahead_s`."""

    k: GridIndex
    ahead_s: Annotated[tuple[float, ...], Meta(description="How far ahead, s")]
    stays: Annotated[dict[str, PublishedCourse], Meta(description="By thermal error: if the inputs stay as they are")]
    usual: Annotated[
        dict[str, PublishedCourse], Meta(description="If the inputs have their mean of two weeks from now on")
    ]
    measured: Annotated[
        dict[str, list[Number]], Meta(description="Sigma if the inputs stay and the machine is measured now")
    ]
    missed: Annotated[
        dict[str, PublishedCourse],
        Meta(description="Root mean square by which `stays` has been off so far; null: not known yet"),
    ]
    planned: Annotated[
        dict[str, dict[str, PublishedCourse]],
        Meta(
            description="By planned load of the configuration, then by thermal error: if it runs from now on; empty: "
            "it is not known yet what this load does"
        ),
    ] = {}


class PauseStanding(Struct, frozen=True):
    """A command that holds until another one ends it."""

    by: Annotated[str, Meta(description="Who gave the command")]
    since: Utc


class StatusMessage(Message, frozen=True):
    """`status`: the latest decision and how the gateway runs, at least every 10 s. `phase` and `k` are null before the
    first decision; `uptime_s` to `clock_synchronised` until the health was looked at for the first time."""

    phase: Annotated[str | None, one_of(Phase)]
    k: GridIndex | None
    readings_dropped: Annotated[int, Meta(description="Readings not published because the network was too slow")]
    periods_missed: Annotated[
        dict[str, int], Meta(description="By bus: periods without a read because the previous one took too long")
    ]
    config: Annotated[str | None, Meta(description="SHA-256 of the configuration in use")]
    probing: ProbingStanding | None
    storage: StorageStanding | None = None
    messages_dropped: Annotated[
        int, Meta(description="Frames, decisions, measurements, models, events and probing states not published")
    ] = 0
    unarmed: Annotated[tuple[str, ...], Meta(description="What is off in the configuration, and what follows")] = ()
    version: Annotated[str, Meta(description="Of the gateway's program")] = ""
    key_space: Annotated[int, Meta(description="Version of the key space")] = keys.VERSION
    uptime_s: Annotated[Number, Meta(description="Since the service began to run")] = None
    channels: Annotated[int | None, Meta(description="Channels of the configuration")] = None
    channels_good: Annotated[int | None, Meta(description="Of these, how many have a good value now")] = None
    nc: Annotated[str | None, one_of(NcState, "The control")] = None
    clock_synchronised: Annotated[
        bool | None, Meta(description="Whether a time server keeps the computer's clock; null: unknown, or simulated")
    ] = None
    waits_for: Annotated[tuple[str, ...], Meta(description="What must happen before it learns and corrects fully")] = ()
    certificates: Annotated[dict[str, Utc], Meta(description="By field of the configuration: when it ends")] = {}
    paused: Annotated[
        PauseStanding | None, Meta(description="The compensation is paused by a command; null: it is not")
    ] = None
    disarmed: Annotated[
        PauseStanding | None, Meta(description="The gateway is disarmed by a command; null: it is not")
    ] = None
    commands: Annotated[bool, Meta(description="Whether the configuration allows anybody to give commands")] = False
    planned_loads: Annotated[
        tuple[str, ...], Meta(description="Names of the planned loads of which each `forecast` tells")
    ] = ()
    unarmed_coded: Annotated[tuple[Coded | None, ...], Meta(description="Of each in `unarmed`")] = ()
    waits_for_coded: Annotated[tuple[Coded | None, ...], Meta(description="Of each in `waits_for`")] = ()
    kinematics: Annotated[str, Meta(description="Axes from the workpiece to the tool; ' is on the table's side")] = ""
    sphere_mm: Annotated[
        tuple[float, float] | None,
        Meta(description="[probing]: the sphere's radius and height"),
    ] = None
    when_stale: Annotated[
        str | None,
        Meta(description="[compensation]: what the control does with the offsets without a gateway, `zero` or `hold`"),
    ] = None
    answers_s: Annotated[
        dict[str, dict[str, float]],
        Meta(description="By bus and unit: how long the answer to its slowest request usually takes"),
    ] = {}


Published = (
    ReadingMessage
    | FrameMessage
    | DecisionMessage
    | MeasurementMessage
    | ModelMessage
    | EventMessage
    | CompensationMessage
    | ProbingMessage
    | SensorsMessage
    | ReasonsMessage
    | ForecastMessage
    | StatusMessage
)
