"""Devices, one module each: a `signals.FrameSource`, and beside it the bytes of its protocol."""
