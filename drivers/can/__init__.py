"""CAN interfaces, and devices that send by themselves."""
