"""Whether the cycle of a configuration has been shown to be free: by a dry run, or by a measurement."""

from gateway.config.extended import stored_configuration
from gateway.config.model import GatewayConfig
from gateway.model.codes import NoticeCode
from gateway.model.text import NOTHING, Text
from gateway.nc.probing.geometry import Geometry, barrier, geometry_of, is_of, path_of
from gateway.storage.answers import answered
from gateway.storage.history import History
from gateway.storage.stored import StoredMeasurement


def proven_in(history: History, config: GatewayConfig) -> bool:
    """Whether a dry run of this control, these poses and this sphere went well, or a cycle of them has measured."""
    geometry = geometry_of(config)
    if geometry is None:
        return False
    if any(is_of(text, geometry) for text in history.operator_texts()):
        return True
    return any(_geometry_in(text) == geometry for text in history.configs_that_measured())


def paths_in(history: History, config: GatewayConfig) -> frozenset[str]:
    """Marks of the paths with which such dry runs went well, of controls that tell them; see MarksPath."""
    geometry = geometry_of(config)
    texts = () if geometry is None else (text for text in history.operator_texts() if is_of(text, geometry))
    return frozenset(filter(None, map(path_of, texts)))


def dry_run_wanted(config: GatewayConfig) -> Text:
    """Why an armed gateway of this configuration would request no cycle, by its database; empty: it would."""
    if not config.probing.armed or config.nc is None:
        return NOTHING
    path, proven = config.storage.path, False
    if answered(path, path.is_file):
        with History(path) as history:
            proven = proven_in(history, config)
    # Only a link learns what the control offers; until then the configuration's word counts.
    runs_dry = False if config.probing.dry_run == "not offered" else None
    why = barrier(config.probing, proven=proven, runs_dry=runs_dry)
    return Text(NoticeCode.OFF_DRY_RUN, why=why) if why else NOTHING


def is_elsewhere(history: History, measured: StoredMeasurement, config: GatewayConfig) -> bool:
    """Whether the centres of a stored measurement are of other poses or count from another origin."""
    now, text = geometry_of(config), history.config_at(measured.ended)
    before = None if text is None else _geometry_in(text)
    if now is None or before is None:
        return False
    return (before.poses_deg, before.origin_mm) != (now.poses_deg, now.origin_mm)


def _geometry_in(text: str) -> Geometry | None:
    try:
        return geometry_of(stored_configuration(text))
    except (ValueError, KeyError, TypeError, AttributeError):  # pydantic's are ValueErrors
        return None  # this program does not accept it
