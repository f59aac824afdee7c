"""A program that publishes what a gateway once published (demo_telemetry.jsonl), moved to the present.

`python -m tests.benches.played_telemetry PORT MACHINE all|nothing` says `listening`, waits for a line, publishes, and
says `published`. Then each line of standard input, a key and a JSON object of fields, publishes that key's last message
again with these fields changed. It answers queries with the last values and holds the liveliness token, so that killing
it is like killing a gateway.
"""

import gzip
import json
import math
import sys
import threading
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
import zenoh

from gateway.reporting.page import build
from gateway.telemetry import keys
from gateway.telemetry.answers import CoursePage, ReportPage, StoredReason
from gateway.telemetry.codec import encode
from gateway.telemetry.history_queries import parse_course
from gateway.telemetry.messages import ProbingStanding, PublishedCourse, PublishedReason
from gateway.telemetry.report_queries import parse_report
from gateway.telemetry.scenario_queries import parse_scenario
from talc.names import THERMAL_ERRORS
from tests.benches.small_run import small_run
from tests.benches.zenoh_sessions import listening

SAMPLES = Path(__file__).with_name("demo_telemetry.jsonl")
_STATUS_S = 5.0
_EZ0A_UM = 40.0
_DAY_S = 8.2 * 3600.0
"""How long before the present the played day begins."""
_STANDING = [each.name for each in msgspec.structs.fields(ProbingStanding)]
_TIMES = ("time", "source_time", "asked", "ended")


class PlayedGateway:
    """The publishing side of one gateway.

    Parameters
    ----------
    session: where it publishes
    machine: its name
    boot: identifies its run
    """

    def __init__(self, session: zenoh.Session, machine: str, boot: str) -> None:
        self._session, self._root, self._boot = session, keys.root("talc", machine), boot
        self._last: dict[str, dict[str, Any]] = {}
        self._sequence = 0
        self._lock = threading.RLock()
        self._queryable = session.declare_queryable(f"{self._root}/**", self._answer)
        self._token = session.liveliness().declare_token(f"{self._root}/{keys.ALIVE}")

    def publish(self, suffix: str, message: dict[str, Any]) -> None:
        """Under the next number of this run."""
        with self._lock:
            self._sequence += 1
            self._last[suffix] = message | {"boot": self._boot, "seq": self._sequence}
            if suffix == keys.PROBING and "status" in self._last:  # which repeats it, as a gateway's does
                self._last["status"]["probing"] = {name: message[name] for name in _STANDING if name in message}
            whole = json.dumps(self._last[suffix])
            self._session.put(f"{self._root}/{suffix}", whole, congestion_control=zenoh.CongestionControl.BLOCK)

    def again(self, suffix: str, changes: dict[str, Any]) -> None:
        """The last message of a key, or that of another key of its kind, with other fields; its time is now."""
        kind = keys.kind_of(suffix)
        with self._lock:
            like = self._last.get(suffix) or next(m for key, m in self._last.items() if keys.kind_of(key) == kind)
            self.publish(suffix, like | {"time": datetime.now(UTC).isoformat()} | changes)

    def keep_saying(self, ended: threading.Event) -> None:
        """Publish its status, as a gateway does, until this event."""
        while not ended.wait(_STATUS_S):
            if "status" in self._last:
                self.again("status", {})

    def _degrees(self) -> dict[str, float]:
        readings = [m for key, m in self._last.items() if keys.kind_of(key) == keys.kind_of("reading/any")]
        return {m["channel"]: m["value"] for m in readings if m.get("unit") == "degC" and m["value"] is not None}

    def _answer(self, query: zenoh.Query) -> None:
        if keys.asks_for(keys.COURSE, str(query.key_expr)):
            query.reply(f"{self._root}/{keys.COURSE}", encode(_week(str(query.parameters), self._degrees())))
            return
        if keys.asks_for(keys.REPORT, str(query.key_expr)):
            asked = parse_report(str(query.parameters))
            page = ReportPage(asked.day.isoformat(), asked.zone, gzip.compress(build(small_run(48)).encode()))
            query.reply(f"{self._root}/{keys.REPORT}", encode(page))
            return
        if keys.asks_for(keys.SCENARIO, str(query.key_expr)):
            told, minutes = self._last["forecast"], parse_scenario(str(query.parameters)).minutes
            loads = {"time": datetime.now(UTC).isoformat(), "minutes": minutes, "loads": {"speed": 3000.0}}
            courses = {"k": told["k"], "ahead_s": told["ahead_s"], "stays": told["stays"], "loaded": told["usual"]}
            query.reply(f"{self._root}/{keys.SCENARIO}", json.dumps(loads | courses))
            return
        for suffix, message in list(self._last.items()):
            query.reply(f"{self._root}/{suffix}", json.dumps(message))


