"""Tables that a command shows in the terminal."""


def rows_of(output: str) -> list[list[str]]:
    """The texts of the cells, without rows that consist only of lines."""
    return [[cell.strip() for cell in line.strip("│┃").split("│")] for line in output.splitlines() if "│" in line]


def row_of(output: str, first: str) -> list[str]:
    """The row whose first cell is this."""
    return next(row for row in rows_of(output) if row[0] == first)
