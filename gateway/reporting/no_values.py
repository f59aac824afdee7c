"""Values that were none, as the learner said at the time: of which input or error, how many, since when, and why."""

from collections import Counter

import numpy as np

from gateway.model.text import Language
from gateway.reporting.data import ReportData
from talc.frame import EventCode

_BEGIN = (EventCode.VALUE_IMPLAUSIBLE, EventCode.INPUTS_EXCHANGED)
_END = (EventCode.VALUE_GOOD_AGAIN, EventCode.VALUE_GOOD_BUT_FAR)


def no_values(data: ReportData) -> list[tuple[str, str]]:
    """When each input or error first had one, and the rest in words: inputs by fault, then errors by fault, then
    measurements that were forgotten."""
    said = Language(data.language)
    return [*_of_inputs(data, said), *_of_errors(data, said)]


def _of_inputs(data: ReportData, said: Language) -> list[tuple[str, str]]:
    steps, first = Counter[tuple[str, str]](), dict[tuple[str, str], float]()
    lasting = dict[str, tuple[str, float]]()

    def count(name: str, until: int) -> None:
        why, at = lasting.pop(name)
        steps[name, why] += until - _row(data, at)
        first.setdefault((name, why), at)

    for at, event in data.events:
        name = str(event.values.get("input", ""))
        if event.code in _BEGIN:
            other = str(event.values.get("other", ""))
            if other:
                why = {name: said("replay.exchanged", name=other), other: said("replay.exchanged", name=name)}
            else:
                why = {name: said.word("input_fault", str(event.values["input_fault"]))}
            for each, text in why.items():
                if each in lasting:
                    count(each, _row(data, at))
                lasting[each] = text, at
        elif event.code in _END and name in lasting:
            count(name, _row(data, at))
    for name in list(lasting):
        count(name, len(data.k))
    return [
        (data.moment(first[key]), said("report.no_value", name=key[0], n=n, why=key[1])) for key, n in steps.items()
    ]


def _of_errors(data: ReportData, said: Language) -> list[tuple[str, str]]:
    not_learnt, forgotten, first = Counter[tuple[str, str]](), Counter[str](), dict[tuple[str, str], float]()
    for at, event in data.events:
        name = str(event.error)
        if event.code == EventCode.NO_MEASUREMENT:
            key = name, str(event.values["measurement_fault"])
            not_learnt[key] += 1
        elif event.code == EventCode.TAKEN_BACK:
            key = name, ""
            forgotten[name] += int(str(event.values["n"]))
        else:
            continue
        first.setdefault(key, at)
    found = [
        (
            data.moment(first[key]),
            said("replay.not_learnt", name=key[0], n=n, why=said.word("measurement_fault", key[1])),
        )
        for key, n in not_learnt.items()
    ]
    return found + [
        (data.moment(first[name, ""]), said("replay.forgotten", name=name, n=n)) for name, n in forgotten.items()
    ]


def _row(data: ReportData, at: float) -> int:
    """The step at or before an event, or the first one."""
    return max(int(data.rows_at(np.array([at]))[0]), 0)
