"""Devices, one module each: a `core.ports.FrameSource`, and beside it the bytes of its protocol."""
