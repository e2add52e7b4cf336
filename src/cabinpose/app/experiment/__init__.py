"""Experiments as files: datasets, trainings, tests and tables, run cell by cell, on this machine or on a cluster."""
