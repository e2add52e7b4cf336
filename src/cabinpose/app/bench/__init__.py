"""Measures what the package promises, in the conditions that it states."""
