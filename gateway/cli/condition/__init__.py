"""How a gateway is: `status` and `doctor`, which only look.

Others use the module named here. It is not imported.
"""
