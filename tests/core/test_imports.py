"""Old public names go on working, and say what they are called now."""

from __future__ import annotations

from importlib import import_module

import pytest

import cabinpose.signals
from cabinpose.core.imports import moved


@pytest.mark.parametrize("name", ["Counts", "FrameSource", "Sample"])
def test_devices_have_left_core(name: str) -> None:
    with pytest.warns(DeprecationWarning, match=f"cabinpose.core.ports.{name} is cabinpose.signals.{name} now"):
        old = getattr(import_module("cabinpose.core.ports"), name)
    assert old is getattr(cabinpose.signals, name)


def test_other_names_do_not_exist() -> None:
    with pytest.raises(AttributeError, match="module 'here' has no attribute 'nothing'"):
        moved("here", {"old": "cabinpose.signals.Sample"})("nothing")
