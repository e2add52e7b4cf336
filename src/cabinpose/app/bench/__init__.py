"""Measures what the package promises, in the conditions that it states."""

from cabinpose.app.bench.synth import run_bench

__all__ = ["run_bench"]
