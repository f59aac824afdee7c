"""Programs beside a gateway, which hear what it publishes: `web`, `opcua`, `publish`, `collect`, `watch` and `command`.

Others use the modules named here. None is imported: each loads libraries of its own.
"""
