"""Detectors of body pose: networks, their training, and running what was trained."""
