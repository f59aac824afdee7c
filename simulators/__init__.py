"""The other side of every wire: plant physics, device emulators, an emulated numerical control."""
