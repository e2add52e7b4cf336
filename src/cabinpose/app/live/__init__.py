"""Detectors on frames as they come: from a camera, from a recording, from a dataset."""
