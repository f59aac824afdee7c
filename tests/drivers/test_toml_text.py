"""The line of each key of a TOML text, as it is in the text."""

from drivers.toml_text import toml_lines

TEXT = '''first = "a [ that opens nothing # here"  # nor [ here
many = [
  1,  # ]
  2,
]
long = """
[no.header]
x = ['''  # no bracket of this counts
TEXT += '"quoted" \\"""\n""""\nafter = \'\'\'\n]\'\'\'\n[[device]]\nname = "a"\n[device.map]\nk = {a = 1}\n[[device]]\n'


def test_a_statement_ends_where_no_bracket_and_no_text_is_open() -> None:
    lines = toml_lines(TEXT)
    assert {str(key[0]): line for key, line in lines.items() if len(key) == 1} == {
        "first": 1,
        "many": 2,
        "long": 6,
        "after": 10,
        "device": 12,
    }
    assert (lines["device", 0, "name"], lines["device", 0, "map", "k", "a"], lines["device", 1]) == (13, 15, 16)


def test_what_comes_after_a_bracket_that_stays_open_has_no_line() -> None:
    assert toml_lines("a = 1\nb = [\n" + "1,\n" * 5000) == {("a",): 1}
