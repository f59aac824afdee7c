"""CAN interfaces, and devices that send without being asked."""
