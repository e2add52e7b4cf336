"""Predictions held against references: errors of every joint, pooled; metrics with their units, denominators and intervals."""
