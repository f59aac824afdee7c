"""CANopen nodes: those that follow CiA 404, and any others by the objects that a profile lists."""