def _swing(at: float, lag: float = 0.0) -> float:
    """Once a day from -1 to 1."""
    return math.sin(2.0 * math.pi * (at / 86400.0 - lag))


def _week(selected: str, now_degC: dict[str, float]) -> CoursePage:
    """The answer of a store with the last seven days: Z swings by 40 µm each day with spindle_rear, which swings by 10
    K, and is measured every six hours. The other channels swing less, each with its own lag, to what they are now."""
    asked, now = parse_course(selected), datetime.now(UTC).timestamp()
    begin, end = max(asked.begin.timestamp(), now - 7 * 86400.0), asked.end.timestamp()
    times = [t for i in range(asked.limit) if (t := begin + (end - begin) * i / asked.limit) < end]
    measured = [t for t in times if t % 21600.0 < (end - begin) / asked.limit]

    def errors(at: list[float]) -> dict[str, PublishedCourse]:
        still: list[float | None] = [0.0] * len(at)
        swinging: list[float | None] = [_EZ0A_UM * _swing(t) for t in at]
        return {e: PublishedCourse(swinging if e == "EZ0A" else still, [1.0] * len(at)) for e in THERMAL_ERRORS}

    def course(lag: float, value: float, by: float) -> list[float | None]:
        return [value + by * (_swing(t, lag) - _swing(now, lag)) for t in times]

    found = {name: course(0.05 + 0.02 * i, value, 2.0) for i, (name, value) in enumerate(sorted(now_degC.items()))}
    found["spindle_rear"] = course(0.0, now_degC.get("spindle_rear", 25.0), 10.0)
    reasons = _hourly(begin, end)[-asked.limit :] if asked.reasons else []
    shown = found if asked.temperatures else {}
    loads: dict[str, list[float | None]] = {"spindle_speed": [1500.0] * len(times)} if asked.inputs else {}
    answer = CoursePage(times, errors(times), measured, errors(measured), [0.4] * len(measured), shown, reasons)
    return msgspec.structs.replace(answer, inputs=loads)


def _hourly(begin: float, end: float) -> list[StoredReason]:
    """At each full hour before the played day, EZ0A; spindle_rear gives 80 % of it, and c_table 1 µm."""
    hours = range(math.ceil(begin / 3600.0), math.ceil(min(end, datetime.now(UTC).timestamp() - _DAY_S) / 3600.0))

    def reason(total: float) -> PublishedReason:
        inputs: dict[str, float | None] = {"spindle_rear": 0.8 * total, "c_table": 1.0}
        return PublishedReason(total, True, 1.0, inputs, 0.2 * total - 1.0, 0.0, {}, 0.0, 1.0)

    return [
        StoredReason(
            datetime.fromtimestamp(3600.0 * hour, UTC).isoformat(),
            12 * hour,
            {"EZ0A": reason(_EZ0A_UM * _swing(3600.0 * hour))},
            {"EZ0A": 1.0},
            None,
        )
        for hour in hours
    ]


def recorded() -> list[tuple[str, dict[str, Any]]]:
    """Keys and messages in their order; the last is of now."""
    lines = [json.loads(line) for line in SAMPLES.read_text(encoding="utf-8").splitlines()]
    end = max(datetime.fromisoformat(line["message"]["time"]) for line in lines)
    later = datetime.now(UTC) - end
    return [(line["key"], _moved(line["message"], later)) for line in lines]


def _moved(message: dict[str, Any], later: timedelta) -> dict[str, Any]:
    times = {name: (datetime.fromisoformat(message[name]) + later).isoformat() for name in _TIMES if name in message}
    return message | times


def main(port: int, machine: str, what: str) -> None:
    """Run until standard input ends."""
    with listening(port) as session:
        gateway = PlayedGateway(session, machine, f"boot-{datetime.now(UTC).timestamp()}")
        print("listening", flush=True)
        samples = recorded() if what == "all" else []
        sys.stdin.readline()  # somebody has begun to listen
        for suffix, message in samples:
            gateway.publish(suffix, message)
        print("published", flush=True)
        ended = threading.Event()
        speaker = threading.Thread(target=gateway.keep_saying, args=(ended,))
        speaker.start()
        for line in sys.stdin:
            suffix, _, changes = line.strip().partition(" ")
            gateway.again(suffix, json.loads(changes))
        ended.set()
        speaker.join()


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], sys.argv[3])
