"""The tree is easy to search: README.md names every room, the tests mirror the rooms, tests/README.md names the
rest."""

from pathlib import Path

TESTS = Path(__file__).parent
ROOT = TESTS.parent
TOPS = ("benchmarks", "drivers", "gateway", "simulators", "studies", "talc")


def test_every_room_has_a_folder_of_tests() -> None:
    rooms = [file.parent.relative_to(ROOT) for top in TOPS for file in (ROOT / top).rglob("__init__.py")]
    assert len(rooms) > 40, "the rooms were found"
    assert [str(room) for room in rooms if not list((TESTS / room).rglob("test_*.py"))] == []


def test_every_other_folder_of_tests_is_in_the_index() -> None:
    index = (TESTS / "README.md").read_text("utf-8")
    folders = {file.parent for file in TESTS.rglob("test_*.py")} - {TESTS}
    others = [folder.relative_to(ROOT) for folder in folders if not (ROOT / folder.relative_to(TESTS)).is_dir()]
    assert others, "tests/gateway/faults is one"
    assert [str(folder) for folder in others if str(folder) not in index] == []


def test_the_readme_names_every_room_of_drivers_and_gateway() -> None:
    readme = (ROOT / "README.md").read_text("utf-8")
    house = readme[readme.index("## The house") :]
    rooms = [file.parent.name for top in ("drivers", "gateway") for file in (ROOT / top).glob("*/__init__.py")]
    assert len(rooms) > 25, "the rooms were found"
    assert [room for room in rooms if f"`{room}/`" not in house] == []


def test_a_long_file_states_its_reason() -> None:
    """More than 400 lines are two responsibilities, unless the first lines say why not."""
    files = [
        file
        for top in (*TOPS, "deploy", "examples", "tests")
        for ending in ("py", "cpp", "hpp", "cc", "js", "sh", "toml")
        for file in (ROOT / top).rglob(f"*.{ending}")
        if "node_modules" not in file.parts
    ]
    assert len(files) > 500, "the rooms were found"
    long = {file: text for file in files if (text := file.read_text("utf-8")).count("\n") > 400}
    assert [
        str(f.relative_to(ROOT)) for f, text in long.items() if "longer than 400 lines" not in text[:500].lower()
    ] == []
