"""The words of the controller: its phases, why something is wanted, and what a decision reports."""

from enum import StrEnum


class Phase(StrEnum):
    """State of the adaptive control (Z22 §2)."""

    CALIBRATION = "calibration"
    COMPENSATION = "compensation"
    NO_GOOD = "no_good"


class Why(StrEnum):
    """Why a measurement or a training is wanted."""

    CALIBRATION = "calibration"
    INTERVAL = "interval"
    """The fixed interval, or the longest one of the other policies, has passed."""
    NOVELTY = "novelty"
    """The inputs have left the range of the training data."""
    UNCERTAINTY = "uncertainty"
    """A prediction may no longer be within its action control limit."""
    NO_GOOD = "no_good"
    RETRY = "retry"
    COMMAND = "command"
    """A person asked for it. The controller itself never does."""


class EventKind(StrEnum):
    """What a decision reports besides its numbers."""

    PHASE_CHANGED = "phase_changed"
    STATE_UPDATE = "state_update"
    LIMIT_EXCEEDED = "limit_exceeded"
    TRAINING_WANTED = "training_wanted"
    MODELS_ADOPTED = "models_adopted"
    MODEL_REJECTED = "model_rejected"
    INPUT_SUBSTITUTED = "input_substituted"
    PREDICTION_BOUNDED = "prediction_bounded"
    TRUST_CHANGED = "trust_changed"
    """An error is corrected from now on, or is no longer corrected."""
    SENSOR_SUSPECT = "sensor_suspect"
    """From the service's sensor check: an offset or an exchange; `value` is an offset's estimate, K."""
    SENSORS_AGREE = "sensors_agree"
    PROBLEM = "problem"
    """From the service: a bus, device, channel or the NC. The controller itself never reports one."""
    PROBLEM_ENDED = "problem_ended"
    MEASUREMENT_REJECTED = "measurement_rejected"
    """From the service: a probing cycle failed, or its result is rejected. From the controller: impossible number."""
    OPERATOR = "operator"
    """From the service: the operator should know or do something."""
    COMMAND = "command"
    """From the service: a person has given a command."""
