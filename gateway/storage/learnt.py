"""The file of what a gateway has learnt, as JSON: for another card, another computer, or an archive.

Versioned, with a checksum, without pickle. Small values are plain; an array is its kind, its shape and its numbers,
compressed. The record is no part of it, so it does not grow with age.
"""

import hashlib
import json
import zlib
from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.text import shown
from gateway.storage.snapshot import ARRAY_KINDS
from talc.control import ControllerState
from talc.frame import FloatArray, Frames
from talc.names import THERMAL_ERRORS
from talc.snapshot import check_format, from_plain, to_plain

_FORMAT = "talc-gateway learnt"
_VERSION = 1
_LARGEST_BYTES = 2**30
_LONGEST_STEP_S = 1e6
_SHAPES = {
    "held": "j", "trusted": "j", "learner.doubt": "j", "learner.covariance": "ii",
    "learner.level": "il", "learner.origin": "il", "learner.habit": "ih", "learner.fault": "i2",
    **{f"learner.{name}": "i" for name in ("span", "wide", "reference", "known", "last", "away", "mean")},
    **{f"mixture.{name}": "r" for name in ("time", "weight")}, "mixture.x": "rp",
    **{f"mixture.{name}": "rj" for name in ("jolt", "y", "noise")},
    "mixture.evidence": "jw", "mixture.relevance": "jei", "mixture.zero": "j4",
    **{f"mixture.{name}": "j" for name in ("reference", "jolted", "elapsed", "count", "suspect", "off", "last")},
    **{f"mixture.{name}": "j" for name in ("before", "former_jolted", "former_last", "refused")},
    "mixture.former_evidence": "jw", "mixture.former_zero": "j4",
}  # fmt: skip
"""j: the errors, i: the inputs, l: the lags, p: the features, r: the rows, e: the processes, w: the experts, h: the
habits of an input."""
_ADDED = frozenset(
    {"learner.origin", "learner.habit", "learner.fault"}
    | {
        f"mixture.{name}"
        for name in ("before", "former_jolted", "former_last", "former_evidence", "former_zero", "refused")
    }
)
"""Not in the files of earlier programs."""


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The first measurement, which all others are relative to."""

    ended: datetime
    centres_mm: FloatArray
    """(poses, 3)"""
    in_force_um: FloatArray
    """(3,) or (poses, 3) offsets at that time."""
    errors: FloatArray
    """(9,)"""


@dataclass(frozen=True, slots=True, eq=False)
class Learnt:
    """All that a gateway knows, but for its record."""

    machine: str
    method: str
    step_s: float
    state: ControllerState
    reference: Reference | None
    """None: nothing was measured."""

    @property
    def last_k(self) -> int:
        """Grid index of the last step that was learnt from; -1: not known."""
        return -1 if self.state.last_k is None else self.state.last_k


def learnt_text(learnt: Learnt) -> str:
    """As JSON, with a line end."""
    plain, arrays = to_plain(learnt.state.without_record())
    del arrays["first"]
    found = learnt.reference
    whole: dict[str, Any] = {
        "format": _FORMAT,
        "version": _VERSION,
        "machine": learnt.machine,
        "method": learnt.method,
        "step_s": learnt.step_s,
        "inputs": list(learnt.state.input_names),
        "reference": found
        and {
            "ended": found.ended.isoformat(),
            "centres_mm": found.centres_mm.tolist(),
            "in_force_um": found.in_force_um.tolist(),
            "errors": {name: float(e) for name, e in zip(THERMAL_ERRORS, found.errors, strict=True) if np.isfinite(e)},
        },
        "controller": plain,
        "arrays": {name: _packed(array) for name, array in arrays.items()},
    }
    return json.dumps({**whole, "sha256": _checksum(whole)}) + "\n"


def parse_learnt(text: str) -> Learnt:
    """The inverse of `learnt_text`. Raises ValueError naming the field, its value and what was expected."""
    try:
        whole = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"is not JSON: {error}") from None
    if not isinstance(whole, dict) or whole.get("format") != _FORMAT:
        found = whole.get("format") if isinstance(whole, dict) else whole
        raise ValueError(f"format = {shown(found)}: expected {_FORMAT!r}, as `talc-gateway db export-learnt` writes it")
    if whole.get("version") != _VERSION:
        raise ValueError(
            f"version = {shown(whole.get('version'))}: expected {_VERSION}; is the file from a newer program?"
        )
    stated = whole.pop("sha256", None)
    if stated != _checksum(whole):
        raise ValueError(f"sha256 = {shown(stated)}: does not match the rest; the file is damaged or was edited")
    inputs, step_s = _described(whole)
    try:
        check_format(whole["controller"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"controller: {error}") from None
    arrays = _arrays(whole.get("arrays"), len(inputs))
    try:
        state = from_plain({**whole["controller"], "rows": 0}, arrays, _no_frames)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"controller: {error!r} where a state of this program was expected") from None
    if list(state.input_names) != inputs:
        raise ValueError("controller.input_names: expected the names under inputs")
    return Learnt(whole["machine"], whole["method"], step_s, state, _reference(whole.get("reference")))


def _described(whole: Mapping[str, Any]) -> tuple[list[str], float]:
    """Names of the inputs, and the grid step."""
    inputs, step_s = whole.get("inputs"), whole.get("step_s")
    if not isinstance(inputs, list) or not all(isinstance(i, str) for i in inputs) or len(set(inputs)) != len(inputs):
        raise ValueError(f"inputs = {shown(inputs)}: expected different names")
    if not isinstance(step_s, int | float) or not 0 < step_s < _LONGEST_STEP_S:
        raise ValueError(f"step_s = {shown(step_s)}: expected seconds above 0")
    for name in ("machine", "method"):
        if not isinstance(whole.get(name), str):
            raise ValueError(f"{name} = {shown(whole.get(name))}: expected a text")  # noqa: TRY004 -- of a file
    return inputs, float(step_s)


def _reference(plain: object) -> Reference | None:
    if plain is None:
        return None
    if not isinstance(plain, dict):
        raise ValueError(f"reference = {shown(plain)}: expected a table or null")  # noqa: TRY004 -- of a file
    try:
        centres = np.array(plain["centres_mm"], dtype=np.float64).reshape(-1, 3)
        in_force = np.array(plain["in_force_um"], dtype=np.float64).reshape(-1, 3).squeeze()
        errors = np.array([plain["errors"].get(name, np.nan) for name in THERMAL_ERRORS], dtype=np.float64)
        ended = datetime.fromisoformat(plain["ended"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(
            f"reference: {error!r} where ended, centres_mm, in_force_um and errors were expected"
        ) from None
    if not (np.isfinite(centres).all() and np.isfinite(in_force).all()):
        raise ValueError("reference.centres_mm: expected finite numbers")
    return Reference(ended, centres, in_force, errors)


def _arrays(plain: object, inputs: int) -> dict[str, NDArray[Any]]:
    if not isinstance(plain, dict):
        raise ValueError(f"arrays = {shown(plain)}: expected a table")  # noqa: TRY004 -- of a file
    arrays = {str(name): _unpacked(str(name), packed) for name, packed in plain.items()}
    known = {"j": len(THERMAL_ERRORS), "i": inputs, "h": 6, "2": 2, "4": 4}
    for name, shape in _SHAPES.items():
        if name not in arrays:
            if ("mixture.x" in arrays and name not in _ADDED) or name == "held":
                raise ValueError(f"arrays.{name}: is missing")
            continue
        found = arrays[name].shape
        if len(found) != len(shape):
            raise ValueError(f"arrays.{name}: has {len(found)} dimensions, expected {len(shape)}")
        for letter, size in zip(shape, found, strict=True):
            if known.setdefault(letter, size) != size:
                raise ValueError(f"arrays.{name}: has the shape {found}, expected {known[letter]} instead of {size}")
    features, processes = known.get("p"), known.get("e")
    if features is not None and features != inputs * known["l"]:
        raise ValueError(
            f"arrays.mixture.x: has {features} features, expected {inputs * known['l']} of {inputs} inputs"
        )
    if processes is not None and known["w"] != processes + 1:
        raise ValueError(f"arrays.mixture.evidence: has {known['w']} experts, expected {processes + 1}")
    return arrays


def _packed(array: NDArray[Any]) -> dict[str, object]:
    kind = ARRAY_KINDS[array.dtype.kind]
    data = np.ascontiguousarray(array, dtype=kind).tobytes()
    return {"kind": kind, "shape": list(array.shape), "zlib": b64encode(zlib.compress(data)).decode()}


def _unpacked(name: str, packed: object) -> NDArray[Any]:
    try:
        if not isinstance(packed, dict) or packed["kind"] not in ARRAY_KINDS.values():
            raise ValueError("its kind is unknown")
        shape = tuple(int(size) for size in packed["shape"])
        size = int(np.prod(shape)) * np.dtype(packed["kind"]).itemsize
        if not 0 <= size <= _LARGEST_BYTES:
            raise ValueError(f"its shape is {shape}")
        data = zlib.decompressobj().decompress(b64decode(packed["zlib"], validate=True), size + 1)
        array = np.frombuffer(data, packed["kind"]).reshape(shape)
        return array.astype(array.dtype.newbyteorder("="))
    except (KeyError, TypeError, ValueError, OverflowError, zlib.error) as error:
        raise ValueError(f"arrays.{name}: {error}; expected kind, shape and numbers") from None


def _checksum(whole: Mapping[str, object]) -> str:
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()


def _no_frames(first_k: int, last_k: int) -> Frames:
    raise ValueError(f"frames {first_k} to {last_k} are not in the file")
