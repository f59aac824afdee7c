"""The commands that the documentation shows, and for each how a test runs it."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import click

from gateway.cli import main

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    (
        page
        for page in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md"))
        if page.name != "CHANGELOG.md"  # names commands that no longer exist
    ),
    key=lambda page: page.as_posix(),
)
OURS = re.compile(r"(?:\.venv/bin/)?(talc-gateway|make|python)\b")
OTHERS = re.compile(
    r"(apt|apt-get|certificates\.sh|chmod|dpkg|git|ip|journalctl|nano|openssl|pip|systemctl|unzip|uv) [^|=]+$"
)
"""Third-party programs, as they begin a line of a shell block or a span of a sentence."""


@dataclass(frozen=True, slots=True)
class RunAsShown:
    """Given as it is shown, in a folder that has what it names; its output contains `says`."""

    says: str
    code: int = 0


@dataclass(frozen=True, slots=True)
class RunPrints:
    """Given as it is shown: it prints the page that the line writes to, or writes the files of that folder."""


@dataclass(frozen=True, slots=True)
class RunOnWires:
    """Given as it is shown, one after the other, between devices that are played (test_shown_commands)."""


@dataclass(frozen=True, slots=True)
class RunInFolder:
    """Given as it is shown, by a program that changes a folder instead of this computer (test_shown_installs)."""


@dataclass(frozen=True, slots=True)
class RunElsewhere:
    """Another test gives it, with a test's paths and size; `trace` is the text in that file which shows it."""

    file: str
    trace: str


HowShown = RunAsShown | RunPrints | RunOnWires | RunInFolder | RunElsewhere

