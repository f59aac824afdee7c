"""The profiles that `emulate` offers, with what each needs."""

PROFILES = {
    "m7015": ("icpdas_m7015", 6),
    "pta8d08": ("eletechsup_pta8d08", 8),
    "voltage_input": ("analogue_displacement", 8),
    "adam6015": ("advantech_adam6015", 7),
    "wago464": ("wago_750_464", 4),
    "cia404": ("cia404", 4),
    "can_logger": ("", 5),
    "me_rs485": ("me_rs485", 1),
    "me_dt6120": ("me_dt6120", 1),
    "me_ethernet": ("me_ethernet", 2),
}
"""Profile and number of inputs."""


def options(device: str) -> dict[str, object]:
    if device.startswith("me_"):
        return {"range_um": 500.0}
    return {"vendor": "jumo"} if device == "cia404" else {}
