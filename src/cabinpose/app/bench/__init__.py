"""Measures what the package promises, in the conditions that it states."""

from cabinpose.app.bench.detect import run_detect_bench
from cabinpose.app.bench.synth import run_bench

__all__ = ["run_bench", "run_detect_bench"]
