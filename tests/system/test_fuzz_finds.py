"""The fuzz bench finds nothing for a while, and finds a missing guard: one on each surface is removed."""

import logging
from collections.abc import Iterator, Mapping, Sequence

import pytest

from drivers import profiles
from drivers.agent import connection
from drivers.can import dbc, dbc_profile
from drivers.canopen import bus as canopen_bus
from drivers.micro_epsilon import rs485
from drivers.modbus import frames
from drivers.mqtt import profile as mqtt_profile
from drivers.mtconnect import document, exchange
from drivers.opcua import session
from gateway.config import prior, reading
from gateway.heard import instants
from gateway.recordings import cells, files, wire_log
from gateway.storage import learnt, snapshot
from gateway.telemetry import command_door
from gateway.web import older, weeks
from tests.benches.changed_source import SourceChange, changed
from tests.benches.fuzz import SURFACES, fuzzed

GUARDS: Mapping[str, Sequence[SourceChange]] = {
    "opcua": (
        SourceChange(
            session, "except Exception as error:\n            await", "except () as error:\n            await"
        ),
    ),
    "agent": (SourceChange(connection, "except (ValueError, RecursionError):", "except RecursionError:"),),
    "modbus": (SourceChange(frames, "if len(heard) - start <= TCP_HEADER.size:", "if len(heard) == start:"),),
    "canopen": (SourceChange(canopen_bus, "except SdoCommunicationError as error:", "except () as error:"),),
    "can": (SourceChange(dbc, "if kept is None:", "if False:"),),
    "micro_epsilon": (SourceChange(rs485, "    if len(heard) < start + 4:\n        return None\n", ""),),
    "toml": (SourceChange(reading, "except ValueError as error:", "except () as error:"),),
    "profiles": (SourceChange(profiles, "except ValueError as error:", "except () as error:"),),
    "dbc": (SourceChange(dbc_profile, "except (OSError, DbcError, ValueError)", "except (OSError, ValueError)"),),
    "recordings": (
        SourceChange(files, "except (ArrowException, OSError, UnicodeDecodeError)", "except UnicodeDecodeError"),
    ),
    "wire_log": (SourceChange(wire_log, "    if found is None:\n        return None\n", ""),),
    "learnt": (
        SourceChange(
            learnt,
            'except (KeyError, TypeError, ValueError, AttributeError) as error:\n        raise ValueError(f"controller',
            'except ValueError as error:\n        raise ValueError(f"controller',
        ),
    ),
    "prior": (SourceChange(prior, "except (ValueError, RecursionError)", "except ValueError"),),
    "snapshot": (SourceChange(snapshot, "if hashlib.sha256(body).digest() != data[:_CHECKSUM]:", "if False:"),),
    "parquet": (
        SourceChange(files, "if types.is_temporal(kind) or types.is_nested(kind):", "if False:"),
        SourceChange(cells, "except (TypeError, ValueError, OverflowError):", "except (ValueError, OverflowError):"),
    ),
    "settings": (SourceChange(reading, "except ValueError as error:", "except () as error:"),),
    "mtconnect": (SourceChange(document, "except expat.ExpatError as error:", "except () as error:"),),
    "http": (SourceChange(exchange, "    except ValueError:\n", "    except ():\n"),),
    "mqtt": (SourceChange(mqtt_profile, "except (ValueError, RecursionError):", "except RecursionError:"),),
    "heard": (SourceChange(instants, "except ValueError:", "except ():"),),
    "answers": (SourceChange(weeks, "except (OverflowError, OSError) as error:", "except () as error:"),),
    "queries": (SourceChange(command_door, "if operator is None or not signed:", "if operator is None:"),),
    "web": (SourceChange(older, "except (ValueError, OverflowError) as error:", "except OverflowError as error:"),),
}
"""Guards that are removed one at a time. `except ()` catches nothing."""
EXAMPLES = {"prior": 400, "dbc": 100, "answers": 400, "web": 1500}
"""The number of examples, if not 40."""
FIVE_SECONDS = {
    "opcua": 8, "agent": 170, "modbus": 100, "can": 25,
    "wire_log": 9_000, "recordings": 4_000, "toml": 6_000, "dbc": 3_500,
}  # fmt: skip
"""The numbers of examples that a recent computer tries in about five seconds of processor time."""


@pytest.fixture(autouse=True)
def _unlogged() -> Iterator[None]:
    """What is logged about damaged answers may not be text."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of a socket that a defect left
@pytest.mark.parametrize("surface", SURFACES)
def test_a_guard_that_is_missing_is_found(surface: str) -> None:
    said: list[str] = []
    with changed(GUARDS[surface]):
        assert not fuzzed(surface, 0.0, EXAMPLES.get(surface, 40), 0, said.append), said


@pytest.mark.slow
@pytest.mark.parametrize(("surface", "examples"), FIVE_SECONDS.items())
def test_nothing_comes_through(surface: str, examples: int) -> None:
    """The same examples on every computer."""
    said: list[str] = []
    assert fuzzed(surface, 0.0, examples, 0, said.append), said
