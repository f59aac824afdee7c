"""Tries devices of many seeds: `python -m tests.benches.strangers --seeds 200000`; one: `--seed 17 --show`.

Modbus devices, Micro-Epsilon controllers (`--of me`), CANopen nodes (`--of can`), OPC UA servers (`--of opcua`) or MQTT
brokers (`--of mqtt`).
"""

import logging
import sys
import time
from pprint import pprint

import click

from tests.benches.strangers import can_trial, me_trial, modbus_trial, mqtt_trial, opcua_trial
from tests.benches.strangers.nature import shown

_TRIALS = {"modbus": modbus_trial, "me": me_trial, "can": can_trial, "opcua": opcua_trial, "mqtt": mqtt_trial}


@click.command()
@click.option("--seeds", default=300, show_default=True, help="How many are tried.")
@click.option("--seed", default=0, show_default=True, help="The first one.")
@click.option("--of", "kind", type=click.Choice(list(_TRIALS)), default="modbus", show_default=True)
@click.option("--show", "shows", is_flag=True, help="Show all of the first one.")
def main(seeds: int, seed: int, kind: str, shows: bool) -> None:
    """Exit code 1: a device was not read as it must be. Each is one line, with the seed that repeats it."""
    logging.disable(logging.CRITICAL)
    trials = _TRIALS[kind]
    if shows:
        pprint(shown(trials.tried(seed)), width=150)
        return
    began_s, failed = time.process_time(), 0
    for one in range(seed, seed + seeds):
        trial = trials.tried(one)
        if problems := list(trial.problems()):
            failed += 1
            click.echo(f"seed {one} ({trial.nature}): {'; '.join(problems)}")
    click.echo(f"{seeds} devices, {failed} not read as they must be, {time.process_time() - began_s:.1f} s")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
