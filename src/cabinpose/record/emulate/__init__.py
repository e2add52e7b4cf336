"""Devices played: servers that send the real bytes, on loopback unless told otherwise."""
