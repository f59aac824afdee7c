"""The papers' systems as settings (docs/presets.md says what each paper states, and where)."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Final

from talc.settings import ControlSettings, TalcSettings, TrainingSettings

PRESETS: Final = {
    "zimmermann-2022": TalcSettings(
        preset="zimmermann-2022",
        method="models",
        control=ControlSettings(acl="training"),
        training=TrainingSettings(selector="pso", estimator="least_squares", max_na=5, max_nb=5),
    ),
    "blaser-2019": TalcSettings(
        preset="blaser-2019",
        method="models",
        control=ControlSettings(
            calibration_steps=78,
            no_good_measurements=12,
            no_good_interval_steps=2,
            acl="fixed",
        ),
        training=TrainingSettings(selector="tck", estimator="least_squares", max_na=1, max_nb=1, static_inputs=True),
    ),
}
"""At the grid step of 5 min."""


def completed(given: Mapping[str, object]) -> dict[str, object]:
    """A `[talc]` table with the values of its preset; keys that are given stay. Without a known preset: unchanged."""
    name = given.get("preset")
    if not isinstance(name, str) or name not in PRESETS:
        return dict(given)
    whole: dict[str, object] = asdict(PRESETS[name])
    for key, value in given.items():
        before = whole.get(key)
        whole[key] = {**before, **value} if isinstance(before, dict) and isinstance(value, Mapping) else value
    return whole
