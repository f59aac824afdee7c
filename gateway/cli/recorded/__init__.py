"""What was recorded: `db`, `replay`, `prior` and `report`.

Others use the modules named here. None is imported.
"""
