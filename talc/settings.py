"""Settings of TALC, with the papers' defaults. SettingError names an invalid field."""

from dataclasses import dataclass, field
from typing import Literal

_LEAST_MEASUREMENTS = 12
"""In a calibration."""


class SettingError(ValueError):
    """A field has a value that it cannot have."""

    def __init__(self, field_name: str, value: object, expected: str) -> None:
        super().__init__(f"{field_name} = {value!r}: expected {expected}")
        self.field, self.value, self.expected = field_name, value, expected


def require(condition: bool, field_name: str, value: object, expected: str) -> None:
    """Raises SettingError unless the condition holds."""
    if not condition:
        raise SettingError(field_name, value, expected)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingSettings:
    """How models are found from a record (Z22 §2, eq. 1-9)."""

    selector: Literal["search", "pso", "tck"] = "search"
    """`search`: output-error models by a deterministic search. The papers' methods give ARX models: `pso`, a particle
    swarm over the Group-LASSO (Z22), and `tck`, sensor by sensor with the Time Series Cluster Kernel."""
    judged_by: Literal["unseen", "seen"] = "unseen"
    """What `search` minimises: a BIC of the residuals on blocks of rows left out of the fit, or on all rows."""
    criterion: Literal["adapted_bic", "bic", "aic", "mdl"] = "adapted_bic"
    """What `pso` minimises, of the free run's residuals (Z22 eq. 9)."""
    estimator: Literal["least_squares", "guarded", "refined"] = "guarded"
    """How `pso` and `tck` fit their choice: one-step least squares (Z22 eq. 5); the same under constraints on poles and
    gains; or the free run itself, starting from there."""
    seed: int = 0
    """Seed of the swarm and of the kernel's ensemble. `search` uses no random numbers."""
    max_na: int = 1
    """Largest autoregressive order; 0: static and FIR models only. `search` takes up to 3 poles, the others up to 5
    (Z22)."""
    max_nb: int = 5
    """Largest input order, found for each input by itself; order + 1 coefficients (Z22: up to 5)."""
    max_inputs: int = 8
    """Largest number of inputs in one model."""
    tolerance_um: float = 5.0
    """T of the adapted BIC (Z22 eq. 9) for position errors, µm (B19: 5)."""
    tolerance_um_per_m: float = 15.0
    """T of the adapted BIC for orientation errors, µm/m (B19: 15)."""
    safety: float = 0.75
    """ST of the adapted BIC (Z22 eq. 9)."""
    static_inputs: bool = False
    """Keep the first model's inputs; renew only orders and parameters (Z22 'static inputs')."""
    window_steps: int | None = None
    """Train on this many of the latest grid steps; None: on all data since the start."""
    max_pole: float = 0.999
    """A model with a pole of this magnitude or more never goes live."""

    @property
    def keeps_estimates(self) -> bool:
        """Whether outputs that were not measured are those that the live models estimated: of ARX models that keep
        their inputs."""
        return self.selector != "search" and self.static_inputs

    def __post_init__(self) -> None:
        highest = 3 if self.selector == "search" else 5
        require(0 <= self.max_na <= highest, "max_na", self.max_na, f"0 to {highest} with selector {self.selector!r}")
        require(0 <= self.max_nb <= 5, "max_nb", self.max_nb, "0 to 5")
        require(self.max_inputs >= 1, "max_inputs", self.max_inputs, "1 or more")
        require(self.tolerance_um > 0, "tolerance_um", self.tolerance_um, "more than 0")
        require(self.tolerance_um_per_m > 0, "tolerance_um_per_m", self.tolerance_um_per_m, "more than 0")
        require(0 < self.safety <= 1, "safety", self.safety, "more than 0, at most 1")
        require(0 < self.max_pole < 1, "max_pole", self.max_pole, "between 0 and 1")
        require(
            self.window_steps is None or self.window_steps >= 12,
            "window_steps",
            self.window_steps,
            "12 or more",
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlSettings:
    """When to measure and when to learn (Z22 §2-3, Table 2; B19 §2-3). Counts are grid steps."""

    calibration_steps: int = 288
    """Length of the calibration phase (24 h at 5 min)."""
    calibration_interval_steps: int = 1
    """Steps between its measurements (Z22: every step). A longer calibration that is measured less often sees more of
    what the machine does with fewer probing cycles (docs/plant.md, `parameters`)."""
    policy: Literal["fixed", "novelty", "uncertainty"] = "fixed"
    """When to measure in compensation: at a fixed interval; when the inputs leave the range of the training data; or
    when the 95 % interval of a prediction fills its share of the action control limit. The last two keep within the
    bounds below."""
    measurement_interval_steps: int = 24
    """Steps between measurements of the fixed policy (B19: 2 h best)."""
    shortest_interval_steps: int = 6
    """The other policies measure at most this often."""
    longest_interval_steps: int = 96
    """The other policies measure at least this often (8 h)."""
    uncertainty_share: float = 0.75
    """Share of the action control limit that a 95 % interval may fill."""
    no_good_measurements: int = 16
    """Measurements in the no-good phase, before the model update (Z22: 16)."""
    no_good_interval_steps: int = 1
    """Steps between them (B19: 10 min)."""
    update_interval_steps: int | None = None
    """Also learn in compensation, at every grid step that is a multiple of this (B19 varies 8 to 96 h and 192 h); None:
    only after a residual beyond its limit."""
    acl: Literal["adaptive", "training", "fixed"] = "adaptive"
    """Action control limits, renewed with each model: its largest residual on rows that its fit has not seen, its
    largest on all rows of its training (Z22), or the fixed values below (B19)."""
    acl_fixed_um: float = 5.0
    """Fixed limit for position errors, µm (B19)."""
    acl_fixed_um_per_m: float = 15.0
    """Fixed limit for orientation errors, µm/m (B19)."""

    def __post_init__(self) -> None:
        every = self.calibration_interval_steps
        require(every >= 1, "calibration_interval_steps", every, "1 or more")
        least = _LEAST_MEASUREMENTS * every
        expected = f"{_LEAST_MEASUREMENTS} or more" if every == 1 else f"{least} or more, 12 measurements {every} apart"
        require(self.calibration_steps >= least, "calibration_steps", self.calibration_steps, expected)
        require(
            self.measurement_interval_steps >= 1,
            "measurement_interval_steps",
            self.measurement_interval_steps,
            "1 or more",
        )
        require(
            1 <= self.shortest_interval_steps <= self.longest_interval_steps,
            "shortest_interval_steps",
            self.shortest_interval_steps,
            f"1 to {self.longest_interval_steps}, longest_interval_steps",
        )
        require(self.uncertainty_share > 0, "uncertainty_share", self.uncertainty_share, "more than 0")
        require(self.no_good_measurements >= 1, "no_good_measurements", self.no_good_measurements, "1 or more")
        require(self.no_good_interval_steps >= 1, "no_good_interval_steps", self.no_good_interval_steps, "1 or more")
        update = self.update_interval_steps
        require(update is None or update >= 1, "update_interval_steps", update, "1 or more")
        require(self.acl_fixed_um > 0, "acl_fixed_um", self.acl_fixed_um, "more than 0")
        require(self.acl_fixed_um_per_m > 0, "acl_fixed_um_per_m", self.acl_fixed_um_per_m, "more than 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorCheckSettings:
    """Whether the temperatures still agree with each other as they did during learning."""

    enabled: bool = True
    """Look for offsets and exchanged sensors."""
    window_steps: int = 96
    """Number of grid steps that are judged together (8 h at 5 min)."""
    learn_steps: int = 8640
    """Largest number of grid steps to learn from (30 days at 5 min)."""
    false_alarms_per_year: float = 1.0
    """False alarms of each kind that the thresholds allow for, all inputs together, while loads are as learnt."""

    def __post_init__(self) -> None:
        require(self.window_steps >= 12, "window_steps", self.window_steps, "12 or more")
        shortest = 3 * self.window_steps
        require(self.learn_steps >= shortest, "learn_steps", self.learn_steps, f"{shortest} or more, three windows")
        require(self.false_alarms_per_year > 0, "false_alarms_per_year", self.false_alarms_per_year, "more than 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnerSettings:
    """The learner's choices. An operator needs to set only the two limits. Counts are grid steps."""

    limit_um: float = 5.0
    """A measurement is wanted when the 95 % interval of a position error is wider than this to either side, µm."""
    limit_um_per_m: float = 15.0
    """The same for orientation errors, µm/m."""
    least_limit_um: float | None = None
    """With this and `most_limit_um` the limits follow the tolerance that the part program states for what it machines
    next (docs/control.md): `limit_um` is that tolerance, but not less than this, µm, and `limit_um_per_m` changes in
    proportion. Without, they stay as they are."""
    most_limit_um: float | None = None
    """Nor more than this, µm."""
    policy: Literal["uncertainty", "fixed"] = "uncertainty"
    """When to measure: by the limits above, within the two bounds below; or at a fixed interval."""
    shortest_interval_steps: int = 4
    """It measures at most this often, but for the first measurement after the reference."""
    longest_interval_steps: int = 48
    """It measures at least this often."""
    measurement_interval_steps: int = 24
    """Steps between measurements of the fixed policy."""
    no_good_measurements: int = 0
    """Measurements at every step after a residual above its limit; 0: the learner needs none."""
    noise_um: float = 1.0
    """Standard uncertainty of a measured position error that is reported without one, µm."""
    noise_um_per_m: float = 3.0
    """The same for an orientation error, µm/m."""

    def __post_init__(self) -> None:
        for name in ("limit_um", "limit_um_per_m", "noise_um", "noise_um_per_m"):
            require(getattr(self, name) > 0, name, getattr(self, name), "more than 0")
        least, most = self.least_limit_um, self.most_limit_um
        if (least is None) != (most is None):
            missing = "least_limit_um" if least is None else "most_limit_um"
            require(False, missing, None, "a number: limits follow a stated tolerance between both bounds")
        if least is not None and most is not None:
            expected = f"more than 0, at most limit_um = {self.limit_um:g}"
            require(0 < least <= self.limit_um, "least_limit_um", least, expected)
            require(most >= self.limit_um, "most_limit_um", most, f"limit_um = {self.limit_um:g} or more")
        require(
            1 <= self.shortest_interval_steps <= self.longest_interval_steps,
            "shortest_interval_steps",
            self.shortest_interval_steps,
            f"1 to {self.longest_interval_steps}, longest_interval_steps",
        )
        interval = self.measurement_interval_steps
        require(interval >= 1, "measurement_interval_steps", interval, "1 or more")
        require(self.no_good_measurements >= 0, "no_good_measurements", self.no_good_measurements, "0 or more")


@dataclass(frozen=True, slots=True, kw_only=True)
class TalcSettings:
    """The `[talc]` section of a gateway's configuration."""

    preset: Literal["zimmermann-2022", "blaser-2019"] | None = None
    """In a configuration: a paper's complete system, unless another key says otherwise (docs/method.md). In a program:
    `talc.presets.preset`; this field alone changes nothing."""
    exact: bool = False
    """In a configuration, with `preset`: least squares as printed (Z22 eq. 5), which ran away by more than 10 mm on a
    machine's recording; otherwise the same under constraints on poles and gains. In a program: an argument of
    `talc.presets.preset`; this field alone changes nothing."""
    method: Literal["learner", "models"] = "learner"
    """`learner`: weights of lagged inputs, learnt at every measurement. `models`: the papers' system of phases and
    trained models, by `training.selector`; `control` and `training` apply only to it."""
    prior: str | None = None
    """In a configuration: a file of `talc-gateway prior make` with what other machines of the same kind have learnt;
    the learner starts with it (docs/control.md). A relative path starts at the configuration's folder. In a program: an
    argument of `talc.control.Controller`; this field alone changes nothing."""
    learner: LearnerSettings = field(default_factory=LearnerSettings)
    control: ControlSettings = field(default_factory=ControlSettings)
    training: TrainingSettings = field(default_factory=TrainingSettings)

    def __post_init__(self) -> None:
        require(
            not self.exact or self.preset is not None,
            "exact",
            self.exact,
            "false without a preset: it changes a preset",
        )
        window, calibration = self.training.window_steps, self.control.calibration_steps
        require(
            window is None or window >= calibration,
            "window_steps",
            window,
            f"calibration_steps = {calibration} or more: a shorter record never ends the calibration",
        )
        every = self.control.calibration_interval_steps
        require(
            every == 1 or self.training.selector == "search" or not self.training.max_na,
            "calibration_interval_steps",
            every,
            f"1 with selector {self.training.selector!r}: its models need steps in a row that were measured",
        )
        require(
            self.control.policy != "uncertainty" or self.training.selector == "search",
            "policy",
            self.control.policy,
            f"'fixed' or 'novelty' with selector {self.training.selector!r}, whose models know inputs that training "
            "has not seen, but not how their uncertainty grows with time",
        )
