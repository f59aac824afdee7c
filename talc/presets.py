"""The papers' systems as settings (docs/method.md says what each paper states, and where)."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Final

from talc.settings import ControlSettings, TalcSettings, TrainingSettings

PRESETS: Final = {
    "zimmermann-2022": TalcSettings(
        preset="zimmermann-2022",
        method="models",
        control=ControlSettings(acl="training", policy="novelty"),
        training=TrainingSettings(selector="pso", estimator="guarded", max_na=5, max_nb=5),
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
        training=TrainingSettings(selector="tck", estimator="guarded", max_na=1, max_nb=1, static_inputs=True),
    ),
}
"""At the grid step of 5 min. Fits are guarded: see `preset`."""


def preset(name: str, *, exact: bool = False) -> TalcSettings:
    """A paper's system; exact: fits by plain least squares as printed, which can run away. KeyError: no such preset."""
    found = PRESETS[name]
    if not exact:
        return found
    return replace(found, exact=True, training=replace(found.training, estimator="least_squares"))


def completed(given: Mapping[str, object]) -> dict[str, object]:
    """A `[talc]` table with the values of its preset; keys that are given stay. Without a known preset: unchanged."""
    name = given.get("preset")
    if not isinstance(name, str) or name not in PRESETS:
        return dict(given)
    whole: dict[str, object] = asdict(preset(name, exact=given.get("exact") is True))
    for key, value in given.items():
        before = whole.get(key)
        whole[key] = {**before, **value} if isinstance(before, dict) and isinstance(value, Mapping) else value
    return whole