TABLE: dict[str, HowShown] = {
    # The service and what it left.
    r"check (gateway\.toml|CONFIG|FILE|/etc/.*)": RunAsShown("gateway.toml: good. "),
    r"doctor (gateway\.toml|CONFIG|/etc/.*)": RunAsShown("what to do: ", 3),
    r"status (gateway\.toml|CONFIG|/etc/.*)": RunAsShown("channels: none of", 3),
    r"replay (DB|out/demo/gateway\.sqlite)": RunAsShown("identical"),
    r"replay FILE": RunAsShown("EZ0T held"),
    r"replay benchmarks/.*": RunElsewhere("tests/test_documented_commands.py", "fl_thermal.csv"),
    r"report (DB|gateway\.sqlite)": RunAsShown("Productivity Pd"),
    r"db check DATABASE": RunAsShown(": whole"),
    r"db stats DATABASE": RunAsShown("on the disk"),
    r"db export DATABASE TABLE -o FILE": RunAsShown("steps.csv: "),
    r"db export-learnt DATABASE -o FILE": RunAsShown("measurements of EY0A from "),
    r"db import-learnt gateway\.toml FILE": RunAsShown("EY0A"),
    r"db backup DATABASE -o FILE": RunAsShown(" MB"),
    r"prior make site --kind dmu50 -o dmu50\.json": RunElsewhere(
        "tests/gateway/collect/test_prior_of_site.py", '"prior", "make", site, "--kind"'
    ),
    r"prior make postgresql://.*": RunElsewhere("tests/gateway/collect/test_prior_of_database.py", '"make"'),
    r"prior make (DB|mill1).*": RunElsewhere("tests/gateway/past/test_prior.py", '"make"'),
    r"demo": RunElsewhere("tests/test_shown_commands.py", '"demo", "--hours", "2"'),
    r"demo --method models": RunElsewhere("tests/system/test_demo.py", '"--method", "models"'),
    r"demo --preset zimmermann-2022.*": RunElsewhere("tests/system/test_demo.py", '"--preset", "blaser-2019"'),
    r"init (gateway\.toml|CONFIG)": RunElsewhere("tests/gateway/cli/commissioning/test_init.py", '"init"'),
    r"init /etc/.*": RunElsewhere("tests/system/test_debian_package.py", "talc-gateway init /"),
    r"probe /etc/.*": RunElsewhere("tests/system/test_debian_package.py", "talc-gateway probe /"),
    r"collect '?postgresql://.*": RunElsewhere("tests/gateway/collect/test_database_command.py", '"collect"'),
    r"collect (FOLDER|site) .*": RunElsewhere("tests/gateway/collect/test_network.py", '"collect"'),
    r"publish (OUTLETS|outlets\.toml.*)": RunElsewhere("tests/gateway/outlets/test_publish.py", '"publish"'),
    r"watch.*": RunElsewhere("tests/gateway/cli/beside/test_watch.py", '"watch"'),
    r"web (CONFIG|gateway\.toml|--connect .*)": RunElsewhere("tests/benches/page_rig.py", '"web", '),
    r"opcua (CONFIG|gateway\.toml)": RunElsewhere("tests/gateway/umati/test_opcua_command.py", '"opcua"'),
    r"nc sinumerik-files (gateway\.toml|CONFIG)": RunElsewhere(
        "tests/gateway/cli/commissioning/test_nc_files.py", '"sinumerik-files"'
    ),
    r"agent-test .*": RunElsewhere("tests/gateway/agent_test/test_agent_test.py", '"agent-test"'),
    r"command (pause|resume) .*": RunElsewhere("tests/gateway/telemetry/test_commands.py", '"command"'),
    # Wires.
    r"play (docs/example\.wire|field\.wire|FILE)": RunOnWires(),
    r"probe field\.wire\.play/.*": RunOnWires(),
    r"probe .*\.play/.* --watch": RunElsewhere("tests/gateway/cli/commissioning/test_probe_watch.py", '"--watch"'),
    r"probe (gateway\.toml|CONFIG)": RunOnWires(),
    r"probe gateway\.toml --watch .*": RunOnWires(),
    r"probe gateway\.toml --try-writing": RunElsewhere(
        "tests/gateway/cli/commissioning/test_probe.py", '"--try-writing"'
    ),
    r"record (gateway\.toml -o field\.wire|CONFIG)": RunOnWires(),
    r"run gateway\.toml --record field\.wire": RunOnWires(),
    r"run CONFIG": RunElsewhere("tests/gateway/cli/running/test_service_manager.py", '"run"'),
    r"scan ports": RunElsewhere("tests/gateway/scan/test_ports.py", '"ports"'),
    r"scan (serial|tcp|can) .*": RunElsewhere("tests/system/test_wiring_faults.py", "comparable"),
    r"inspect registers .*": RunElsewhere("tests/gateway/scan/test_inspect.py", '"registers"'),
    r"inspect (objects|nodes) .*": RunElsewhere("tests/gateway/scan/test_inspect_named.py", '"(objects|nodes)"'),
    r"inspect topics .*": RunElsewhere("tests/gateway/scan/test_inspect_topics.py", '"topics"'),
    r"(check|run|status) rehearsal\.toml|probe rehearsal\.toml --try-writing": RunElsewhere(
        "tests/simulators/nc/test_nc_alone.py", '"run", str'
    ),
    # Python.
    r"(.venv/bin/)?python -m (gateway\.config\.reference|tests\.benches\.faults\.page)( > .*)?": RunPrints(),
    r"(.venv/bin/)?python -m tests\.benches\.tried": RunElsewhere("tests/test_tried.py", r"write\(tmp_path\)"),
    r"(.venv/bin/)?python -m gateway\.telemetry docs/telemetry": RunPrints(),
    r"(.venv/bin/)?python -m pytest tests/.*": RunElsewhere(".ci/run", "make test"),
    r"python -m studies": RunAsShown("adaptive-inputs"),
    r"python -m studies .+": RunElsewhere("tests/studies/test_studies.py", "run_study|carry_out"),
    r"python -m simulators\.devices.*": RunElsewhere(
        "tests/simulators/devices/test_emulate.py", '"simulators.devices"'
    ),
    r"python -m simulators\.nc .*": RunElsewhere("tests/simulators/nc/test_nc_alone.py", '"simulators.nc", "--port"'),
    r"python -m simulators\.plant\.generate": RunElsewhere(
        "tests/simulators/plant/test_plant_bodies.py", r"generate\.main, \[.base., .--folder."
    ),
    r"python -m simulators\.three_body\.generate": RunElsewhere(
        "tests/simulators/three_body/test_three_body.py", r"reduce_whole\(whole\), load_reduced"
    ),
    r"python -m benchmarks\.method_figures": RunElsewhere("tests/benchmarks/test_method_figures.py", r"figures\.main"),
    r"python -m pip wheel .*": RunElsewhere("tests/test_wheel.py", '"wheel", "--no-deps"'),
    r"python -m tests\.benches\.nc_disturbances .*": RunElsewhere(
        "tests/gateway/nc/test_nc_disturbances.py", "disturbed"
    ),
    r"python -m tests\.benches\.power_cuts .*": RunElsewhere(
        "tests/gateway/storage/test_power_cuts.py", "cut_and_start"
    ),
    r"python -m tests\.benches\.spoilt_stores .*": RunElsewhere(
        "tests/gateway/storage/test_damage.py", "spoilt_stores"
    ),
    r"publish FILE --check": RunElsewhere("tests/gateway/outlets/test_other_outlets.py", '"publish", str'),
    r"python -m tests\.benches\.release": RunElsewhere("tests/test_release.py", r"faults\(tree\)"),
    r"python -m tests\.benches\.disk_calls.*": RunElsewhere("tests/gateway/storage/test_disk_calls.py", "disk_calls"),
    r"python -m tests\.benches\.kills .*": RunElsewhere("tests/system/test_killed_in_phases.py", "kills"),
    r"python -m tests\.benches\.store_kills .*": RunElsewhere("tests/system/test_killed_in_phases.py", "store_kills"),
    r"python -m tests\.benches\.history_day": RunElsewhere("tests/test_bench_commands.py", r"benches\.history_day"),
    r"python -m tests\.benches\.site .*": RunElsewhere("tests/gateway/collect/test_site.py", "run_site"),
    r"python -m tests\.benches\.tick_latency": RunElsewhere(
        "tests/gateway/telemetry/test_tick_latency.py", "run_ticks"
    ),
    r"python -m tests\.benches\.fuzz .*": RunElsewhere("tests/test_bench_commands.py", r"benches\.fuzz"),
    r"python -m tests\.benches\.soak .*": RunElsewhere("tests/system/test_soak.py", "soaked"),
    r"python -m tests\.benches\.service_memory .*": RunElsewhere(
        "tests/test_bench_commands.py", r"benches\.service_memory"
    ),
    r"python -m tests\.benches\.years_memory .*": RunElsewhere(
        "tests/test_bench_commands.py", r"benches\.years_memory"
    ),
    r"python -m tests\.benches\.page_memory .*": RunElsewhere("tests/test_bench_commands.py", r"benches\.page_memory"),
    r"python -m tests\.benches\.publishing_cost .*": RunElsewhere(
        "tests/test_bench_commands.py", r"benches\.publishing_cost"
    ),
    r"python -m tests\.benches\.outlets_cost .*": RunElsewhere(
        "tests/test_bench_commands.py", r"benches\.outlets_cost"
    ),
    r"python -m tests\.benches\.page_browsers .*": RunElsewhere(
        "tests/test_bench_commands.py", r"benches\.page_browsers"
    ),
    r"python -m tests\.benches\.page_gone .*": RunElsewhere("tests/test_bench_commands.py", r"benches\.page_gone"),
    r"python -m tests\.benches\.linuxcnc_motion": RunElsewhere("tests/system/test_linuxcnc_follows.py", r"left_um\("),
    r"python -m tests\.benches\.linuxcnc_disturbances .*": RunElsewhere(
        "tests/gateway/nc/test_linuxcnc_disturbances.py", "disturbed_linuxcnc"
    ),
    r"python -m tests\.benches\.linuxcnc_period": RunElsewhere(
        "tests/drivers/linuxcnc/test_linuxcnc_period.py", "periods_us"
    ),
    r"python -m tests\.benches\.real_time_kernel .*": RunElsewhere(
        "tests/drivers/linuxcnc/test_linuxcnc_period.py", "on_real_time_kernel"
    ),
    r"python -m tests\.benches\.linuxcnc_core": RunElsewhere(
        "tests/drivers/linuxcnc/test_linuxcnc_period.py", "core_us"
    ),
    r"python -m tests\.benches\.service_under_systemd .*": RunElsewhere(
        "tests/system/test_debian_package.py", r"tries\("
    ),
    r"python -m tests\.benches\.service_limits.*": RunElsewhere("tests/system/test_debian_package.py", r"limits\("),
    r"python -m tests\.benches\.notebooks": RunElsewhere("tests/examples/test_notebooks.py", "notebooks import .* run"),
    # make.
    r"make (test|\.venv/\.ready)": RunElsewhere(".ci/run", "make test"),
    r"make lint types imports": RunElsewhere("Makefile", "(?ms)^test:.* lint types imports"),
    r"make site": RunElsewhere("tests/test_site.py", '"mkdocs", "build", "--strict"'),
    r"make deb": RunElsewhere("tests/system/test_debian_package.py", r"build\.sh"),
    r"make demo NC=linuxcnc": RunElsewhere("tests/system/test_linuxcnc.py", "show"),
    r"make demo": RunElsewhere("tests/system/test_demo.py", '"demo", "--hours"'),
    r"make study.*": RunElsewhere("tests/studies/test_studies.py", '"--results", str.page., "--pages"'),
    r"make bench( SUBJECTS=(demo|demo_bounds|demo_models|forecast|learner_bounds|policy|selection|sensor_check"
    r"|sparse_expert|unseen_days))?"
    r"|make bench SUBJECTS=recordings RECORDINGS=folder": RunElsewhere(
        "tests/benchmarks/test_by_command.py", r"main\(\[subject\], page\)"
    ),
    r"make pictures": RunElsewhere("tests/test_shown_commands.py", '"pictures", '),
    r"make format": RunElsewhere("tests/test_shown_commands.py", r'make\("format"\)'),
    r"make audit": RunElsewhere(".ci/run", "make --silent audit"),
    # Third-party programs.
    r"certificates\.sh .*": RunElsewhere("tests/test_certificates.py", r"certificates\.sh"),
    r"dpkg --(install|purge).*": RunElsewhere("tests/system/test_debian_package.py", "dpkg --(install|purge)"),
    r"(apt|apt-get) .*|dpkg --add-architecture .*|uv .*": RunInFolder(),
    r"ip link set can0 .*": RunElsewhere("tests/benches/computer_files_guest.py", "ip link set can0 up type can bit"),
    r"ip -details .*": RunElsewhere("tests/benches/computer_files_guest.py", "ip -details -statistics link show can0"),
    r"systemctl enable systemd-networkd": RunElsewhere("tests/benches/computer_files_guest.py", "enable systemd-netw"),
    r"systemctl enable --now talc-gateway": RunElsewhere(
        "tests/benches/service_under_systemd.py", "systemctl enable --now talc-gateway"
    ),
    r"pip install \.": RunElsewhere("tests/test_wheel.py", '"install", "--no-deps"'),
    r"pip install ['\"]?talc-gateway.*": RunElsewhere("tests/test_wheel.py", '"install", "--dry-run", "--no-index"'),
    r"openssl .*|chmod 600": RunElsewhere(
        "tests/test_shown_commands.py", "openssl rand -hex 32 > anna.key && chmod 600"
    ),
    r"git tag -.*": RunElsewhere("tests/test_release.py", '"tag", "--annotate"'),
    r"unzip -l .*": RunElsewhere("tests/test_wheel.py", "unzip -l "),
    r"journalctl -k --grep voltage": RunElsewhere("tests/benches/computer_files_guest.py", "-k --grep voltage"),
    r"journalctl -u talc-gateway( -p warning)?": RunElsewhere(
        "tests/benches/service_under_systemd.py", '"journalctl -u talc-gateway( -p warning)?"'
    ),
}
"""From the pattern of a whole command, without `talc-gateway`, to what runs it; the first pattern that fits counts."""


