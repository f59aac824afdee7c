"""CANopen nodes, by CiA 404."""
