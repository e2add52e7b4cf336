"""What a kill costs, beside the outputs' other tests: they are the longest, and files go to processes whole."""

from __future__ import annotations

import lost
import outputs
import pytest


@pytest.mark.slow
@pytest.mark.faults
def test_a_kill_costs_no_more_than_docs_say() -> None:
    done = outputs.preloaded(["--brief"], script=lost.__file__)
    assert done.returncode == 0, done.stdout + done.stderr