def commands_in(page: Path) -> Iterator[str]:
    """Commands of a page, in code blocks, indented lines and code spans, on one line each."""
    prose = []
    for i, part in enumerate(page.read_text("utf-8").split("```")):
        if i % 2 == 0:
            prose.append(re.sub(r"(?m)^    .*$", "", part))
            lines = re.findall(r"(?m)^    (?=\S)(.*)$", part)
        else:
            lines = part.splitlines()
        for line in lines:
            command = line.strip().removeprefix("$ ").partition(" #")[0].strip()
            for one in command.split(" && ") if OTHERS.match(command) else (command,):
                if OURS.match(one) or (part.startswith("sh\n") and OTHERS.match(one)):
                    yield one
    for span in re.findall(r"`([^`]+)`", " ".join(prose)):
        one = " ".join(span.split()).removeprefix("PYTHONPATH=. ")
        if OURS.match(one) or OTHERS.match(one):
            yield one


COMMANDS = sorted(
    {(page.relative_to(ROOT).as_posix(), command) for page in PAGES for command in commands_in(page) if " " in command}
)


def leaf(words: list[str]) -> tuple[click.Command, list[str], click.Context]:
    """The command that the words name, and the words that remain for it."""
    command: click.Command = main
    context = click.Context(main, info_name="talc-gateway")
    while isinstance(command, click.Group) and words:
        name, found, words = command.resolve_command(context, words)
        assert found is not None
        command, context = found, click.Context(found, info_name=name, parent=context)
    return command, words, context


def is_name(command: str) -> bool:
    """Whether a sentence only names the command or an option, without what it needs."""
    program, *words = shlex.split(command)
    if program != "talc-gateway":
        return False
    found, rest, _ = leaf(words)
    if isinstance(found, click.Group):
        return True
    needs = any(p.required for p in found.params if isinstance(p, click.Argument))
    return (needs and not rest) or command.endswith("--preset")


def verdict(command: str) -> tuple[str, HowShown | None]:
    """The pattern that fits first, and what it says; None: no pattern fits."""
    text = command.removeprefix("talc-gateway ")
    for pattern, found in TABLE.items():
        if re.fullmatch(pattern, text):
            return pattern, found
    return "", None


WHOLE = sorted({command for _, command in COMMANDS if not is_name(command)})
"""Commands that a reader can give, each once."""
